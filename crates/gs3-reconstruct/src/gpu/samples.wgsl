// Writes the current LR frame, margin included, into the history: exact samples in half precision (colours are off by
// at most 2^-12, inverse depths not at all), and the samples' edge slopes beside nearer surfaces. One invocation per
// sample. See samples.rs.

@group(0) @binding(1) var<storage, read> color_alpha: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> dx_median: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> dy_expected: array<vec4<f32>>;
// The history: inverse depth, red and green; blue and ∂x; ∂y and a flag for bare samples.
@group(0) @binding(4) var<storage, read_write> samples_a: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> samples_b: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> samples_c: array<vec2<u32>>;
// The bits of the history's edge slopes: colour change per HR pixel of parallax at depth 1. After them come the corners of exact
// blocks (block_corners.wgsl).
@group(0) @binding(7) var<storage, read_write> edge_slopes: array<u32>;

// The largest inverse depth of sample `at` and the samples around it.
fn nearest_around(at: vec2<u32>) -> f32 {
    let first = max(at, vec2(1u)) - 1u;
    let last = min(at + 1u, frame.past[0].extent - 1u);
    var near = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            near = max(near, inverse_depth(dx_median[y * frame.padded.x + x].w));
        }
    }
    return near;
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn remember(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= frame.past[0].extent) {
        return;
    }
    let i = at.y * frame.padded.x + at.x;
    let per = 1.0 / f32(frame.scale);
    let dx = dx_median[i].xyz * per;
    let dy = dy_expected[i].xyz * per;
    write_sample(newest() + i, color_alpha[i].xyz, dx, dy, inverse_depth(dx_median[i].w), nearest_around(at.xy), CROSSING);
}
