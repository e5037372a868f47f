//! Splatting: exact samples of past frames, carried to the pixels of the current frame.
//!
//! Every sample of the last frames is reprojected through its own depth. It lands on the HR grid at an exact,
//! generally fractional position, with its exact gradient. Around a sample the image is known to first order. The
//! remainder grows with the square of the distance δ, and its variance with δ⁴. A pixel is the mean of these
//! first-order predictions, weighted by inverse variances (Shepard's method with exact gradients, Renka 1988).
//! Samples are never resampled twice, so the image does not blur with time. A sample that falls on a pixel centre is
//! that pixel.
//!
//! Values shared by all channels of a pixel are computed with samples or pixels as lanes: sixteen samples land at
//! once, and the weights of four samples for a row of pixels are one vector. Values that differ between channels, a
//! sample's predictions of four pixels in a row, are one vector with channels as lanes: two multiply-adds, one load
//! and one store. Samples of exact blocks reach only the four pixels around them, one vector a pixel.

use fearless_simd::{Simd, f32x4, f32x16, i32x16, mask32x16, prelude::*};

use crate::cpu::displacement::Displacement;
use crate::cpu::lanes::{repeat, spread};
use crate::cpu::nearest::{PLACES, RIM, place};
use crate::cpu::rectification::{DEPTH_TOLERANCE, Rectification};
use crate::cpu::samples::{CHUNK, Chunk, Places, SampleFrame};
use crate::cpu::tile::{NOISE, Tile};
use crate::cpu::tile_size::{PAD_X, PAD_Y, STRIDE};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// A sample of an LR frame reaches this many pixels in a row: those less than two pixels away along x. They are one vector.
/// Samples of exact blocks reach fewer of the same pixels ([`CORNERS`]).
pub(crate) const COLUMNS: usize = 4;

/// A sample of an LR frame reaches this many rows, the nearest ones; all are less than two pixels away along y.
pub(crate) const ROWS: usize = 3;

/// Column and row of the pixels that a sample of an exact block reaches, from the first one on: the pixels less than [`BLOCK_REACH`]
/// away along both axes. Within a block every pixel has a nearer sample of its own. (Empirical, frames 1 to 23 of six paths:
/// the reach of other samples loses 0.04 to 0.31 dB.)
const CORNERS: [[usize; 2]; 4] = [[0, 0], [1, 0], [0, 1], [1, 1]];

/// Distance in pixels, along an axis, from which on a sample of an exact block does not reach a pixel. Samples at rest lie on
/// whole pixels up to rounding, at 8192 pixels up to 2⁻¹⁰ on either side. Four times as much keeps them to their own pixel.
pub(crate) const BLOCK_REACH: f32 = 1.0 - 1.0 / 256.0;

/// Largest distance of a sample from a pixel that it reaches, rounded up, in pixels.
pub(crate) const REACH: f32 = 2.0;

/// Variance that a moved sample gains per pixel of staleness, in pixel⁴ (empirical): depths are not exact where
/// layers blend, and colours depend on the view. On paths of 0.1° to 1.2° a frame at 1920×1080, 0.003 to 0.008 are
/// alike. At 960×540, twice as much loses 0.05 to 0.1 dB. A gain per frame, independent of the camera, loses 0.1 to
/// 0.6 dB.
pub(crate) const AGING: f32 = 0.006;

/// The same for a sample of an exact block. (Empirical, frames 10 to 22 of nine paths: dB more than with [`AGING`], on
/// `flowers_drift`, `hqgarden_drift`, `lacadiere_drift`, `fungi_drift`: 0.003 gains 0.2, 0.1, 0.2, −0.1; 0.0015 gains 0.2, 0.2,
/// 0.3, −0.2; 0.0006 is alike.)
pub(crate) const AGING_OF_BLOCKS: f32 = 0.0015;

/// Factor of the variance that the current frame and nearer samples give a sample of an exact block. The samples of a
/// block err alike, and there are several around each pixel. (Empirical, with [`AGING_OF_BLOCKS`], on the same paths and
/// `demo`: 2 gains 0.0, −0.1, 0.0, 0.2, −0.1 dB over 1, and the 99th percentile of the errors of 8×8 blocks falls by 2, 0, 2, 4,
/// 0 %.)
pub(crate) const ALIKE: f32 = 2.0;

/// Staleness per frame of age, in pixels: with many samples, newer samples are a little better (empirical: 0.4 to 1
/// are alike; 0 loses 0.1 dB where the camera mostly turns).
pub(crate) const PER_FRAME: f32 = 0.75;

/// Samples with a larger variance (pixel⁴) are skipped to save time: the variance of the interpolated current frame
/// is at most 7, where it is least certain.
pub(crate) const MAX_NOISE: f32 = 16.0;

/// Variance, in pixel⁴, of a sample behind a nearer sample within a pixel, per squared pixel of relative motion of
/// the two since then (empirical: 0.3 loses up to 0.1 dB, 3 is alike, 10 loses up to 0.2). If the camera only turns,
/// nothing becomes hidden.
pub(crate) const OCCLUDED: f32 = 1.0;

/// A past frame as seen by the current camera.
pub(crate) struct Source<'a> {
    pub frame: &'a SampleFrame,
    pub reprojection: &'a Reprojection,
    /// Age in frames.
    pub age: usize,
    /// Parallax at depth 1 between the frame's camera and the current camera, in HR pixels
    /// ([`crate::reprojection::parallax`]).
    pub parallax: f32,
    /// Focal length of the current camera, HR pixels.
    pub focal: f32,
    /// HR pixels between samples.
    pub scale: f32,
}

/// Where the samples of a chunk are in a tile.
struct Footprints {
    /// Place in the tile of the first pixel that the sample reaches.
    first: [i32; CHUNK],
    /// Position of the sample relative to that pixel.
    x: [f32; CHUNK],
    y: [f32; CHUNK],
    /// Variance of the prediction at the sample's position, in pixel⁴.
    noise: [f32; CHUNK],
    /// Bit `i`: sample `i` is in front of the camera, reaches the tile, and has a small enough variance.
    seen: u64,
}

/// Places of sixteen samples in the current frame.
pub(crate) struct ReprojectedSamples<S: Simd> {
    /// HR positions, pixel centres at halves. Valid only where `q` exceeds [`MIN_DIVISOR`].
    pub x: f32x16<S>,
    pub y: f32x16<S>,
    pub inverse_depth: f32x16<S>,
    /// The divisor of the reprojection.
    pub q: f32x16<S>,
    /// Squared distance moved, pixel².
    pub moved: f32x16<S>,
    /// Staleness in pixels: the parallax since the sample's frame, plus [`PER_FRAME`] times its age.
    pub staleness: f32x16<S>,
    /// Motion of surfaces at the sample's old place, in pixels ([`Displacement`]).
    pub surface_shift: f32x16<S>,
    /// False for lanes beyond the end of the row.
    pub is_sample: mask32x16<S>,
}

impl Source<'_> {
    /// Reprojects chunk `chunk` of row `row`.
    #[inline(always)]
    pub fn reproject<S: Simd>(&self, simd: S, row: usize, chunk: usize) -> ReprojectedSamples<S> {
        let splat = |v: f32| f32x16::splat(simd, v);
        // Positions on the frame's own HR grid.
        let Places { x: from_x, y: from_y, is_sample } = self.frame.places(simd, row, chunk, self.scale);
        let w = f32x16::load_array_ref(simd, self.frame.chunk(row, chunk).inverse_depth());
        if let Some(displacement) = self.frame.displacement(row, chunk) {
            return self.reproject_displaced(simd, [from_x, from_y, w], is_sample, displacement);
        }
        let [x, y, q] = self.reprojection.apply_16(simd, from_x, from_y, w);
        let (moved_x, moved_y) = (x - from_x, y - from_y);
        ReprojectedSamples {
            x,
            y,
            inverse_depth: w * (1.0 / q),
            q,
            moved: moved_x.mul_add(moved_x, moved_y * moved_y),
            // As if the camera moved sideways: motion along the view counts as well, because footprints change.
            staleness: w.mul_add(self.parallax, splat(PER_FRAME * self.age as f32)),
            surface_shift: splat(0.0),
            is_sample,
        }
    }

    /// Reprojects samples at `from` (x, y and inverse depth) that may have moved since. A sample that has not moved
    /// gets the same result as by [`Self::reproject`].
    #[inline(always)]
    fn reproject_displaced<S: Simd>(
        &self,
        simd: S,
        [from_x, from_y, w]: [f32x16<S>; 3],
        is_sample: mask32x16<S>,
        displacement: &Displacement,
    ) -> ReprojectedSamples<S> {
        let [dx, dy, dz] = displacement.offsets(simd);
        let surface_shift = displacement.surface_shift(simd);
        let [x, y, q] = self.reprojection.apply_moved_16(simd, from_x, from_y, w, [dx, dy, dz]);
        let (moved_x, moved_y) = (x - from_x, y - from_y);
        let moved = moved_x.mul_add(moved_x, moved_y * moved_y);
        // An object that moves in front of the camera is seen from another side, just as when the camera moves around
        // it.
        let way = dx.mul_add(dx, dy.mul_add(dy, dz * dz)).sqrt();
        let staleness = w.mul_add(self.parallax, f32x16::splat(simd, PER_FRAME * self.age as f32));
        ReprojectedSamples {
            x,
            y,
            inverse_depth: w * (1.0 / q),
            q,
            moved: moved.max(surface_shift * surface_shift),
            staleness: (way * w).mul_add(self.focal, staleness),
            surface_shift,
            is_sample: is_sample & surface_shift.simd_lt(f32::INFINITY),
        }
    }

    /// Reprojects chunk `chunk` of row `row` into `tile`.
    #[inline(always)]
    fn footprints<S: Simd>(
        &self,
        simd: S,
        row: usize,
        chunk: usize,
        tile: &Tile<'_>,
        rectification: &Rectification,
    ) -> Footprints {
        let splat = |v: f32| f32x16::splat(simd, v);
        let seen = self.reproject(simd, row, chunk);
        let chunk = self.frame.chunk(row, chunk);
        let (x, y, w) = (seen.x - 0.5, seen.y - 0.5, seen.inverse_depth);
        let change = f32x16::load_array_ref(simd, chunk.edge_slopes()) * self.parallax;
        let position = [x, y, w];
        // Positions relative to the tile, with its first pixel at (PAD_X, PAD_Y).
        let (x, y) = (x - (tile.left as f32 - PAD_X as f32), y - (tile.top as f32 - PAD_Y as f32));
        let (first_x, first_y) = (x.floor() - 1.0, (y + 0.5).floor() - 1.0);
        let reached = seen.is_sample
            & seen.q.simd_gt(MIN_DIVISOR)
            & first_x.simd_gt(PAD_X as f32 - COLUMNS as f32)
            & first_x.simd_lt((PAD_X + tile.width) as f32)
            & first_y.simd_gt(PAD_Y as f32 - ROWS as f32)
            & first_y.simd_lt((PAD_Y + tile.height) as f32);
        let variance = rectification.variance(simd, position, chunk.colors(), seen.staleness, change);
        let pixel = [(x + 0.5).floor() - PAD_X as f32, first_y + (1.0 - PAD_Y as f32)];
        let nearest = tile.nearest.around(simd, pixel);
        // A nearer sample may hide this one now. This is more likely, the farther the two have moved apart. The
        // sample is not excluded: depths at silhouettes are inexact, and there may be no better sample.
        let apart = (nearest - w) * self.parallax + seen.surface_shift;
        let is_behind = w.simd_lt(nearest * (1.0 - DEPTH_TOLERANCE));
        let variance = is_behind.select(apart.mul_add(apart * OCCLUDED, variance), variance);
        // A sample that does not move keeps its exact value. Only motion (0 at rest, towards 1 for a pixel or more)
        // gives weight to staleness and rectification.
        let motion = seen.moved / (seen.moved + 1.0);
        let (aging, alike) = if self.frame.is_blocks() { (AGING_OF_BLOCKS, ALIKE) } else { (AGING, 1.0) };
        let noise = seen.staleness.mul_add(aging, variance * alike).mul_add(motion, splat(NOISE));
        let seen = reached & noise.simd_le(MAX_NOISE);
        let (first_x, first_y) =
            if self.frame.is_blocks() { (x.floor(), y.floor()) } else { (first_x, first_y) };
        let first = first_y.mul_add(STRIDE as f32, first_x).to_int::<i32x16<S>>();
        Footprints {
            first: first.to_array(),
            x: (x - first_x).to_array(),
            y: (y - first_y).to_array(),
            noise: noise.to_array(),
            seen: seen.to_bitmask() & 0xffff,
        }
    }
}

impl<'a> Tile<'a> {
    /// Adds the predictions of the samples of chunk `chunk` of row `row` for the pixels around them.
    #[inline(always)]
    pub fn splat_color<S: Simd>(
        &mut self,
        simd: S,
        source: &Source<'a>,
        rectification: &Rectification,
        row: usize,
        chunk: usize,
    ) {
        let footprints = source.footprints(simd, row, chunk, self, rectification);
        if footprints.seen == 0 {
            return;
        }
        let chunk = source.frame.chunk(row, chunk);
        if source.frame.is_blocks() {
            return self.splat_block(simd, &footprints, chunk);
        }
        let columns = f32x16::from_fn(simd, |k| (k % COLUMNS) as f32);
        let pixels = f32x16::from_fn(simd, |k| (k / 4) as f32);
        let is_color = f32x16::from_fn(simd, |k| (k % 4) as f32).simd_lt(3.0);
        let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
        let mut weights = [[0.0; 16]; ROWS];
        for group in 0..CHUNK / 4 {
            let at = 4 * group..4 * group + 4;
            // Lanes: four samples, four columns each.
            let dx = columns - spread(simd, &footprints.x[at.clone()]);
            let dx2 = dx * dx;
            let y = spread(simd, &footprints.y[at.clone()]);
            let noise = spread(simd, &footprints.noise[at.clone()]);
            for (r, weights) in weights.iter_mut().enumerate() {
                let dy = y - r as f32;
                let d2 = dy.mul_add(dy, dx2);
                d2.mul_add(d2, noise).approximate_recip().store_array(weights);
            }
            for (s, i) in at.enumerate() {
                if footprints.seen >> i & 1 == 0 {
                    continue;
                }
                let Ok(first) = usize::try_from(footprints.first[i]) else {
                    break;
                };
                self.take_neighbor(&footprints, i, first, chunk);
                // Lanes: four pixels in a row, four channels each.
                let [color, dx, dy] = chunk.quads(i);
                let along_y = is_color.select(repeat(simd, dy), zero);
                let along_x = repeat(simd, dx).mul_add(pixels - footprints.x[i], repeat(simd, color));
                // The fourth lane is the weight itself, beside the weighted colour.
                let mut prediction = is_color.select(along_y.mul_add(-footprints.y[i], along_x), one);
                let Some(target) = self.pixels.get_mut(first..first + (ROWS - 1) * STRIDE + COLUMNS) else {
                    break;
                };
                for (r, weights) in weights.iter().enumerate() {
                    let weight = spread(simd, &weights[4 * s..4 * s + 4]);
                    let target = target[r * STRIDE..r * STRIDE + COLUMNS].as_flattened_mut();
                    prediction.mul_add(weight, f32x16::from_slice(simd, target)).store_slice(target);
                    prediction += along_y;
                }
            }
        }
    }

    /// Hands sample `i` of `chunk`, whose first pixel is `first`, to the neighbourhoods, if pixels are to be kriged.
    #[inline(always)]
    fn take_neighbor(&mut self, footprints: &Footprints, i: usize, first: usize, chunk: &'a Chunk) {
        if let Some(neighborhoods) = &mut self.neighborhoods {
            let Footprints { x, y, noise, .. } = footprints;
            let at = [(first % STRIDE) as f32 + x[i], (first / STRIDE) as f32 + y[i]];
            neighborhoods.take(at, noise[i], chunk.sample(i));
        }
    }

    /// Adds the predictions of an exact block's samples, `chunk`, to the four pixels around each.
    #[inline(always)]
    fn splat_block<S: Simd>(&mut self, simd: S, footprints: &Footprints, chunk: &'a Chunk) {
        let x = f32x16::load_array_ref(simd, &footprints.x);
        let y = f32x16::load_array_ref(simd, &footprints.y);
        let noise = f32x16::load_array_ref(simd, &footprints.noise);
        let mut weights = [[0.0; CHUNK]; CORNERS.len()];
        for (weights, [column, row]) in weights.iter_mut().zip(CORNERS) {
            let (dx, dy) = (x - column as f32, y - row as f32);
            let d2 = dy.mul_add(dy, dx * dx);
            let is_near = dx.abs().simd_lt(BLOCK_REACH) & dy.abs().simd_lt(BLOCK_REACH);
            is_near
                .select(d2.mul_add(d2, noise).approximate_recip(), f32x16::splat(simd, 0.0))
                .store_array(weights);
        }
        let is_color = f32x4::load_array(simd, [1.0, 1.0, 1.0, 0.0]).simd_gt(0.0);
        let (zero, one) = (f32x4::splat(simd, 0.0), f32x4::splat(simd, 1.0));
        let mut seen = footprints.seen;
        while seen != 0 {
            let i = seen.trailing_zeros() as usize % CHUNK;
            seen &= seen - 1;
            let Ok(first) = usize::try_from(footprints.first[i]) else { break };
            self.take_neighbor(footprints, i, first, chunk);
            let [color, dx, dy] = chunk.quads(i);
            let [dx, dy] = [dx, dy].map(|slope| is_color.select(f32x4::from_slice(simd, slope), zero));
            let at_row = dx.mul_add(-footprints.x[i], f32x4::from_slice(simd, color));
            let at_corner = is_color.select(dy.mul_add(-footprints.y[i], at_row), one);
            let below = at_corner + dy;
            let predictions = [at_corner, at_corner + dx, below, below + dx];
            let Some(target) = self.pixels.get_mut(first..first + STRIDE + 2) else { break };
            for ((prediction, weights), [column, row]) in predictions.into_iter().zip(&weights).zip(CORNERS) {
                let pixel = &mut target[row * STRIDE + column];
                prediction.mul_add(weights[i], f32x4::load_array_ref(simd, pixel)).store_array(pixel);
            }
        }
    }
}

impl Tile<'_> {
    /// The depth pre-pass: adds the depths of the samples of chunk `chunk` of row `row` to the nearest depths.
    #[inline(always)]
    pub fn splat_depth<S: Simd>(&mut self, simd: S, source: &Source<'_>, row: usize, chunk: usize) {
        let seen = source.reproject(simd, row, chunk);
        let [x, y] = [seen.x.floor() - self.left as f32, seen.y.floor() - self.top as f32];
        let rim = RIM as f32;
        let is_in = seen.is_sample
            & seen.q.simd_gt(MIN_DIVISOR)
            & x.simd_ge(-rim)
            & y.simd_ge(-rim)
            & x.simd_lt(self.width as f32 + rim)
            & y.simd_lt(self.height as f32 + rim);
        // Samples outside go to the first place with depth 0, which changes nothing.
        let nothing = f32x16::splat(simd, 0.0);
        let (x, y) = (is_in.select(x, nothing - rim), is_in.select(y, nothing - rim));
        let (places, depths) =
            (place(simd, [x, y]).to_array(), is_in.select(seen.inverse_depth, nothing).to_array());
        // The length is known to the compiler, so no index needs a check.
        let Some(at) = self.nearest.at.first_chunk_mut::<PLACES>() else { return };
        for (place, depth) in places.into_iter().zip(depths) {
            let nearest = &mut at[place as usize % PLACES];
            *nearest = if depth > *nearest { depth } else { *nearest };
        }
    }
}
