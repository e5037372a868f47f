//! Loss of sharpness.

use std::ops::Range;

use super::charbonnier::LANES;
use super::{CHANNELS, Interior};

/// |∇²e|₁, ∇² the sum of the four neighbours less four times the pixel: edges that are blurred or ring.
#[derive(Clone, Debug, Default)]
pub struct Laplacian {
    /// Signs of ∇²e; 0 outside the interior.
    signs: Vec<f32>,
}

impl Laplacian {
    /// The sum of |∇²e| over the interior of error image `e`. Adds `factor` times its derivative to `v`.
    pub fn add(&mut self, interior: &Interior, e: &[f32], factor: f32, v: &mut [f32]) -> f64 {
        self.signs.clear();
        self.signs.resize(interior.len(), 0.0);
        let mut sum = 0.0;
        for span in interior.spans(0) {
            let signs = &mut self.signs[span.clone()];
            laplacian(interior, e, span, |k, value| signs[k] = value);
            let mut sums = [0.0_f32; LANES];
            for signs in signs.chunks_mut(LANES) {
                for (sign, sum) in signs.iter_mut().zip(&mut sums) {
                    *sum += sign.abs();
                    *sign = f32::from(*sign > 0.0) - f32::from(*sign < 0.0);
                }
            }
            sum += sums.iter().map(|v| f64::from(*v)).sum::<f64>();
        }
        // The operator is its own adjoint; it reaches one pixel beyond.
        for span in interior.spans(1) {
            let v = &mut v[span.clone()];
            laplacian(interior, &self.signs, span, |k, value| v[k] += factor * value);
        }
        sum
    }
}

/// Gives ∇² of `image` in `span` to `put`. All neighbours are in the image: an [`Interior`] has two pixels around it.
#[inline(always)]
fn laplacian(interior: &Interior, image: &[f32], span: Range<usize>, mut put: impl FnMut(usize, f32)) {
    let (len, start, stride) = (span.len(), span.start, interior.stride());
    let [centre, left, right] = [start, start - CHANNELS, start + CHANNELS].map(|at| &image[at..at + len]);
    let [up, down] = [start - stride, start + stride].map(|at| &image[at..at + len]);
    for k in 0..len {
        put(k, left[k] + right[k] + up[k] + down[k] - 4.0 * centre[k]);
    }
}
