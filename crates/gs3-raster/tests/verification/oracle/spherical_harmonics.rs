//! View-dependent colour, in the sign convention and order of Kerbl et al. 2023.

use glam::DVec3;

const C0: f64 = 0.28209479177387814;
const C1: f64 = 0.4886025119029199;
const C2: [f64; 5] =
    [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const C3: [f64; 7] = [
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
];

/// The colour of coefficients `[(degree + 1)², 3]` seen along `direction` (from the camera, any length).
pub fn color(degree: u8, coefficients: &[f32], direction: DVec3) -> [f64; 3] {
    let basis = basis(direction.normalize());
    let used = (usize::from(degree) + 1).pow(2);
    std::array::from_fn(|c| {
        let sum: f64 = (0..used).map(|k| basis[k] * f64::from(coefficients[3 * k + c])).sum();
        (sum + 0.5).max(0.0)
    })
}

/// The 25 basis functions of degrees 0 to 4 in unit direction `d`. Signs of degree 4 alternate with the order, as below it.
pub fn basis(d: DVec3) -> [f64; 25] {
    let [x, y, z] = d.to_array();
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let root = |over: f64, under: f64| (over / (under * std::f64::consts::PI)).sqrt();
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        C2[1] * y * z,
        C2[2] * (2.0 * zz - xx - yy),
        C2[3] * x * z,
        C2[4] * (xx - yy),
        C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        C3[4] * x * (4.0 * zz - xx - yy),
        C3[5] * z * (xx - yy),
        C3[6] * x * (xx - 3.0 * yy),
        0.75 * root(35.0, 1.0) * x * y * (xx - yy),
        -0.75 * root(35.0, 2.0) * y * (3.0 * xx - yy) * z,
        0.75 * root(5.0, 1.0) * x * y * (7.0 * zz - 1.0),
        -0.75 * root(5.0, 2.0) * y * z * (7.0 * zz - 3.0),
        0.1875 * root(1.0, 1.0) * (35.0 * zz * zz - 30.0 * zz + 3.0),
        -0.75 * root(5.0, 2.0) * x * z * (7.0 * zz - 3.0),
        0.375 * root(5.0, 1.0) * (xx - yy) * (7.0 * zz - 1.0),
        -0.75 * root(35.0, 2.0) * x * (xx - 3.0 * yy) * z,
        0.1875 * root(35.0, 1.0) * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)),
    ]
}
