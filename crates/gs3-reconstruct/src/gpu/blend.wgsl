// The in-between frame from both neighbours; see blend.rs. One invocation per four pixels in a row.

@compute @workgroup_size(PATCHES, LINES)
fn blend(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let corner = patch_corner(at);
    let line = at.y % 4u;
    let quad = quad_at(corner, line, lane);
    let first = corner + vec2(0, i32(line));
    var both: Both;
    both.visibility = quad.visibility;
    if !is_outside(first) {
        // Neighbours that no pixel needs are not gathered.
        var least = 1.0;
        var most = 0.0;
        var is_doubtful = false;
        for (var k = 0; k < 4; k++) {
            let share = share_of(both.visibility[k]);
            least = min(least, share);
            most = max(most, share);
            is_doubtful = is_doubtful || (quad.may_settle && doubtful(both.visibility[k]) > 0.0);
        }
        if is_doubtful || least < 1.0 {
            both.colors[0] = gather_quad(0u, quad.positions, quad.alike.x);
        }
        if is_doubtful || most > 0.0 {
            both.colors[1] = gather_quad(1u, quad.positions, quad.alike.y);
        }
    }
    both = settled(both, quad, corner, line, lane);
    for (var k = 0; k < 4; k++) {
        let x = first.x + k;
        if !is_outside(first) && x >= 0 && x < i32(in_between.size.x) {
            let before = both.colors[0][k];
            let after = both.colors[1][k];
            let by = surer(share_of(both.visibility[k]), before.w, after.w);
            result[u32(first.y) * in_between.size.x + u32(x)] = pack(fma(after - before, vec4(by), before));
        }
    }
}
