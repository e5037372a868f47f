// Both neighbours' depths; see neighbor_depth.rs and MiddleDepth::splat in middle_depth.rs. One invocation per sample
// of one neighbour. It writes the range of depths visible in its cell, and splats its own depth to the in-between
// frame. The nearest depth wins in any order: bits of non-negative floats are ordered like the floats.

@group(0) @binding(1) var<storage, read> before_median: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> after_median: array<vec4<f32>>;
// Smallest and largest inverse depth visible in each cell of the first neighbour, then of the second.
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2<f32>>;
// Bits of the nearest inverse depth and 1; 0 where there is none.
@group(0) @binding(4) var<storage, read_write> splatted: array<atomic<u32>>;

fn depth_of(neighbor: u32, x: u32, y: u32) -> f32 {
    let i = y * in_between.lr.x + x;
    if neighbor == 0u {
        return inverse_depth(before_median[i].w);
    }
    return inverse_depth(after_median[i].w);
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn scatter_depth(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= in_between.lr) {
        return;
    }
    let neighbor = in_between.neighbors[at.z];
    let next = min(at.xy + 1u, in_between.lr - 1u);
    let w = depth_of(at.z, at.x, at.y);
    let a = depth_of(at.z, next.x, at.y);
    let b = depth_of(at.z, at.x, next.y);
    let c = depth_of(at.z, next.x, next.y);
    let least = min(min(w, a), min(b, c)) * (1.0 - SAME_SURFACE);
    let most = max(max(w, a), max(b, c)) * (1.0 + SAME_SURFACE);
    let samples = in_between.lr.x * in_between.lr.y;
    ranges[at.z * samples + at.y * in_between.lr.x + at.x] = vec2(least, most);

    let scale = f32(in_between.scale);
    let seen = reproject(neighbor.to_middle, (vec2<f32>(at.xy) + 0.5 + neighbor.jitter) * scale, w);
    let to = seen.xy * (1.0 / scale);
    if seen.z > MIN_DIVISOR && all(to >= vec2(0.0)) && all(to < vec2<f32>(in_between.lr)) {
        let cell = vec2<u32>(floor(to));
        atomicMax(&splatted[cell.y * in_between.lr.x + cell.x], bitcast<u32>(max(w * seen.w, 0.0)) + 1u);
    }
}
