// Beside grid() in grid.rs, which also gives GRID_ROW. num_workgroups is not used: indirect dispatches on DX12 lack it.

fn grid_of(groups: u32) -> vec3<u32> {
    return vec3<u32>(min(groups, GRID_ROW), (groups + GRID_ROW - 1u) / GRID_ROW, min(groups, 1u));
}

fn group_index(workgroup_id: vec3<u32>) -> u32 {
    return workgroup_id.y * GRID_ROW + workgroup_id.x;
}
