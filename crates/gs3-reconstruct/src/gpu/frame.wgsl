// What all kernels of super sampling know of a frame: beside FrameUniform in super_sample.rs, layouts compared by a
// test.

// A remembered frame.
struct Past {
    // Rows of the homography from its HR pixels to the current ones, and the epipole (Reprojection).
    rows: array<vec4<f32>, 3>,
    // Of its samples from LR pixel centres of the picture, LR pixels: the jitter less the margin.
    offset: vec2<f32>,
    // Which part of the history holds it.
    slot: u32,
    // Parallax at depth 1 between its camera and the current one, HR pixels.
    parallax: f32,
    // Samples, those in the margin included, and how many of the margin come before the picture's.
    extent: vec2<u32>,
    margin: vec2<u32>,
}

struct Frame {
    // HR pixels.
    size: vec2<u32>,
    // LR samples of the picture.
    lr: vec2<u32>,
    scale: u32,
    // Remembered frames, the current one included.
    frames: u32,
    // HR position, pixel centres at whole numbers, to cell of four samples: times 1/scale, plus this.
    cell_offset: vec2<f32>,
    // The first pixel that a sample lies on, every scale-th; beyond all pixels if samples lie beside the centres.
    first_sampled: vec2<u32>,
    // Samples that there is room for with a margin.
    padded: vec2<u32>,
    // Per phase of a pixel within an LR pixel: the sample at or before it, relative to the LR pixel, and the way to
    // the next (SampleAxis). Columns, then rows.
    x_places: array<vec4<f32>, 8>,
    y_places: array<vec4<f32>, 8>,
    // By age; the first is the current frame.
    past: array<Past, 64>,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// The part of the history that the current frame is in.
fn newest() -> u32 {
    return frame.past[0].slot * frame.padded.x * frame.padded.y;
}

// The place in the history of the current frame's sample `at` of the picture.
fn id_in_picture(at: vec2<u32>) -> u32 {
    let place = at + frame.past[0].margin;
    return newest() + place.y * frame.padded.x + place.x;
}
