// Depths on a lattice of SIDE×SIDE pixels, DEPTHS in all, for finding camera cuts and choosing jitter; see
// depth_lattice.rs of gs3-reconstruct.

@group(0) @binding(0) var<uniform> size: vec2<u32>;
@group(0) @binding(1) var<storage, read> dx_median: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> depths: array<f32>;

@compute @workgroup_size(DEPTHS)
fn sample_depths(@builtin(local_invocation_index) k: u32) {
    let fraction = (vec2<f32>(vec2(k % SIDE, k / SIDE)) + 0.5) / f32(SIDE);
    let at = vec2<u32>(fraction * vec2<f32>(size));
    depths[k] = dx_median[at.y * size.x + at.x].w;
}
