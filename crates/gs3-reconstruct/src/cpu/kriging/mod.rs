//! Gradient-enhanced kriging of pixels that first-order predictions leave uncertain.
//!
//! A mean of first-order predictions weights every sample by its own distance alone. Samples with the same
//! information are counted twice. Where colours change within a pixel or two, gradients carry too far. The best
//! linear prediction of a pixel from the values and the gradients of the samples around it follows from the
//! covariance of pixel colours: kriging (Matheron 1963), with gradients as further data (Morris, Mitchell & Ylvisaker
//! 1993). For data d with covariances K among each other and k with the pixel, the prediction is kᵀK⁻¹d. Here d is
//! the data's difference from the mean.
//!
//! Each pixel needs a small dense system, so only pixels with a visible error of the mean are kriged. Sixteen pixels
//! are solved at once, one in each lane.

mod candidates;
mod system;
#[cfg(test)]
mod tests;

use fearless_simd::{Simd, f32x16, prelude::*, u32x16};

use crate::cpu::samples::{CHUNK, Sample};
use candidates::{Candidates, SEEN};
use system::{Around, NOTHING, ROWS, solve};

/// Largest number of samples that a pixel is predicted from: the samples around it with the best first-order
/// predictions. (Empirical: 6 lose 0.2 to 0.4 dB, 12 gain 0.1; time grows with the third power.)
pub(crate) const SAMPLES: usize = 8;

/// Values and derivatives of a pixel's samples.
const DATA: usize = 3 * SAMPLES;

/// Length of the covariance, in pixels. The covariance is a rational quadratic (Rasmussen & Williams 2006, 4.19) with
/// α = 1, `1 / (1 + δ² / (2 LENGTH²))`: a mixture of Gaussians of all widths, just as images have detail of all
/// sizes. (Simulated with samples of true frames: where detail is finest, 1 and 2 lose 0.1 to 1 dB; elsewhere 2 is
/// alike.)
pub(crate) const LENGTH: f32 = 1.5;

/// Variance of data that the covariance does not explain, as a share of the image's variance. It also keeps systems
/// well conditioned: only rounding brings a pivot below it. (Empirical: half of it is alike.)
pub(crate) const NUGGET: f32 = 1e-3;

/// Error variance of a datum, as a share of the image's variance, per pixel⁴ of the sample's noise. With this
/// covariance, second derivatives have the variance 6 / LENGTH⁴. So a first-order prediction at distance δ errs with
/// 1.5 / LENGTH⁴ δ⁴: 0.3 per pixel⁴. Half of it is a little better.
///
/// Errors of samples are correlated. A surface that has changed its look, or moved otherwise than its depth says, is
/// wrong for all its samples. The error grows with the age of the samples, and varies over about as many pixels as
/// the surface's colours. So errors have the image's covariance k in space, and are a Brownian motion in noise:
/// cov(eᵢ, eⱼ) = PER_NOISE · min(nᵢ, nⱼ) · k(δ). Two samples share the error of the less noisy one, and their
/// difference is nearly as informative as the difference of two true samples. (Measured on samples eight and four
/// frames old, by their distance: the correlation is 0.6 to 0.7 within a pixel, and 0.3 to 0.6 at two pixels.
/// Independent errors lose 0.1 dB where single pixels are kriged, and 0.25 where many are; 0.1 and 0.2 per pixel⁴ are
/// alike.)
pub(crate) const PER_NOISE: f32 = 0.15;

/// Samples with first-order predictions of this variance (pixel⁴) or more do not count: two pixels away or farther.
pub(crate) const FARTHEST: f32 = 16.0;

/// Fading of samples near the limit: a sample's variance grows by this share of the image's variance times s² / (1 −
/// s). Here s is the sample's variance over the variance of the best sample left out. So no sample appears or
/// disappears abruptly.
pub(crate) const FADE: f32 = 0.003;

/// The 1 of 1 − s in [`FADE`], and a little more: s is 1 where a sample is as good as the best one left out. Its variance
/// then grows by 30 times the image's, so it has next to no weight, and nothing is divided by 0. (Rounding of s, at most
/// 16·2⁻²⁴ on a GPU, is a hundredth of the 1e-4.)
pub(crate) const FADE_LIMIT: f32 = 1.0 + 1e-4;

/// If the data explain at most this share of a pixel's variance, the mean stays unchanged; from the second share on
/// the data are trusted fully. Where samples are few the mean is better, because it includes the current frame's
/// surface.
pub(crate) const UNTRUSTED: f32 = 0.65;
pub(crate) const TRUSTED: f32 = 0.9;

/// Cells that samples in reach may lie in: runs of cells, given as first column, last column and row, relative to the
/// pixel's cell.
const CELLS: [([isize; 2], isize); 5] =
    [([-1, 1], -2), ([-2, 2], -1), ([-2, 2], 0), ([-2, 2], 1), ([-1, 1], 2)];

/// The numbers of lanes.
const LANES: [u32; CHUNK] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// A sample in a tile.
#[derive(Clone, Copy, Debug)]
struct Landed<'a> {
    /// Position in the tile's memory, pixel centres at whole numbers.
    at: [f32; 2],
    /// Variance of the sample's first-order prediction at its own place, in pixel⁴.
    noise: f32,
    /// The pixel that the sample lies in, in the tile's memory.
    cell: u32,
    sample: &'a Sample,
}

/// The samples of a tile, sorted by the pixels that they lie in, and the pixels that are to be kriged.
#[derive(Debug, Default)]
pub(crate) struct Neighborhoods<'a> {
    /// Threshold for a pixel to be kriged; see [`Kriging::threshold`].
    pub threshold: f32,
    /// Pixels from one row to the next.
    stride: usize,
    /// The samples in order of arrival.
    arrived: Vec<Landed<'a>>,
    /// For each cell, the place of its first sample once the samples are sorted. Before sorting: the number of
    /// samples in the cell before it.
    starts: Vec<u32>,
    /// The samples, sorted by cell. Arrays that are read by vectors are one vector longer.
    x: Vec<f32>,
    y: Vec<f32>,
    noise: Vec<f32>,
    samples: Vec<&'a Sample>,
    /// Pixels to be kriged in the tile's memory, and the places of their colours in the image.
    pixels: Vec<([u16; 2], usize)>,
}

impl<'a> Neighborhoods<'a> {
    /// No tile yet; `threshold` is [`Kriging::threshold`].
    pub fn new(threshold: f32) -> Self {
        Self { threshold, ..Self::default() }
    }

    /// Begins a tile with `rows` rows of memory, `stride` pixels apart.
    pub fn begin(&mut self, stride: usize, rows: usize) {
        self.stride = stride;
        self.starts.clear();
        self.starts.resize(stride * rows + 1, 0);
        self.arrived.clear();
        self.pixels.clear();
    }

    /// Adds a sample at `at` in the tile's memory.
    #[inline(always)]
    pub fn take(&mut self, at: [f32; 2], noise: f32, sample: &'a Sample) {
        let (x, y) = ((at[0] + 0.5) as usize, (at[1] + 0.5) as usize);
        let cell = y * self.stride + x;
        if let Some(count) = self.starts.get_mut(cell + 1)
            && noise < FARTHEST
        {
            *count += 1;
            // Tiles are small.
            self.arrived.push(Landed { at, noise, cell: cell as u32, sample });
        }
    }

    /// Adds the pixel at `x`, `y` in the tile's memory to the pixels to be kriged. `place` is the place of its colour
    /// in an image.
    #[inline(always)]
    pub fn want(&mut self, [x, y]: [usize; 2], place: usize) {
        // Tiles are small.
        self.pixels.push(([x as u16, y as u16], place));
    }

    /// Sorts the samples by cell.
    fn put_in_order(&mut self) {
        let mut before = 0;
        for start in &mut self.starts {
            // `start` becomes the beginning of the cell before. As that cell's samples take their places below,
            // `start` moves to the cell's end, where this cell begins.
            before += std::mem::replace(start, before);
        }
        for values in [&mut self.x, &mut self.y, &mut self.noise] {
            values.resize(self.arrived.len() + CHUNK, 0.0);
        }
        self.samples.clear();
        // In any order, to reserve memory: each place is overwritten below.
        self.samples.extend(self.arrived.iter().map(|landed| landed.sample));
        for landed in &self.arrived {
            let end = &mut self.starts[landed.cell as usize + 1];
            let place = *end as usize;
            [self.x[place], self.y[place]] = landed.at;
            (self.noise[place], self.samples[place]) = (landed.noise, landed.sample);
            *end += 1;
        }
    }

    /// Predicts all pixels to be kriged; `image` has their means.
    #[inline(always)]
    pub fn krige<S: Simd>(&mut self, simd: S, image: &mut [[f32; 4]]) {
        if self.pixels.is_empty() {
            return;
        }
        self.put_in_order();
        let (mut candidates, mut around) = (Candidates::new(), Around::new());
        let mut systems = [[[0.0; CHUNK]; 3]; ROWS];
        let mut weights = [[0.0; CHUNK]; DATA];
        for pixels in self.pixels.chunks(CHUNK) {
            candidates.begin();
            for (lane, (pixel, _)) in pixels.iter().enumerate() {
                self.look_around(simd, *pixel, lane, &mut candidates);
            }
            candidates.least(simd, &mut around.keys);
            for (lane, (pixel, _)) in pixels.iter().enumerate() {
                self.choose(lane, *pixel, &candidates, &mut around);
            }
            around.scale(simd);
            solve(simd, &around, &mut systems, &mut weights);
            for (lane, (_, place)) in pixels.iter().enumerate() {
                if let Some(pixel) = image.get_mut(*place) {
                    around.predict(lane, &weights, pixel);
                }
            }
        }
    }

    /// Lists the samples around `pixel` in a lane of `candidates`.
    #[inline(always)]
    fn look_around<S: Simd>(&self, simd: S, pixel: [u16; 2], lane: usize, candidates: &mut Candidates) {
        let middle = usize::from(pixel[1]) * self.stride + usize::from(pixel[0]);
        let x = f32x16::splat(simd, f32::from(pixel[0]));
        let y = f32x16::splat(simd, f32::from(pixel[1]));
        let lanes = u32x16::load_array(simd, LANES);
        for (columns, row) in &CELLS {
            // Beyond the tile's memory there are no samples.
            let first = (middle as isize + row * self.stride as isize + columns[0]) as usize;
            let end = first.wrapping_add((columns[1] - columns[0] + 1) as usize);
            let (Some(first), Some(end)) = (self.starts.get(first), self.starts.get(end)) else { continue };
            // Usually one vector holds all samples. A loop that always runs once is not mispredicted.
            let (mut first, end) = (*first, *end);
            loop {
                let at = first as usize;
                let (dx, dy) = (vector(simd, &self.x, at) - x, vector(simd, &self.y, at) - y);
                let d2 = dx.mul_add(dx, dy * dy);
                let variances = d2.mul_add(d2, vector(simd, &self.noise, at));
                let near = variances.simd_lt(FARTHEST) & lanes.simd_lt(end - first);
                candidates.see(lane, near, variances, lanes + first);
                first += CHUNK as u32;
                if first >= end {
                    break;
                }
            }
        }
    }

    /// Takes the best of the candidates. Positions are still in pixels.
    #[inline(always)]
    fn choose(&self, lane: usize, pixel: [u16; 2], candidates: &Candidates, around: &mut Around<'a>) {
        let center = [f32::from(pixel[0]), f32::from(pixel[1])];
        for k in 0..SAMPLES {
            let key = around.keys[k][lane];
            let sample = candidates.places[lane][key.to_bits() as usize % SEEN] as usize;
            let sample = (key < FARTHEST).then_some(sample);
            let [dx, dy, noise, nugget] = match sample {
                Some(at) => [self.x[at] - center[0], self.y[at] - center[1], self.noise[at], NUGGET],
                None => [0.0, 0.0, 0.0, NOTHING],
            };
            (around.x[k][lane], around.y[k][lane]) = (dx, dy);
            (around.noise[k][lane], around.nugget[k][lane]) = (noise, nugget);
            around.samples[lane][k] = sample.map(|at| self.samples[at]);
        }
    }
}

/// The vector from `at` on. (A closure would not be inlined where vectors are enabled.)
#[inline(always)]
fn vector<S: Simd>(simd: S, values: &[f32], at: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &values[at..at + CHUNK])
}
