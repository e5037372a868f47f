// Both neighbours at the pose of the in-between frame, not blended; see Warp::separate in separate.rs. One invocation
// per four pixels in a row.

// HR, row by row.
@group(0) @binding(6) var<storage, read_write> visibility: array<f32>;
@group(0) @binding(7) var<storage, read_write> second_result: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> share: array<f32>;

// The first neighbour, and its visibility.
@compute @workgroup_size(PATCHES, LINES)
fn separate(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let quad = quad_at(patch_corner(at), at.y % 4u, lane);
    let first = first_pixel(at);
    if is_outside(first) {
        return;
    }
    let row = gather_quad(0u, quad.positions, quad.alike.x);
    var seen = quad.visibility;
    var colors = row;
    for (var k = 0; k < 4; k++) {
        let x = first.x + k;
        if x >= 0 && x < i32(in_between.size.x) {
            let i = u32(first.y) * in_between.size.x + u32(x);
            result[i] = pack(colors[k]);
            visibility[i] = seen[k].x;
        }
    }
}

// Both neighbours, and the second neighbour's share of their blend.
@compute @workgroup_size(PATCHES, LINES)
fn separate_both(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = first_pixel(at);
    var both = both_at(at, lane, true);
    for (var k = 0; k < 4; k++) {
        let x = first.x + k;
        if !is_outside(first) && x >= 0 && x < i32(in_between.size.x) {
            let i = u32(first.y) * in_between.size.x + u32(x);
            let before = both.colors[0][k];
            let after = both.colors[1][k];
            result[i] = pack(before);
            second_result[i] = pack(after);
            share[i] = surer(share_of(both.visibility[k]), before.w, after.w);
        }
    }
}
