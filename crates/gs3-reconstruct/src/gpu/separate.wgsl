// The first neighbour at the pose between, unblended, and how well it is seen there; see Warp::separate in separate.rs. An
// invocation four pixels in a row.

// HR, row by row.
@group(0) @binding(6) var<storage, read_write> visibility: array<f32>;

@compute @workgroup_size(PATCHES, LINES)
fn separate(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let start = select(0, i32(between.offset) - 4, between.offset > 0u);
    let line = at.y % 4u;
    let patch_corner = vec2<i32>(vec2(at.x * 4u, at.y - line)) + start;
    let quad = quad_at(patch_corner, line, lane);
    let first = patch_corner + vec2(0, i32(line));
    if any(first >= vec2<i32>(between.size)) || first.y < 0 {
        return;
    }
    let row = gather_quad(0u, quad.positions, quad.alike.x);
    var seen = quad.visibility;
    var colors = row;
    for (var k = 0; k < 4; k++) {
        let x = first.x + k;
        if x >= 0 && x < i32(between.size.x) {
            let i = u32(first.y) * between.size.x + u32(x);
            result[i] = pack(colors[k]);
            visibility[i] = seen[k].x;
        }
    }
}
