// Without the mixed derivative.

fn add_mixed(
    s: Splat, color: vec3<f32>, at: Contribution, g: vec2<f32>, alpha_d_splat: vec2<f32>, alpha_d: vec2<f32>,
) {}

fn write_mixed(pixel: Pixel) {}
