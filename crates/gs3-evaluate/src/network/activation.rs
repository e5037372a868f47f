//! Activation functions that networks share.

/// x Φ(x), Φ by Abramowitz and Stegun 7.1.26 (error below 2e-7).
pub(super) fn gelu(x: f32) -> f32 {
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.3275911 * z);
    let tail =
        ((((1.061405429 * t - 1.453152027) * t + 1.421413741) * t - 0.284496736) * t + 0.254829592) * t;
    let erf = (1.0 - tail * (-z * z).exp()).copysign(x);
    0.5 * x * (1.0 + erf)
}
