// A sample of the history: three planes of two words each, 24 bytes; see samples.wgsl, which writes them.
struct Sample {
    color: vec3<f32>,
    // Per HR pixel.
    dx: vec3<f32>,
    dy: vec3<f32>,
    // There is no surface, and the colour is constant.
    is_bare: bool,
}

fn unpack_sample(red_green: u32, b: vec2<u32>, c: vec2<u32>) -> Sample {
    let rg = unpack2x16float(red_green);
    let b_dxr = unpack2x16float(b.x);
    let dxgb = unpack2x16float(b.y);
    let dyrg = unpack2x16float(c.x);
    let dyb_bare = unpack2x16float(c.y);
    return Sample(
        vec3(rg, b_dxr.x), vec3(b_dxr.y, dxgb), vec3(dyrg, dyb_bare.x), dyb_bare.y != 0.0,
    );
}
