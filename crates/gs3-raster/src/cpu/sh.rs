//! View-dependent colour from spherical harmonics.

use gs3_scene::gaussians::SH_C0;

pub const C1: f32 = 0.488_602_511_902_919_9;
const C2: [f32; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
const C3: [f32; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// Colour of a Gaussian seen along `direction` (from the camera to the Gaussian, any length), display-encoded RGB, at
/// least 0 (Kerbl et al. 2023). `coefficients` is `[K, 3]` with K = 1, 4, 9 or 16.
#[inline(always)]
pub fn color(coefficients: &[f32], direction: [f32; 3]) -> [f32; 3] {
    if coefficients.len() == 3 {
        return [0, 1, 2].map(|c| (SH_C0 * coefficients[c] + 0.5).max(0.0));
    }
    let inv_length = 1.0 / direction.iter().map(|v| v * v).sum::<f32>().sqrt();
    let [x, y, z] = direction.map(|v| v * inv_length);
    let mut basis = [0.0; 16];
    basis[0] = SH_C0;
    basis[1] = -C1 * y;
    basis[2] = C1 * z;
    basis[3] = -C1 * x;
    if coefficients.len() > 12 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        basis[4] = C2[0] * x * y;
        basis[5] = C2[1] * y * z;
        basis[6] = C2[2] * (2.0 * zz - xx - yy);
        basis[7] = C2[3] * x * z;
        basis[8] = C2[4] * (xx - yy);
        if coefficients.len() > 27 {
            basis[9] = C3[0] * y * (3.0 * xx - yy);
            basis[10] = C3[1] * x * y * z;
            basis[11] = C3[2] * y * (4.0 * zz - xx - yy);
            basis[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
            basis[13] = C3[4] * x * (4.0 * zz - xx - yy);
            basis[14] = C3[5] * z * (xx - yy);
            basis[15] = C3[6] * x * (xx - 3.0 * yy);
        }
    }
    // Four lanes a coefficient, the fourth unused, so that the sum runs on one vector; the last row has no fourth.
    let mut sum = [0.5; 4];
    let last = coefficients.len() / 3 - 1;
    for k in 0..last {
        let rgb = &coefficients[3 * k..3 * k + 4];
        for c in 0..4 {
            sum[c] += basis[k] * rgb[c];
        }
    }
    [0, 1, 2].map(|c| (sum[c] + basis[last] * coefficients[3 * last + c]).max(0.0))
}
