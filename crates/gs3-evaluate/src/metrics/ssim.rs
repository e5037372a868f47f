//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004).

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_scene::Image;
use rayon::prelude::*;

use super::{BAND_ROWS, MetricError, displayed, same_size};

/// What happens where the window reaches over the border of the image. The two conventions differ in the third
/// decimal, so results state theirs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SsimBorder {
    /// Pixels with a window that leaves the image are left out of the mean: the original definition, and
    /// scikit-image's `structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    /// data_range=1)`.
    #[default]
    Crop,
    /// The image is continued with zeros and every pixel counts: the code published with 3D Gaussian Splatting (Kerbl
    /// et al. 2023), hence the figures of most splatting papers.
    ZeroPad,
}

/// Reach of the 11×11 window to each side.
const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
/// Standard deviation of the Gaussian window in pixels.
const SIGMA: f64 = 1.5;
/// Stabilising constants (K·range)², K₁ = 0.01, K₂ = 0.03, range 1.
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;
/// Values are filtered with ½ subtracted: variances are differences of means of squares, and f32 cancels less around 0.
const CENTRE: f32 = 0.5;
/// The filtered quantities: x, y, x² + y², xy (the formula needs the two variances only as their sum).
const QUANTITIES: usize = 4;

/// Mean structural similarity over the RGB channels, 1 for equal images: 11×11 Gaussian window, σ = 1.5, biased
/// covariance.
///
/// # Errors
/// [`MetricError`] if the sizes differ or a side is below 11 pixels.
pub fn ssim(reference: &Image, test: &Image, border: SsimBorder) -> Result<f64, MetricError> {
    same_size(reference, "test image", test)?;
    let (width, height) = (reference.width(), reference.height());
    if width < TAPS || height < TAPS {
        return Err(MetricError::TooSmall { metric: "SSIM", min: TAPS, actual: reference.size() });
    }
    let margin = match border {
        SsimBorder::Crop => RADIUS,
        SsimBorder::ZeroPad => 0,
    };
    let (top, bottom) = (margin, height - margin);
    let level = gs3_simd::level();
    let bands: Vec<f64> =
        (0..(bottom - top).div_ceil(BAND_ROWS))
            .into_par_iter()
            .map(|band| {
                let rows = top + band * BAND_ROWS..bottom.min(top + (band + 1) * BAND_ROWS);
                (0..3).map(|channel| {
                let mut window = Window::new(width, channel);
                dispatch!(level, simd => window.sum_of_rows(simd, reference, test, rows.clone(), margin))
            }).sum()
            })
            .collect();
    let count = 3 * (width - 2 * margin) * (bottom - top);
    Ok(bands.iter().sum::<f64>() / count as f64)
}

/// The window's weights, normalised.
fn weights() -> [f32; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| {
        let d = i as f64 - RADIUS as f64;
        (-d * d / (2.0 * SIGMA * SIGMA)).exp()
    });
    let total: f64 = raw.iter().sum();
    raw.map(|w| (w / total) as f32)
}

/// The last eleven rows of one channel, filtered horizontally, in a ring.
struct Window {
    channel: usize,
    width: usize,
    /// Row length of the buffers: `width` rounded up to whole vectors.
    stride: usize,
    weights: [f32; TAPS],
    /// One row of each quantity before filtering, [`RADIUS`] values of border at either side.
    lines: [Vec<f32>; QUANTITIES],
    /// `[TAPS, QUANTITIES, stride]`; image row `y` lies at ring row `(y + RADIUS) % TAPS`.
    ring: Vec<f32>,
    similarity: Vec<f32>,
}

impl Window {
    fn new(width: usize, channel: usize) -> Self {
        let stride = width.next_multiple_of(16);
        // Zeros outside the image are −CENTRE here, their squares CENTRE².
        let outside = [-CENTRE, -CENTRE, 2.0 * CENTRE * CENTRE, CENTRE * CENTRE];
        Self {
            channel,
            width,
            stride,
            weights: weights(),
            lines: outside.map(|value| vec![value; stride + 2 * RADIUS]),
            ring: vec![0.0; TAPS * QUANTITIES * stride],
            similarity: vec![0.0; stride],
        }
    }

    /// Sum of the similarity over `rows` and the columns at least `margin` from the border.
    #[inline(always)]
    fn sum_of_rows<S: Simd>(
        &mut self,
        simd: S,
        reference: &Image,
        test: &Image,
        rows: std::ops::Range<usize>,
        margin: usize,
    ) -> f64 {
        // Window rows are counted from −RADIUS: `padded` = image row + RADIUS.
        for padded in rows.start..rows.start + TAPS - 1 {
            self.push(simd, reference, test, padded);
        }
        let mut sum = 0.0;
        for y in rows {
            self.push(simd, reference, test, y + TAPS - 1);
            self.compare(simd, y);
            sum += sum_f64(&self.similarity[margin..self.width - margin]);
        }
        sum
    }

    /// Filters image row `padded − RADIUS` horizontally into the ring.
    #[inline(always)]
    fn push<S: Simd>(&mut self, simd: S, reference: &Image, test: &Image, padded: usize) {
        let y = padded.checked_sub(RADIUS).filter(|y| *y < reference.height());
        let [x, y_, squares, product] = &mut self.lines;
        let span = RADIUS..RADIUS + self.width;
        match y {
            Some(row) => {
                let pixels = reference.row(row).iter().zip(test.row(row));
                let targets = (x[span.clone()].iter_mut().zip(&mut y_[span.clone()]))
                    .zip(squares[span.clone()].iter_mut().zip(&mut product[span]));
                for ((a, b), ((x, y), (s, p))) in pixels.zip(targets) {
                    let a = displayed(a[self.channel]) - CENTRE;
                    let b = displayed(b[self.channel]) - CENTRE;
                    (*x, *y, *s, *p) = (a, b, a * a + b * b, a * b);
                }
            }
            None => {
                x[span.clone()].fill(-CENTRE);
                y_[span.clone()].fill(-CENTRE);
                squares[span.clone()].fill(2.0 * CENTRE * CENTRE);
                product[span].fill(CENTRE * CENTRE);
            }
        }
        let slot = padded % TAPS * QUANTITIES * self.stride;
        let filtered = &mut self.ring[slot..slot + QUANTITIES * self.stride];
        for (line, out) in self.lines.iter().zip(filtered.chunks_exact_mut(self.stride)) {
            for (i, out) in out.chunks_exact_mut(16).enumerate() {
                let mut sum = f32x16::splat(simd, 0.0);
                for (tap, weight) in self.weights.iter().enumerate() {
                    let at = 16 * i + tap;
                    sum = f32x16::from_slice(simd, &line[at..at + 16]).mul_add(*weight, sum);
                }
                sum.store_slice(out);
            }
        }
    }

    /// Filters the ring vertically around image row `y` and evaluates the similarity.
    #[inline(always)]
    fn compare<S: Simd>(&mut self, simd: S, y: usize) {
        let row_size = QUANTITIES * self.stride;
        let rows: [&[f32]; TAPS] = std::array::from_fn(|tap| {
            let slot = (y + tap) % TAPS * row_size;
            &self.ring[slot..slot + row_size]
        });
        for (i, out) in self.similarity.chunks_exact_mut(16).enumerate() {
            // A closure over vectors (`array::from_fn`) would be compiled without the SIMD level's features.
            let mut sums = [f32x16::splat(simd, 0.0); QUANTITIES];
            for (quantity, sum) in sums.iter_mut().enumerate() {
                let at = quantity * self.stride + 16 * i;
                for (row, weight) in rows.iter().zip(&self.weights) {
                    *sum = f32x16::from_slice(simd, &row[at..at + 16]).mul_add(*weight, *sum);
                }
            }
            let [mx, my, squares, product] = sums;
            let variances = squares - mx * mx - my * my;
            let covariance = product - mx * my;
            let (mx, my) = (mx + CENTRE, my + CENTRE);
            let numerator = (mx * my * 2.0 + C1) * (covariance * 2.0 + C2);
            let denominator = (mx * mx + my * my + C1) * (variances + C2);
            (numerator / denominator).store_slice(out);
        }
    }
}

/// Sum in f64, in eight interleaved partial sums.
#[inline(always)]
fn sum_f64(values: &[f32]) -> f64 {
    let mut lanes = [0.0f64; 8];
    let chunks = values.chunks_exact(8);
    let rest: f64 = chunks.remainder().iter().map(|v| f64::from(*v)).sum();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += f64::from(*value);
        }
    }
    lanes.iter().sum::<f64>() + rest
}
