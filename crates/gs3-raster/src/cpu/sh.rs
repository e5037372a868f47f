//! View-dependent colour from spherical harmonics.

use gs3_scene::gaussians::{SH_C0, SH_C1 as C1, SH_C2 as C2, SH_C3 as C3, SH_C4 as C4};

/// Colour of a Gaussian seen along `direction` (from the camera to the Gaussian, any length), display-encoded RGB, at
/// least 0 (Kerbl et al. 2023). `coefficients` is `[K, 3]` with K = 1, 4, 9, 16 or 25.
#[inline(always)]
pub fn color(coefficients: &[f32], direction: [f32; 3]) -> [f32; 3] {
    if coefficients.len() == 3 {
        return [0, 1, 2].map(|c| (SH_C0 * coefficients[c] + 0.5).max(0.0));
    }
    let inv_length = 1.0 / direction.iter().map(|v| v * v).sum::<f32>().sqrt();
    let [x, y, z] = direction.map(|v| v * inv_length);
    let mut basis = [0.0; 25];
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
            if coefficients.len() > 48 {
                basis[16] = C4[0] * x * y * (xx - yy);
                basis[17] = C4[1] * y * z * (3.0 * xx - yy);
                basis[18] = C4[2] * x * y * (7.0 * zz - 1.0);
                basis[19] = C4[3] * y * z * (7.0 * zz - 3.0);
                basis[20] = C4[4] * (zz * (35.0 * zz - 30.0) + 3.0);
                basis[21] = C4[5] * x * z * (7.0 * zz - 3.0);
                basis[22] = C4[6] * (xx - yy) * (7.0 * zz - 1.0);
                basis[23] = C4[7] * x * z * (xx - 3.0 * yy);
                basis[24] = C4[8] * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
            }
        }
    }
    // Four lanes a coefficient, the fourth unused, so that the sum runs on one vector. The last row has no fourth
    // number.
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
