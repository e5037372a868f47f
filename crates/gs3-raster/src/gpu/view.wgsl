// The camera as kernels read it: beside ViewUniform in view.rs, layouts compared by a test.

struct View {
    // World to view rotation, rows.
    rotation: array<vec4<f32>, 3>,
    // Half spaces of view space, left, right, top, bottom: coefficients of the coordinate and of z, the pair's length,
    // and the factor of the largest scale (Frustum in chunk.rs).
    frustum: array<vec4<f32>, 4>,
    // Camera centre in world space, and what its rounding to f32 left, along the axes of view space.
    origin: vec3<f32>,
    dilation: f32,
    origin_rest: vec3<f32>,
    // Gaussians up to this z are culled.
    near: f32,
    background: vec3<f32>,
    _pad2: f32,
    // Pixels; samples lie at integers.
    focal: vec2<f32>,
    center: vec2<f32>,
    // Least and largest x/z and y/z inside the Jacobian.
    jacobian_low: vec2<f32>,
    jacobian_high: vec2<f32>,
    size: vec2<u32>,
    // From a row of the planes to the next.
    stride: u32,
    // Pixels of the picture along a side of a sample's cell: 1 if nothing but samples is made.
    scale: u32,
    // How far a cell's first and last pixels lie before and after its sample, in samples; 0 if nothing but samples is made.
    cell_before: vec2<f32>,
    cell_after: vec2<f32>,
    // Pixels of the picture; samples of the margin left of and above the picture.
    picture: vec2<u32>,
    margin: vec2<u32>,
    // Position of the picture's first sample in pixels of the picture.
    first_sample: vec2<f32>,
    // Not 0 if pixels between the samples may be made.
    has_blocks: u32,
    _pad3: u32,
}

@group(0) @binding(0) var<uniform> view: View;

fn rotate(v: vec3<f32>) -> vec3<f32> {
    return vec3(dot3(view.rotation[0].xyz, v), dot3(view.rotation[1].xyz, v), dot3(view.rotation[2].xyz, v));
}

// As the CPU sums: z first.
fn dot3(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z));
}
