// Data for all kernels of interpolation: the layouts equal InBetweenUniform in interpolate.rs, which a test checks.

// A neighbour of the in-between frame.
struct Neighbor {
    // From the neighbour's HR pixels to the in-between frame's: rows of the homography, and the epipole
    // (Reprojection).
    to_middle: array<vec4<f32>, 3>,
    // The opposite direction.
    from_middle: array<vec4<f32>, 3>,
    // Jitter of the neighbour's samples, LR pixels.
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
