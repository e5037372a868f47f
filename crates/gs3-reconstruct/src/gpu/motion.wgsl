// The places of an LR frame's surfaces in another frame; see motion.rs. One invocation per sample.

struct MotionView {
    // From the frame's LR pixels to the other frame's: rows of the homography, and the epipole (Reprojection).
    rows: array<vec4<f32>, 3>,
    lr: vec2<u32>,
    // Jitter of the samples of both frames, LR pixels.
    jitter: vec2<f32>,
    before_jitter: vec2<f32>,
    _pad: vec2<f32>,
}

@group(0) @binding(0) var<uniform> view: MotionView;
@group(0) @binding(1) var<storage, read> now_median: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> before_median: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> flow: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> validity: array<f32>;

fn before_at(x: u32, y: u32) -> f32 {
    return inverse_depth(before_median[y * view.lr.x + x].w);
}

// The indices around `i` in `len` entries; `i` is the middle index except at the ends.
fn around(i: u32, len: u32) -> vec3<u32> {
    let first = min(max(i, 1u) - 1u, max(len, 3u) - 3u);
    return min(vec3(first, first + 1u, first + 2u), vec3(len - 1u));
}

// The smaller of two consecutive differences if they agree in sign (minmod), else 0.
fn slope(a: f32, b: f32, c: f32) -> f32 {
    let left = b - a;
    let right = c - b;
    return select(0.0, min(abs(left), abs(right)), left * right > 0.0);
}

// The inverse depth at (x, y), and the largest difference from it on the same surface.
fn surface_at(x: u32, y: u32) -> vec2<f32> {
    let columns = around(x, view.lr.x);
    let rows = around(y, view.lr.y);
    let w = before_at(x, y);
    let across = slope(before_at(columns.x, y), before_at(columns.y, y), before_at(columns.z, y));
    let down = slope(before_at(x, rows.x), before_at(x, rows.y), before_at(x, rows.z));
    return vec2(w, max(across + down, SAME_SURFACE * w));
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn find_motion(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= view.lr) {
        return;
    }
    let index = vec2<f32>(at.xy);
    let i = at.y * view.lr.x + at.x;
    let own = inverse_depth(now_median[i].w);
    let from_own = index + 0.5 + view.jitter;
    let seen = reproject(view.rows, from_own, own);
    let last = vec2<f32>(view.lr - 1u);
    var moved = vec2(0.0);
    var sum = 0.0;
    if seen.z > MIN_DIVISOR && all(seen.xy >= vec2(0.0)) && all(seen.xy <= vec2<f32>(view.lr)) {
        // Differences first: a resting surface then has no flow, despite rounding of its position.
        moved = seen.xy - from_own + (view.jitter - view.before_jitter);
        let place = clamp(index + moved, vec2(0.0), last);
        let cell = floor(place);
        let along = place - cell;
        let w = own * seen.w;
        for (var k = 0u; k < 4u; k++) {
            let corner = vec2(k % 2u, k / 2u);
            let c = min(vec2<u32>(cell) + corner, view.lr - 1u);
            let surface = surface_at(c.x, c.y);
            let is_alike = (surface.x == 0.0) == (w == 0.0);
            if is_alike && abs(w - surface.x) <= max(surface.y, w * SAME_SURFACE) {
                let weights = select(1.0 - along, along, corner == vec2(1u));
                sum += weights.x * weights.y;
            }
        }
    }
    sum = min(sum, 1.0);
    flow[i] = select(vec2(0.0), moved, sum > 0.0);
    validity[i] = sum;
}
