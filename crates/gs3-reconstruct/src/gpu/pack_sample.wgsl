// A sample as the history keeps it: six words less the inverse depth's; history.wgsl reads them.
struct PackedSample {
    red_green: u32,
    // Blue and ∂x.
    b: vec2<u32>,
    // ∂y, and 1 for a bare sample.
    c: vec2<u32>,
}

// `dx` and `dy` are per LR pixel; `w` is the inverse depth.
fn pack_sample(color: vec3<f32>, dx: vec3<f32>, dy: vec3<f32>, w: f32) -> PackedSample {
    let per = 1.0 / f32(frame.scale);
    let hx = dx * per;
    let hy = dy * per;
    let is_bare = w == 0.0 && all(hx == vec3(0.0)) && all(hy == vec3(0.0));
    return PackedSample(
        halves(color.x, color.y),
        vec2(halves(color.z, hx.x), halves(hx.y, hx.z)),
        vec2(halves(hy.x, hy.y), halves(hy.z, select(0.0, 1.0, is_bare))),
    );
}
