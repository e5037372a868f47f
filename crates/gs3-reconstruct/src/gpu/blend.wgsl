// The in-between frame from both neighbours; see blend.rs. One invocation per four pixels in a row.

@compute @workgroup_size(PATCHES, LINES)
fn blend(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = first_pixel(at);
    var both = both_at(at, lane, false);
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
