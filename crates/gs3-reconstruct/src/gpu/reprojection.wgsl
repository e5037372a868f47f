// The place of pixel `at` with inverse depth `w` in another camera, the divisor and its reciprocal; see reprojection.rs.
fn reproject(rows: array<vec4<f32>, 3>, at: vec2<f32>, w: f32) -> vec4<f32> {
    let a = reproject_row(rows[0], at, w);
    let b = reproject_row(rows[1], at, w);
    let q = reproject_row(rows[2], at, w);
    // Devices divide within 2.5 units in the last place. A step of Newton's method then gives the CPU's reciprocal in nearly all
    // cases, so that a sample that lands beside a pixel's edge reaches the same pixels.
    let near = 1.0 / q;
    // Not for 0, which has an infinite reciprocal.
    let per = select(near, fma(fma(-q, near, 1.0), near, near), abs(q) > MIN_DIVISOR);
    return vec4(a * per, b * per, q, per);
}

fn reproject_row(row: vec4<f32>, at: vec2<f32>, w: f32) -> f32 {
    return fma(at.x, row.x, fma(at.y, row.y, fma(w, row.w, row.z)));
}

// Inverse view-space depth; 0 where there is no surface.
fn inverse_depth(z: f32) -> f32 {
    return select(0.0, 1.0 / z, z > NEAREST_DEPTH);
}
