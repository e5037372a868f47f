// Inputs of the super-sampling network, channels last; see SuperSampleFeatures in learned/features.rs.

struct Features {
    // HR pixels.
    size: vec2<u32>,
    // LR samples.
    lr: vec2<u32>,
    // Jitter of the samples, in LR pixels.
    jitter: vec2<f32>,
    // Focal lengths of the LR camera, in pixels.
    focal: vec2<f32>,
    center: vec2<f32>,
    _pad: vec2<f32>,
}

@group(0) @binding(0) var<uniform> features: Features;
@group(0) @binding(1) var<storage, read> color_alpha: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> dx_median: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> dy_expected: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> color: array<f32>;
@group(0) @binding(6) var<storage, read_write> gradients: array<f32>;
@group(0) @binding(7) var<storage, read_write> compressed: array<f32>;
@group(0) @binding(8) var<storage, read_write> geometry: array<f32>;
@group(0) @binding(9) var<storage, read_write> jitter: array<vec2<f32>>;
// Sums and counts of the inverse depths of pixels that show a surface, one pair per workgroup.
@group(0) @binding(10) var<storage, read_write> sums: array<vec2<f32>>;
// The analytic frame, halves; then the share: at first the previous frame's visibility, later its weight.
@group(0) @binding(11) var<storage, read> history: array<vec2<u32>>;
@group(0) @binding(12) var<storage, read_write> share: array<f32>;
// The innovation: the difference of the samples from the history, and its interpolation between the samples.
@group(0) @binding(13) var<storage, read> innovation: array<vec4<f32>>;
@group(0) @binding(14) var<storage, read_write> drift: array<f32>;
// The previous refined frame at the current camera, halves, and the difference of the samples from it.
@group(0) @binding(15) var<storage, read> previous: array<vec2<u32>>;
@group(0) @binding(16) var<storage, read_write> previous_innovation: array<f32>;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn planes(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= features.lr) {
        return;
    }
    let i = at.y * features.lr.x + at.x;
    let rgb = color_alpha[i];
    let dx = dx_median[i];
    let dy = dy_expected[i];
    for (var c = 0u; c < 3u; c++) {
        color[3u * i + c] = rgb[c];
        gradients[6u * i + c] = dx[c];
        gradients[6u * i + 3u + c] = dy[c];
        compressed[6u * i + c] = dx[c] / (1.0 + abs(dx[c]));
        compressed[6u * i + 3u + c] = dy[c] / (1.0 + abs(dy[c]));
    }
    jitter[i] = features.jitter;
}

fn inverse(z: f32) -> f32 {
    return select(0.0, 1.0 / z, z > NEAREST_DEPTH);
}

@compute @workgroup_size(THREADS)
fn sum_depths(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    var own = vec2(0.0);
    let count = features.lr.x * features.lr.y;
    for (var i = group.x * THREADS + lane; i < count; i += PARTS * THREADS) {
        let w = inverse(dx_median[i].w);
        own += select(vec2(0.0), vec2(w, 1.0), w > 0.0);
    }
    let all = summed(lane, own);
    if lane == 0u {
        sums[group.x] = all;
    }
}

@compute @workgroup_size(THREADS)
fn geometry_of(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    var part = vec2(0.0);
    if lane < PARTS {
        part = sums[lane];
    }
    let typical = mean_of(summed(lane, part));
    let at = vec2(group.x * THREADS + lane, group.y);
    if at.x >= features.lr.x {
        return;
    }
    let i = at.y * features.lr.x + at.x;
    let ray = vec3((vec2<f32>(at) + 0.5 + features.jitter - features.center) / features.focal, 1.0);
    let w = inverse(dx_median[i].w);
    geometry[3u * i] = w / (w + typical);
    geometry[3u * i + 1u] = -dot(normal[i].xyz, ray) / length(ray);
    geometry[3u * i + 2u] = color_alpha[i].w;
}

// Runs before `shares`: `share` is still the previous frame's visibility.
@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn previous_innovations(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= features.lr) {
        return;
    }
    let i = at.y * features.lr.x + at.x;
    let scale = f32(features.size.x / features.lr.x);
    let pixel = min(vec2<u32>((vec2<f32>(at.xy) + 0.5 + features.jitter) * scale), features.size - 1u);
    let k = pixel.y * features.size.x + pixel.x;
    let differs = share[k] * (color_alpha[i].xyz - vec3(unpack2x16float(previous[k].x), unpack2x16float(previous[k].y).x));
    previous_innovation[3u * i] = differs.x;
    previous_innovation[3u * i + 1u] = differs.y;
    previous_innovation[3u * i + 2u] = differs.z;
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn shares(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= features.size) {
        return;
    }
    let i = at.y * features.size.x + at.x;
    let uncertainty = unpack2x16float(history[i].y).y;
    share[i] *= min(uncertainty / UNCERTAIN, 1.0);
}

// The innovation between the samples: bilinear, and constant beyond the outermost samples.
@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn drifts(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= features.size) {
        return;
    }
    let i = at.y * features.size.x + at.x;
    let scale = f32(features.size.x / features.lr.x);
    let last = features.lr - 1u;
    let place = clamp((vec2<f32>(at.xy) + 0.5) / scale - 0.5 - features.jitter, vec2(0.0), vec2<f32>(last));
    let first = vec2<u32>(place);
    let next = min(first + 1u, last);
    let along = place - floor(place);
    let rows = vec2(first.y, next.y) * features.lr.x;
    let left = mix(innovation[rows.x + first.x], innovation[rows.y + first.x], along.y);
    let right = mix(innovation[rows.x + next.x], innovation[rows.y + next.x], along.y);
    let uncertain = min(unpack2x16float(history[i].y).y / UNCERTAIN, 1.0);
    let between = mix(left, right, along.x) * uncertain;
    drift[3u * i] = between.x;
    drift[3u * i + 1u] = between.y;
    drift[3u * i + 2u] = between.z;
}
