//! Peak signal-to-noise ratio.

use gs3_scene::Image;

use super::MetricError;
use super::mean_square::{Quantisation, mean_square};

/// Peak signal-to-noise ratio in dB: one mean squared error over all RGB values in `[0, 1]`, peak 1. Infinite for equal
/// images.
///
/// # Errors
/// [`MetricError`] if the sizes differ or the images are empty.
pub fn psnr(reference: &Image, test: &Image, quantisation: Quantisation) -> Result<f64, MetricError> {
    mean_square([(-1.0, reference), (1.0, test)], quantisation).map(psnr_from_mse)
}

/// The PSNR in dB of a mean squared error on `[0, 1]`, peak 1.
#[must_use]
pub fn psnr_from_mse(mse: f64) -> f64 {
    -10.0 * mse.log10()
}
