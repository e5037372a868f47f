//! The one sum behind PSNR, tPSNR and flicker: the mean square of a linear combination of images.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_scene::Image;
use rayon::prelude::*;

use super::{BAND_ROWS, MetricError, same_size};

/// Whether images are compared as computed or as an 8-bit file would hold them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quantisation {
    /// f32 values as they are.
    #[default]
    None,
    /// Rounded to multiples of 1/255 first, half up.
    EightBit,
}

/// Mean over all RGB values of `(Σ weight · displayed(image))²`.
pub(super) fn mean_square<const N: usize>(
    terms: [(f32, &Image); N],
    quantisation: Quantisation,
) -> Result<f64, MetricError> {
    let first = terms[0].1;
    for (_, image) in &terms[1..] {
        same_size(first, "test image", image)?;
    }
    let (width, height) = (first.width(), first.height());
    if width == 0 || height == 0 {
        return Err(MetricError::TooSmall { metric: "mean squared error", min: 1, actual: first.size() });
    }
    let level = gs3_simd::level();
    let bands: Vec<f64> = (0..height.div_ceil(BAND_ROWS))
        .into_par_iter()
        .map(|band| {
            let rows = band * BAND_ROWS..height.min((band + 1) * BAND_ROWS);
            let span = rows.start * width..rows.end * width;
            let parts = terms.map(|(weight, image)| (weight, image.pixels()[span.clone()].as_flattened()));
            dispatch!(level, simd => sum_of_squares(simd, &parts, quantisation))
        })
        .collect();
    Ok(bands.iter().sum::<f64>() / (3 * width * height) as f64)
}

/// Sum of squares of the weighted sum of RGBA slices of equal length, alpha left out.
#[inline(always)]
fn sum_of_squares<S: Simd, const N: usize>(
    simd: S,
    parts: &[(f32, &[f32]); N],
    quantisation: Quantisation,
) -> f64 {
    // f32 lanes are flushed to f64 this often: 64 additions keep the rounding error of a lane near 1e-6.
    const FLUSH: usize = 64 * 16;
    let length = parts[0].1.len();
    let mut sum = 0.0f64;
    for start in (0..length).step_by(FLUSH) {
        let end = length.min(start + FLUSH);
        let mut lanes = f32x16::splat(simd, 0.0);
        let mut at = start;
        while at < end {
            let mut value = f32x16::splat(simd, 0.0);
            for (weight, data) in parts {
                value = load(simd, data, at, quantisation).mul_add(*weight, value);
            }
            lanes = value.mul_add(value, lanes);
            at += 16;
        }
        let lanes = lanes.to_array();
        sum += lanes.chunks_exact(4).flat_map(|p| &p[..3]).map(|v| f64::from(*v)).sum::<f64>();
    }
    sum
}

/// Sixteen displayed values (four pixels) from `at` on; zeros beyond the end.
#[inline(always)]
fn load<S: Simd>(simd: S, data: &[f32], at: usize, quantisation: Quantisation) -> f32x16<S> {
    let raw = match data.get(at..at + 16) {
        Some(full) => f32x16::from_slice(simd, full),
        None => f32x16::from_fn(simd, |i| data.get(at + i).copied().unwrap_or(0.0)),
    };
    displayed(raw, quantisation)
}

/// The value that a display would show: one lane of [`displayed`].
#[inline(always)]
pub(super) fn shown(value: f32, quantisation: Quantisation) -> f32 {
    let clamped = super::displayed(value);
    match quantisation {
        Quantisation::None => clamped,
        Quantisation::EightBit => (clamped * 255.0 + 0.5).floor() * (1.0 / 255.0),
    }
}

/// The values that a display would show.
#[inline(always)]
fn displayed<S: Simd>(value: f32x16<S>, quantisation: Quantisation) -> f32x16<S> {
    let clamped = value.max_precise(0.0).min_precise(1.0);
    match quantisation {
        Quantisation::None => clamped,
        Quantisation::EightBit => (clamped * 255.0 + 0.5).floor() * (1.0 / 255.0),
    }
}
