// Inputs of the interpolation network, channels last; see InterpolateFeatures in learned/features.rs.

struct Features {
    // LR samples.
    lr: vec2<u32>,
    // Time, 0 at the first neighbour and 1 at the second.
    t: f32,
    _pad: u32,
}

@group(0) @binding(0) var<uniform> features: Features;
// Inverse depths of the in-between frame.
@group(0) @binding(1) var<storage, read> middle: array<f32>;
@group(0) @binding(2) var<storage, read_write> geometry: array<vec2<f32>>;
// Depths of the in-between frame in the fourth channel, in a G-buffer's layout. They say where its hidden state moves
// in the next in-between frame.
@group(0) @binding(3) var<storage, read_write> median: array<vec4<f32>>;
// Sums and counts of the inverse depths of pixels that show a surface, one pair per workgroup.
@group(0) @binding(4) var<storage, read_write> sums: array<vec2<f32>>;

@compute @workgroup_size(THREADS)
fn sum_depths(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    var own = vec2(0.0);
    let count = features.lr.x * features.lr.y;
    for (var i = group.x * THREADS + lane; i < count; i += PARTS * THREADS) {
        let w = middle[i];
        own += select(vec2(0.0), vec2(w, 1.0), w > 0.0);
        median[i] = vec4(0.0, 0.0, 0.0, select(0.0, 1.0 / w, w > 0.0));
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
    geometry[i] = vec2(middle[i] / (middle[i] + typical), features.t);
}
