// The mixed derivative ∂²colour/∂x∂y.

@group(0) @binding(10) var<storage, read_write> dxdy: array<vec4<f32>>;

var<private> color_dxy: vec3<f32>;
var<private> alpha_dxy: f32;

fn add_mixed(
    s: Splat, color: vec3<f32>, at: Contribution, g: vec2<f32>, alpha_d_splat: vec2<f32>, alpha_d: vec2<f32>,
) {
    let alpha_xy = at.slope * fma(g.x * g.y, UNSCALE, -s.l11 * s.l21);
    let cross = fma(alpha_d.x, alpha_d_splat.y, alpha_d.y * alpha_d_splat.x);
    let weight = fma(at.t, alpha_xy, -cross) - alpha_dxy * at.alpha;
    color_dxy = fma(color, vec3(weight), color_dxy);
    alpha_dxy += weight;
}

fn write_mixed(pixel: Pixel) {
    dxdy[pixel.index] = vec4(fma(vec3(-alpha_dxy), view.background, color_dxy), 0.0);
}
