// Where each tile's entries lie among the sorted ones. `clear` empties all tiles first.


@group(0) @binding(0) var<storage, read_write> counters: Counters;
@group(0) @binding(1) var<storage, read> entry_tiles: array<u32>;
// First entry and the one after the last; a tile after the band's takes what is not drawn.
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2<u32>>;

@compute @workgroup_size(GROUP)
fn clear(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group_index(workgroup) * GROUP + lane;
    if tile < arrayLength(&ranges) {
        ranges[tile] = vec2(0u);
    }
}

@compute @workgroup_size(GROUP)
fn find(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(workgroup) * GROUP + lane;
    if i >= counters.entries {
        return;
    }
    let tile = entry_tiles[i];
    if i == 0u || entry_tiles[i - 1u] != tile {
        ranges[tile].x = i;
    }
    if i + 1u == counters.entries || entry_tiles[i + 1u] != tile {
        ranges[tile].y = i + 1u;
    }
}
