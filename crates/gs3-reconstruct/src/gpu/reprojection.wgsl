// The place of pixel `at` with inverse depth `w` in another camera, and the divisor; see reprojection.rs.
fn reproject(rows: array<vec4<f32>, 3>, at: vec2<f32>, w: f32) -> vec3<f32> {
    let a = reproject_row(rows[0], at, w);
    let b = reproject_row(rows[1], at, w);
    let q = reproject_row(rows[2], at, w);
    let per = 1.0 / q;
    return vec3(a * per, b * per, q);
}

fn reproject_row(row: vec4<f32>, at: vec2<f32>, w: f32) -> f32 {
    return fma(at.x, row.x, fma(at.y, row.y, fma(w, row.w, row.z)));
}

// Inverse view-space depth; 0 where there is no surface.
fn inverse_depth(z: f32) -> f32 {
    return select(0.0, 1.0 / z, z > NEAREST_DEPTH);
}
