//! Exact samples of past frames, carried to the pixels of the current one.
//!
//! Every sample of the last frames is reprojected through its own depth, so it lands on the HR grid at an exact, generally
//! fractional position, with its exact gradient. Around it the image is known to first order; the remainder grows with
//! the square of the distance δ, its variance with δ⁴. A pixel is the mean of these first-order predictions with the
//! inverse variances as weights (Shepard's method with exact gradients, Renka 1988). Nothing is ever resampled twice, so
//! nothing blurs with time, and a sample that falls on a pixel centre is that pixel.

use fearless_simd::{Simd, f32x4, f32x16, prelude::*};

use crate::reprojection::Reprojection;
use crate::samples::{Sample, SampleFrame};

/// Samples whose bounds are kept together.
pub(crate) const CHUNK: usize = 32;

/// A sample reaches this many pixels along each axis: those within two pixels of it.
const FOOTPRINT: usize = 4;

/// Where a sample lies on the current HR grid.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Landing {
    /// Position in HR pixels, minus ½: pixel centres are whole numbers.
    pub x: f32,
    pub y: f32,
    /// Variance floor of what the sample predicts, in units of pixel⁴ (see [`weight`]); infinite for a sample that must
    /// not be used.
    pub noise: f32,
}

/// Rows that a chunk of samples may touch: pixel rows `first..=last`; empty if `first > last`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach {
    pub first: f32,
    pub last: f32,
}

/// What the current frame says about visibility, looked up at a landing position.
pub(crate) struct Occlusion<'a> {
    pub frame: &'a SampleFrame,
    pub scale: f32,
    pub tolerance: f32,
}

impl Occlusion<'_> {
    /// The smallest inverse depth at which something at HR position `(x, y)` is taken to be visible.
    #[inline(always)]
    fn limit(&self, x: f32, y: f32) -> f32 {
        let frame = self.frame;
        let s = 1.0 / self.scale;
        let u = (x + 0.5) * s - 0.5 - frame.jitter[0];
        let v = (y + 0.5) * s - 0.5 - frame.jitter[1];
        let (i, j) = (u as usize, v as usize);
        let i1 = (i + 1).min(frame.width - 1);
        let j1 = (j + 1).min(frame.height - 1);
        let (i, j) = (i.min(i1), j.min(j1));
        let at = |i: usize, j: usize| frame.inverse_depth[j * frame.width + i];
        let far = at(i, j).min(at(i1, j)).min(at(i, j1)).min(at(i1, j1));
        far * (1.0 - self.tolerance)
    }
}

/// Reprojects one LR row of `source` to the current camera.
#[inline(always)]
pub(crate) fn land_row<S: Simd>(
    simd: S,
    source: &SampleFrame,
    row: usize,
    reprojection: &Reprojection,
    scale: f32,
    noise: f32,
    occlusion: &Occlusion<'_>,
    size: (usize, usize),
    landings: &mut [Landing],
    reaches: &mut [Reach],
) {
    let _ = simd;
    let inverse_depth = &source.inverse_depth[row * source.width..][..source.width];
    let y = (row as f32 + 0.5 + source.jitter[1]) * scale;
    let (x_limit, y_limit) = (size.0 as f32 + 1.0, size.1 as f32 + 1.0);
    let (chunks, depths) = (landings.chunks_mut(CHUNK), inverse_depth.chunks(CHUNK));
    for (k, ((landings, depths), reach)) in chunks.zip(depths).zip(reaches).enumerate() {
        let (mut us, mut vs, mut ws) = ([0.0; CHUNK], [0.0; CHUNK], [0.0; CHUNK]);
        let mut padded = [0.0; CHUNK];
        padded[..depths.len()].copy_from_slice(depths);
        let first = (k * CHUNK) as f32 + 0.5 + source.jitter[0];
        for i in 0..CHUNK {
            let x = (first + i as f32) * scale;
            let (u, v, q) = reprojection.apply(x, y, padded[i]);
            (us[i], vs[i]) = (u - 0.5, v - 0.5);
            ws[i] = if q > 1e-6 { padded[i] / q } else { -1.0 };
        }
        *reach = Reach { first: f32::INFINITY, last: f32::NEG_INFINITY };
        for (i, landing) in landings.iter_mut().enumerate() {
            let (x, y, w) = (us[i], vs[i], ws[i]);
            let visible =
                w >= 0.0 && x > -2.0 && y > -2.0 && x < x_limit && y < y_limit && w >= occlusion.limit(x, y);
            *landing = Landing { x, y, noise: if visible { noise } else { f32::INFINITY } };
            if visible {
                reach.first = reach.first.min(y.floor() - 1.0);
                reach.last = reach.last.max(y.floor() + 2.0);
            }
        }
    }
}

/// A band of accumulating rows: per pixel Σ weight·RGB and Σ weight.
pub(crate) struct Band<'a> {
    /// First row of the band in the image.
    pub top: usize,
    pub width: usize,
    /// `[rows, width]`.
    pub pixels: &'a mut [[f32; 4]],
}

impl Band<'_> {
    fn rows(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Whether samples of this reach may touch the band.
    #[inline(always)]
    pub fn meets(&self, reach: &Reach) -> bool {
        reach.last >= self.top as f32 && reach.first < (self.top + self.rows()) as f32
    }

    /// Adds what `samples` predict for the pixels around them.
    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, samples: &[Sample], landings: &[Landing]) {
        let rows = self.rows() as isize;
        let lane = f32x16::from_fn(simd, |i| (i / 4) as f32 - 1.0);
        for (sample, landing) in samples.iter().zip(landings) {
            if landing.noise == f32::INFINITY {
                continue;
            }
            let (x, y) = (landing.x.floor(), landing.y.floor());
            let (column, row) = (x as isize - 1, y as isize - 1 - self.top as isize);
            let (first, last) = (row.max(0), (row + FOOTPRINT as isize).min(rows));
            if first >= last {
                continue;
            }
            if column < 0 || column + FOOTPRINT as isize > self.width as isize {
                self.add_at_border(sample, landing);
                continue;
            }
            let dx = lane - (landing.x - x);
            let dx2 = dx * dx;
            let splat = |v: [f32; 4]| f32x16::block_splat(f32x4::load_array(simd, v));
            let along_x = splat(sample.dx).mul_add(dx, splat(sample.color));
            let along_y = splat(sample.dy);
            let noise = f32x16::splat(simd, landing.noise);
            for r in first..last {
                let dy = f32x16::splat(simd, (r + self.top as isize) as f32 - landing.y);
                let value = along_y.mul_add(dy, along_x);
                let d2 = dy.mul_add(dy, dx2);
                let weight = d2.mul_add(d2, noise).approximate_recip();
                let start = r as usize * self.width + column as usize;
                let target: &mut [f32; 16] = self.pixels[start..start + FOOTPRINT]
                    .as_flattened_mut()
                    .try_into()
                    .expect("four pixels of four lanes");
                value.mul_add(weight, f32x16::load_array_ref(simd, target)).store_array(target);
            }
        }
    }

    /// [`Self::add`] for a sample whose footprint leaves the image at the left or right.
    #[cold]
    fn add_at_border(&mut self, sample: &Sample, landing: &Landing) {
        let (x, y) = (landing.x.floor() as isize, landing.y.floor() as isize);
        let (width, top, rows) = (self.width as isize, self.top as isize, self.rows() as isize);
        for row in (y - 1).max(top)..(y + 3).min(top + rows) {
            for column in (x - 1).max(0)..(x + 3).min(width) {
                let (dx, dy) = (column as f32 - landing.x, row as f32 - landing.y);
                let weight = weight(dx, dy, landing.noise);
                let pixel = &mut self.pixels[((row - top) * width + column) as usize];
                for c in 0..4 {
                    pixel[c] += weight * (sample.color[c] + sample.dx[c] * dx + sample.dy[c] * dy);
                }
            }
        }
    }
}

/// Inverse variance of a first-order prediction `(dx, dy)` pixels from a sample, up to the local curvature of the image,
/// which all predictions for a pixel share.
fn weight(dx: f32, dy: f32, noise: f32) -> f32 {
    let d2 = dx * dx + dy * dy;
    1.0 / (d2 * d2 + noise)
}
