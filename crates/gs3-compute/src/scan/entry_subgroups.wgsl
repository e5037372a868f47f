@compute @workgroup_size(THREADS)
fn sum(
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
    @builtin(workgroup_id) group: vec3<u32>,
) {
    sum_block(Thread(subgroup * size + lane, subgroup, lane, size), group.x);
}

@compute @workgroup_size(THREADS)
fn scan(
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
    @builtin(workgroup_id) group: vec3<u32>,
) {
    scan_block(Thread(subgroup * size + lane, subgroup, lane, size), group.x);
}
