// Writes sample `to` of the history; `dx` and `dy` are per HR pixel, `w` is its inverse depth, and `near` the largest inverse
// depth around it. `crossing` is CROSSING or CROSSING_OF_BLOCKS. The sample's edge slope is the colour change per HR pixel of
// parallax at depth 1; see `edge_slopes` in samples/chunk.rs.
fn write_sample(to: u32, color: vec3<f32>, dx: vec3<f32>, dy: vec3<f32>, w: f32, near: f32, crossing: f32) {
    let packed = pack_sample(color, dx, dy, w);
    samples_a[to] = vec2(bitcast<u32>(w), packed.red_green);
    samples_b[to] = packed.b;
    samples_c[to] = packed.c;
    let slope = sqrt(dot(dx, dx) + dot(dy, dy));
    edge_slopes[to] = bitcast<u32>(select(0.0, crossing * (near - w) * slope, w < near * EDGE_RATIO));
}
