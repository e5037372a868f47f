//! Metrics of change over time.

use gs3_scene::Image;

use super::MetricError;
use super::mean_square::{Quantisation, mean_square};
use super::psnr::psnr_from_mse;

/// Temporal PSNR in dB: the PSNR of the frame difference `test[1] − test[0]` against `reference[1] − reference[0]`,
/// peak 1 as in [`super::psnr()`]. An error that stays where it is costs nothing; one that comes and goes does.
///
/// # Errors
/// [`MetricError`] if sizes differ or images are empty.
pub fn tpsnr(
    reference: [&Image; 2],
    test: [&Image; 2],
    quantisation: Quantisation,
) -> Result<f64, MetricError> {
    let terms = [(1.0, reference[0]), (-1.0, reference[1]), (-1.0, test[0]), (1.0, test[1])];
    mean_square(terms, quantisation).map(psnr_from_mse)
}

/// Temporal flicker: the root mean square of the error's component that alternates from frame to frame, in `[0, 1]`; 0
/// for the ground truth itself.
///
/// The error `e = test − reference` of three consecutive frames passes the filter `[1, −2, 1]/4`. The filter's gain
/// is 1 for an error that alternates at half the frame rate, and 0 for an error that is constant or grows linearly.
/// Sharp rendered frames that alternate with blurred interpolated frames are the typical defect of frame
/// interpolation. They show here and not in means.
///
/// # Errors
/// [`MetricError`] if sizes differ or images are empty.
pub fn flicker(
    reference: [&Image; 3],
    test: [&Image; 3],
    quantisation: Quantisation,
) -> Result<f64, MetricError> {
    let terms = [
        (-0.25, reference[0]),
        (0.5, reference[1]),
        (-0.25, reference[2]),
        (0.25, test[0]),
        (-0.5, test[1]),
        (0.25, test[2]),
    ];
    mean_square(terms, quantisation).map(f64::sqrt)
}
