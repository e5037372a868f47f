// A sample as the history keeps it: six words less the inverse depth's; history.wgsl reads them.
struct PackedSample {
    red_green: u32,
    // Blue and ∂x.
    b: vec2<u32>,
    // ∂y, and 1 for a bare sample.
    c: vec2<u32>,
}

// `dx` and `dy` are per HR pixel; `w` is the inverse depth.
fn pack_sample(color: vec3<f32>, dx: vec3<f32>, dy: vec3<f32>, w: f32) -> PackedSample {
    let is_bare = w == 0.0 && all(dx == vec3(0.0)) && all(dy == vec3(0.0));
    return PackedSample(
        halves(color.x, color.y),
        vec2(halves(color.z, dx.x), halves(dx.y, dx.z)),
        vec2(halves(dy.x, dy.y), halves(dy.z, select(0.0, 1.0, is_bare))),
    );
}
