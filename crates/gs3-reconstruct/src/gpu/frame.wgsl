// Data of a frame for all kernels of super sampling: the layouts equal FrameUniform in frame.rs, which a test
// checks.

// A remembered LR frame, or a layer: exact blocks of one LR frame.
struct Past {
    // Rows of the homography from the frame's HR pixels to the current ones, and the epipole (Reprojection).
    rows: array<vec4<f32>, 3>,
    // Offset of an LR frame's samples from the LR pixel centres of the picture, in LR pixels: the jitter less the
    // margin.
    offset: vec2<f32>,
    // The number of its first sample.
    first: u32,
    // Parallax at depth 1 between the frame's camera and the current one, in HR pixels.
    parallax: f32,
    // Columns and rows of samples, with the margin; and the number of samples, counted row by row: the last rows may have
    // none.
    extent: vec2<u32>,
    count: u32,
    // In frames.
    age: u32,
}

struct Frame {
    // HR pixels.
    size: vec2<u32>,
    // LR samples of the picture.
    lr: vec2<u32>,
    scale: u32,
    // Remembered LR frames, the current one included; and layers of exact blocks.
    frames: u32,
    layers: u32,
    // The number of the first sample of exact blocks: those of LR frames come before.
    first_of_blocks: u32,
    // Scale 1/scale and this offset map an HR position, pixel centres at whole numbers, to a cell of four samples.
    cell_offset: vec2<f32>,
    // The first pixel with a sample on it; every scale-th follows. Beyond all pixels if samples are not on pixel
    // centres.
    first_sampled: vec2<u32>,
    // Capacity in samples, with a margin.
    padded: vec2<u32>,
    // Where the corners of exact blocks begin in `edge_slopes` (block_corners.wgsl).
    first_of_corners: u32,
    _pad: u32,
    // Per phase of a pixel within an LR pixel: the sample at or before it, relative to the LR pixel, and the fraction
    // of the way to the next sample (SampleAxis). Columns, then rows.
    x_places: array<vec4<f32>, 8>,
    y_places: array<vec4<f32>, 8>,
    // LR frames by age, entry 0 is the current frame; then layers.
    past: array<Past, 80>,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// The part of the history that holds the current frame.
fn newest() -> u32 {
    return frame.past[0].first;
}
