// What all kernels of interpolation know: beside InBetweenUniform in interpolate.rs, layouts compared by a test.

// A neighbour of the in-between frame.
struct Neighbor {
    // From its HR pixels to those of the in-between frame: rows of the homography, and the epipole (Reprojection).
    to_middle: array<vec4<f32>, 3>,
    // And back.
    from_middle: array<vec4<f32>, 3>,
    // Of its samples, LR pixels.
    jitter: vec2<f32>,
    _pad: vec2<f32>,
}

struct InBetween {
    // HR pixels.
    size: vec2<u32>,
    // LR samples.
    lr: vec2<u32>,
    scale: u32,
    // Where the first whole patch begins.
    offset: u32,
    // Time, 0 at the first neighbour and 1 at the second.
    t: f32,
    _pad: u32,
    neighbors: array<Neighbor, 2>,
}

@group(0) @binding(0) var<uniform> in_between: InBetween;
