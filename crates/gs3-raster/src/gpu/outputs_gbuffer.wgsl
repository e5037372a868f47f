// Image gradients (UpscaleGS, Niedermayr et al. 2025), depth and normal (RaDe-GS, Zhang et al. 2024).

// ∂colour/∂x and the median depth; ∂colour/∂y and the expected depth; the normal and 0.
@group(0) @binding(7) var<storage, read_write> dx_median: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> dy_expected: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> normal: array<vec4<f32>>;

var<workgroup> staged_geometry_b: array<vec2<f32>, BATCH>;

// Contribution-weighted distance along the ray.
var<private> distance_sum: f32;
var<private> normal_sum: vec3<f32>;

fn stage_outputs(slot: u32, splat: u32, room: u32) {
    stage_plane(slot, splat, room);
    staged_geometry_b[slot] = bitcast<vec2<f32>>(splats[4u * room + splat].xy);
}

fn add_outputs(slot: u32, s: Splat, color: vec3<f32>, at: Contribution) {
    let g = gradient_of(s, at);
    let alpha_d_splat = at.slope * g;
    add_mixed(s, color, at, g, alpha_d_splat, alpha_d);
    let ray_distance = add_derivatives(slot, color, at, alpha_d_splat);
    distance_sum = fma(ray_distance, at.weight, distance_sum);
    normal_sum = fma(vec3(staged_geometry_a[slot].w, staged_geometry_b[slot]), vec3(at.weight), normal_sum);
}

fn write_outputs(pixel: Pixel) {
    let per_distance = depth_per_distance(pixel.sample);
    let expected = select(0.0, distance_sum / pixel.alpha * per_distance, pixel.alpha > 0.0);
    dx_median[pixel.index] = vec4(dx_over_background(), median * per_distance);
    dy_expected[pixel.index] = vec4(dy_over_background(), expected);
    normal[pixel.index] = vec4(normal_sum, 0.0);
    write_mixed(pixel);
}
