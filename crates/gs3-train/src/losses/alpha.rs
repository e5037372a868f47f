//! What a learned blend departs from the blend by visibility.

use super::Interior;

/// The sum of α² over the interior of `alpha`, `[height, width]`. Adds `factor` times its derivative to `v`.
///
/// The paper weighs |α|₂ of its whole blend. Here the blend starts at what time and visibility say, so it is the
/// learned departure that is kept small; its square, so that terms of frames and items add up.
pub fn square(interior: &Interior, alpha: &[f32], factor: f32, v: &mut [f32]) -> f64 {
    let row = |span: std::ops::Range<usize>| {
        let mut sum = 0.0_f64;
        for (alpha, v) in alpha[span.clone()].iter().zip(&mut v[span]) {
            sum += f64::from(alpha * alpha);
            *v += 2.0 * factor * alpha;
        }
        sum
    };
    interior.pixel_spans().map(row).sum()
}
