// Derivatives of colour, and the median depth, for outputs_gbuffer.wgsl and outputs_blocks.wgsl.

var<workgroup> staged_geometry_a: array<vec4<f32>, BATCH>;

var<private> color_dx: vec3<f32>;
var<private> color_dy: vec3<f32>;
// ∂(1 − T)/∂x and ∂/∂y.
var<private> alpha_d: vec2<f32>;
// Median distance along the ray.
var<private> median: f32;

fn stage_plane(slot: u32, splat: u32, room: u32) {
    staged_geometry_a[slot] = bitcast<vec4<f32>>(splats[3u * room + splat]);
}

// Half the slopes of the exponent: (A·dx + B·dy, B·dx + C·dy) from the factor.
fn gradient_of(s: Splat, at: Contribution) -> vec2<f32> {
    return vec2(s.l11 * at.u, fma(s.l21, at.u, s.l22 * at.v));
}

// Adds a splat, whose α has the slopes `alpha_d_splat`. Returns its distance along the ray.
fn add_derivatives(slot: u32, color: vec3<f32>, at: Contribution, alpha_d_splat: vec2<f32>) -> f32 {
    let weight_d = fma(vec2(at.t), alpha_d_splat, -alpha_d * at.alpha);
    color_dx = fma(color, vec3(weight_d.x), color_dx);
    color_dy = fma(color, vec3(weight_d.y), color_dy);
    // A(1 − α) + T·αx = A + weight_d.
    alpha_d += weight_d;

    let a = staged_geometry_a[slot];
    let ray_distance = fma(a.y, at.d.x, fma(a.z, at.d.y, a.x));
    if at.t > 0.5 {
        median = ray_distance;
    }
    return ray_distance;
}

// The background shows through T: its share of a derivative is −∂(1 − T)·background.
fn dx_over_background() -> vec3<f32> {
    return fma(vec3(-alpha_d.x), view.background, color_dx);
}

fn dy_over_background() -> vec3<f32> {
    return fma(vec3(-alpha_d.y), view.background, color_dy);
}

// Distances along the ray through `sample` times this number are depths along z.
fn depth_per_distance(sample: vec2<f32>) -> f32 {
    let ray = (sample - view.center) / view.focal;
    return 1.0 / sqrt(fma(ray.x, ray.x, fma(ray.y, ray.y, 1.0)));
}
