//! Exact samples of past frames, carried to the pixels of the current one.
//!
//! Every sample of the last frames is reprojected through its own depth, so it lands on the HR grid at an exact, generally
//! fractional position, with its exact gradient. Around it the image is known to first order; the remainder grows with
//! the square of the distance δ, its variance with δ⁴. A pixel is the mean of these first-order predictions with the
//! inverse variances as weights (Shepard's method with exact gradients, Renka 1988). Nothing is ever resampled twice, so
//! nothing blurs with time, and a sample that falls on a pixel centre is that pixel.

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*};

use crate::plausible::Plausible;
use crate::reprojection::{MIN_DIVISOR, Reprojection};
use crate::samples::{Sample, SampleFrame};

/// Samples of a row that are reprojected together.
pub(crate) const CHUNK: usize = 32;

/// A sample reaches pixels less than this far along x: four pixels are one vector.
const REACH_X: isize = 2;

/// A sample reaches the three rows nearest to it, all less than this far along y.
const REACH_Y: isize = 2;

/// Variance floor of a prediction in pixel⁴. A sample on a pixel centre then has 10⁵ times the weight of one a pixel away:
/// at rest all neighbours together change a pixel by less than 1e-4 of their own error.
pub(crate) const NOISE: f32 = 1e-5;

/// Variance that a moved sample gains per frame of age, pixel⁴ (empirical): depths are not exact where layers blend, and
/// colours depend on the view.
const AGING: f32 = 0.1;

/// Samples with a larger variance, pixel⁴, are not worth their time: the interpolated current frame's is at most 7 where
/// it is least certain.
const MAX_NOISE: f32 = 16.0;

/// Pixel rows `first..=last` that a chunk of samples touches; none if `first > last`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows {
    first: f32,
    last: f32,
}

impl Rows {
    /// No rows.
    pub const NONE: Self = Self { first: f32::INFINITY, last: f32::NEG_INFINITY };

    /// The rows from the first to the last of both.
    #[inline(always)]
    pub fn union(self, other: Self) -> Self {
        Self { first: self.first.min(other.first), last: self.last.max(other.last) }
    }
}

/// A past frame seen by the current camera.
pub(crate) struct Source<'a> {
    pub frame: &'a SampleFrame,
    pub reprojection: Reprojection,
    /// In frames.
    pub age: usize,
    /// HR pixels between samples.
    pub scale: f32,
}

/// Where the samples of a chunk are now.
struct Landing {
    /// Position on the current HR grid, pixel centres at whole numbers.
    x: [f32; CHUNK],
    y: [f32; CHUNK],
    /// The same rounded down.
    column: [i32; CHUNK],
    row: [i32; CHUNK],
    /// Inverse depth.
    w: [f32; CHUNK],
    /// 0 for a sample that stayed where it was, towards 1 for one that moved a pixel or more.
    motion: [f32; CHUNK],
    /// Cell of the current frame's lattice.
    cell: [i32; CHUNK],
    /// Bit `i`: sample `i` is in front of the camera and within the limits.
    seen: u32,
}

impl Source<'_> {
    /// Chunks per row of samples.
    pub fn chunks_per_row(&self) -> usize {
        self.frame.width.div_ceil(CHUNK)
    }

    /// Samples of chunk `chunk` of row `row`: their places in the frame.
    #[inline(always)]
    fn samples(&self, row: usize, chunk: usize) -> std::ops::Range<usize> {
        let width = self.frame.width;
        row * width + chunk * CHUNK..row * width + (chunk * CHUNK + CHUNK).min(width)
    }

    /// Position of the first sample of a chunk on its own HR grid (pixel centres at halves).
    #[inline(always)]
    fn origin(&self, row: usize, chunk: usize) -> [f32; 2] {
        let [jx, jy] = self.frame.jitter;
        [((chunk * CHUNK) as f32 + 0.5 + jx) * self.scale, (row as f32 + 0.5 + jy) * self.scale]
    }

    /// Inverse depths of a chunk; negative beyond the end of the row.
    #[inline(always)]
    fn inverse_depths(&self, row: usize, chunk: usize) -> [f32; CHUNK] {
        let depths = &self.frame.inverse_depth[self.samples(row, chunk)];
        let mut padded = [-1.0; CHUNK];
        padded[..depths.len()].copy_from_slice(depths);
        padded
    }

    /// Reprojects a chunk. `x_limits` and `y_limits`, exclusive, bound the positions that count as seen.
    #[inline(always)]
    fn land<S: Simd>(
        &self,
        simd: S,
        row: usize,
        chunk: usize,
        x_limits: [f32; 2],
        y_limits: [f32; 2],
        plausible: &Plausible,
    ) -> Landing {
        let mut landing = Landing {
            x: [0.0; CHUNK],
            y: [0.0; CHUNK],
            column: [0; CHUNK],
            row: [0; CHUNK],
            w: [0.0; CHUNK],
            motion: [0.0; CHUNK],
            cell: [0; CHUNK],
            seen: 0,
        };
        let depths = self.inverse_depths(row, chunk);
        let [x0, y0] = self.origin(row, chunk);
        let lanes = f32x16::from_fn(simd, |i| i as f32);
        for half in 0..CHUNK / 16 {
            let at = 16 * half..16 * half + 16;
            let w = f32x16::from_slice(simd, &depths[at.clone()]);
            let from_x = lanes.mul_add(self.scale, f32x16::splat(simd, x0 + (16 * half) as f32 * self.scale));
            let [u, v, q] = self.reprojection.apply_16(simd, from_x, y0, w);
            let (x, y) = (u - 0.5, v - 0.5);
            let seen = w.simd_ge(0.0)
                & q.simd_gt(MIN_DIVISOR)
                & x.simd_gt(x_limits[0])
                & x.simd_lt(x_limits[1])
                & y.simd_gt(y_limits[0])
                & y.simd_lt(y_limits[1]);
            landing.seen |= (seen.to_bitmask() as u32 & 0xffff) << (16 * half);
            let (moved_x, moved_y) = (u - from_x, v - y0);
            let moved = moved_x.mul_add(moved_x, moved_y * moved_y);
            let (floor_x, floor_y) = (x.floor(), y.floor());
            x.store_slice(&mut landing.x[at.clone()]);
            y.store_slice(&mut landing.y[at.clone()]);
            floor_x.to_int::<i32x16<S>>().store_slice(&mut landing.column[at.clone()]);
            floor_y.to_int::<i32x16<S>>().store_slice(&mut landing.row[at.clone()]);
            (w / q).store_slice(&mut landing.w[at.clone()]);
            (moved / (moved + 1.0)).store_slice(&mut landing.motion[at.clone()]);
            plausible.cell(x, y).store_slice(&mut landing.cell[at]);
        }
        landing
    }

    /// The pixel rows that a chunk touches.
    #[inline(always)]
    pub fn rows<S: Simd>(&self, simd: S, row: usize, chunk: usize) -> Rows {
        let depths = self.inverse_depths(row, chunk);
        let [x0, y0] = self.origin(row, chunk);
        let lanes = f32x16::from_fn(simd, |i| i as f32);
        let mut first = f32x16::splat(simd, f32::INFINITY);
        let mut last = f32x16::splat(simd, f32::NEG_INFINITY);
        for half in 0..CHUNK / 16 {
            let w = f32x16::from_slice(simd, &depths[16 * half..16 * half + 16]);
            let from_x = lanes.mul_add(self.scale, f32x16::splat(simd, x0 + (16 * half) as f32 * self.scale));
            let [_, v, q] = self.reprojection.apply_16(simd, from_x, y0, w);
            let seen = w.simd_ge(0.0) & q.simd_gt(MIN_DIVISOR);
            first = seen.select(first.min(v), first);
            last = seen.select(last.max(v), last);
        }
        let reach = REACH_Y as f32 + 1.0;
        Rows { first: first.reduce_min() - reach, last: last.reduce_max() + reach }
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
    /// Number of rows.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Whether a chunk that touches `rows` may touch the band.
    #[inline(always)]
    pub fn meets(&self, rows: Rows) -> bool {
        rows.last >= self.top as f32 && rows.first < (self.top + self.height()) as f32
    }

    /// Adds what the samples of a chunk predict for the pixels around them.
    #[inline(always)]
    pub fn add<S: Simd>(
        &mut self,
        simd: S,
        source: &Source<'_>,
        plausible: &Plausible,
        row: usize,
        chunk: usize,
    ) {
        let (width, height, top) = (self.width as f32, self.height() as f32, self.top as f32);
        let x_limits = [-(REACH_X as f32), width - 1.0 + REACH_X as f32];
        let y_limits = [top - REACH_Y as f32, top + height - 1.0 + REACH_Y as f32];
        let landing = source.land(simd, row, chunk, x_limits, y_limits, plausible);
        let samples = &source.frame.samples[source.samples(row, chunk)];
        let aging = AGING * source.age as f32;
        let mut seen = landing.seen;
        while seen != 0 {
            let i = seen.trailing_zeros() as usize;
            seen &= seen - 1;
            let Some(sample) = samples.get(i) else { break };
            let doubt = plausible.doubt(simd, landing.cell[i], &sample.color, landing.w[i]);
            // What does not move keeps its exact value: only motion makes age and doubt matter.
            let noise = NOISE + (aging + doubt) * landing.motion[i];
            if noise <= MAX_NOISE {
                let cell = [landing.column[i] as isize, landing.row[i] as isize];
                self.add_sample(simd, sample, [landing.x[i], landing.y[i]], cell, noise);
            }
        }
    }

    #[inline(always)]
    fn add_sample<S: Simd>(
        &mut self,
        simd: S,
        sample: &Sample,
        [x, y]: [f32; 2],
        [column, row]: [isize; 2],
        noise: f32,
    ) {
        let (top, height) = (self.top as isize, self.height() as isize);
        let nearest = row + isize::from(y - row as f32 >= 0.5);
        let first = (nearest - 1 - top).max(0);
        let last = (nearest + 1 - top).min(height - 1);
        let start = column + 1 - REACH_X;
        if start < 0 || start + 2 * REACH_X > self.width as isize {
            return self.add_sample_at_border(sample, x, y, noise);
        }
        let start = start as usize;
        let lanes = f32x16::from_fn(simd, |i| (i / 4) as f32);
        let splat = |v: [f32; 4]| f32x16::block_splat(f32x4::load_array(simd, v));
        let dx = lanes - (x - start as f32);
        let along_x = splat(sample.dx).mul_add(dx, splat(sample.color));
        let along_y = splat(sample.dy);
        let dx2 = dx * dx;
        let noise = f32x16::splat(simd, noise);
        for r in first..=last {
            let dy = f32x16::splat(simd, (r + top) as f32 - y);
            let prediction = along_y.mul_add(dy, along_x);
            let d2 = dy.mul_add(dy, dx2);
            let weight = d2.mul_add(d2, noise).approximate_recip();
            let at = r as usize * self.width + start;
            let target = self.pixels[at..at + 4].as_flattened_mut();
            prediction.mul_add(weight, f32x16::from_slice(simd, target)).store_slice(target);
        }
    }

    /// [`Self::add_sample`] where the four pixels of a row leave the image.
    #[cold]
    fn add_sample_at_border(&mut self, sample: &Sample, x: f32, y: f32, noise: f32) {
        let (column, row) = (x.floor() as isize, y.floor() as isize);
        let (width, top, height) = (self.width as isize, self.top as isize, self.height() as isize);
        let nearest = row + isize::from(y - row as f32 >= 0.5);
        for r in (nearest - 1).max(top)..=(nearest + 1).min(top + height - 1) {
            for c in (column + 1 - REACH_X).max(0)..=(column + REACH_X).min(width - 1) {
                let (dx, dy) = (c as f32 - x, r as f32 - y);
                let d2 = dx * dx + dy * dy;
                let weight = 1.0 / (d2 * d2 + noise);
                let pixel = &mut self.pixels[((r - top) * width + c) as usize];
                for k in 0..4 {
                    pixel[k] += weight * (sample.color[k] + sample.dx[k] * dx + sample.dy[k] * dy);
                }
            }
        }
    }
}
