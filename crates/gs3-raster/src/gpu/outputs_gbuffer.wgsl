// Image gradients (UpscaleGS, Niedermayr et al. 2025), depth and normal (RaDe-GS, Zhang et al. 2024).

// ∂colour/∂x and the median depth; ∂colour/∂y and the expected depth; the normal and 0.
@group(0) @binding(7) var<storage, read_write> dx_median: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> dy_expected: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> normal: array<vec4<f32>>;

var<workgroup> staged_geometry_a: array<vec4<f32>, BATCH>;
var<workgroup> staged_geometry_b: array<vec2<f32>, BATCH>;

var<private> color_dx: vec3<f32>;
var<private> color_dy: vec3<f32>;
// ∂(1 − T)/∂x and ∂/∂y.
var<private> alpha_d: vec2<f32>;
// Contribution-weighted and median distance along the ray.
var<private> distance_sum: f32;
var<private> median: f32;
var<private> normal_sum: vec3<f32>;

fn stage_outputs(slot: u32, splat: u32, room: u32) {
    staged_geometry_a[slot] = bitcast<vec4<f32>>(splats[3u * room + splat]);
    staged_geometry_b[slot] = bitcast<vec2<f32>>(splats[4u * room + splat].xy);
}

fn add_outputs(slot: u32, s: Splat, color: vec3<f32>, at: Contribution) {
    // g = (A·dx + B·dy, B·dx + C·dy) from the factor.
    let g = vec2(s.l11 * at.u, fma(s.l21, at.u, s.l22 * at.v));
    let alpha_d_splat = at.slope * g;
    let weight_d = fma(vec2(at.t), alpha_d_splat, -alpha_d * at.alpha);
    color_dx = fma(color, vec3(weight_d.x), color_dx);
    color_dy = fma(color, vec3(weight_d.y), color_dy);
    add_mixed(s, color, at, g, alpha_d_splat, alpha_d);
    // A(1 − α) + T·αx = A + weight_d.
    alpha_d += weight_d;

    let a = staged_geometry_a[slot];
    let ray_distance = fma(a.y, at.d.x, fma(a.z, at.d.y, a.x));
    distance_sum = fma(ray_distance, at.weight, distance_sum);
    if at.t > 0.5 {
        median = ray_distance;
    }
    normal_sum = fma(vec3(a.w, staged_geometry_b[slot]), vec3(at.weight), normal_sum);
}

fn write_outputs(pixel: Pixel) {
    // Distances along the ray become depths along z.
    let ray = (pixel.sample - view.center) / view.focal;
    let inv_length = 1.0 / sqrt(fma(ray.x, ray.x, fma(ray.y, ray.y, 1.0)));
    let expected = select(0.0, distance_sum / pixel.alpha * inv_length, pixel.alpha > 0.0);
    // The background shows through T: its share of a derivative is −∂(1 − T)·background.
    let dx = fma(vec3(-alpha_d.x), view.background, color_dx);
    let dy = fma(vec3(-alpha_d.y), view.background, color_dy);
    dx_median[pixel.index] = vec4(dx, median * inv_length);
    dy_expected[pixel.index] = vec4(dy, expected);
    normal[pixel.index] = vec4(normal_sum, 0.0);
    write_mixed(pixel);
}
