//! A rectangle of HR pixels being made, small enough to stay in the caches.

use std::cell::Cell;
use std::fmt;

use fearless_simd::{Simd, f32x16, prelude::*, u8x64};
use gs3_scene::BLOCK_SIDE;
use thread_local::ThreadLocal;

use crate::cpu::gather::QUAD;
use crate::cpu::hermite::{Columns, Surface};
use crate::cpu::kriging::Neighborhoods;
use crate::cpu::lanes::load;
use crate::cpu::nearest::Nearest;
use crate::cpu::samples::SampleFrame;
use crate::cpu::tile_size::{PAD_X, PAD_Y, RING, ROWS, RUN, STRIDE, TILE_HEIGHT, TILE_WIDTH};
use crate::sample_grid::SampledPixels;

/// Variance floor of a prediction, in pixel⁴. A sample on a pixel centre then has 10⁵ times the weight of a sample
/// one pixel away. At rest, all neighbours together change a pixel by less than 1e-4 of their own error.
pub(crate) const NOISE: f32 = 1e-5;

/// Variance of the interpolated current frame at distance d from its nearest sample, in pixel⁴. The variance of one
/// sample's first-order prediction is d⁴. It is multiplied by [`SURFACE`], because the surface joins four samples. It
/// flattens to a square, because no error exceeds the contrast of the image (both empirical).
pub(crate) const SURFACE: f32 = 0.5;

/// Deviation up to which a pixel counts as exact, in pixel²: the deviation of one sample on its centre, √[`NOISE`] =
/// 0.00316, plus a little for the rounding of places and weights.
pub(crate) const EXACT: f32 = 0.0033;

/// Factor of a pixel's Laplacian times its uncertainty (pixel²) in the correction that is added to the pixel.
/// First-order predictions at a distance d err by −½ dᵀH d. With one sample on each side, the error is a quarter of
/// d² times the Laplacian. The uncertainty is d² over the root of the number of samples (empirical: 0.15 to 0.25 are
/// alike). Uncertainties end at 1.
pub(crate) const CURVATURE: f32 = 0.2;

/// Number of channels of four pixels in a row: colours and uncertainties.
const CHANNELS_OF_ROW: usize = 4 * BLOCK_SIDE;
const _: () = assert!(QUAD == BLOCK_SIDE && TILE_WIDTH.is_multiple_of(BLOCK_SIDE));
const _: () = assert!(TILE_HEIGHT.is_multiple_of(BLOCK_SIDE));

/// The squared error expected per squared correction for curvature. (Empirical: `examples/expected_error.rs` finds true
/// errors 1.6 to 3.0 times the correction, over tenths of the blocks of six paths.)
pub(crate) const PER_LAPLACIAN: f32 = 6.0;

/// Inverse variances (pixel⁻⁴) below this value say nothing: past samples more than 2.6 pixels away, or with a larger
/// variance.
pub(crate) const FAINT: f32 = 0.02;

/// A tile accumulates pixels: per pixel Σ weight·RGB and Σ weight, 16 B each. Its memory is not part of an image. In
/// an image, rows may lie a multiple of the caches' period apart (4096 pixels: 64 KiB) and evict each other.
pub(crate) struct Tile<'a> {
    /// Column in the image of the tile's first pixel.
    pub left: usize,
    /// Row in the image of the tile's first pixel.
    pub top: usize,
    /// At most [`SPAN`].
    pub width: usize,
    /// At most [`TILE_HEIGHT`] plus twice [`RING`].
    pub height: usize,
    /// The first pixel of the tile is `(PAD_X, PAD_Y)`. The values around the tile are unspecified.
    pub pixels: Vec<[f32; 4]>,
    /// The nearest depths on the tile's pixels and around them, as far as samples that reach the tile may lie.
    pub nearest: Nearest,
    columns: Columns,
    /// The neighbourhoods, if pixels are to be kriged.
    pub neighborhoods: Option<Neighborhoods<'a>>,
}

impl Default for Tile<'_> {
    fn default() -> Self {
        Self {
            left: 0,
            top: 0,
            width: 0,
            height: 0,
            pixels: vec![[0.0; 4]; STRIDE * ROWS],
            nearest: Nearest::new(),
            columns: Columns::new(),
            neighborhoods: None,
        }
    }
}

/// The tiles of all threads. New and zeroed for most bands of each frame, their memory would cost time.
#[derive(Default)]
pub(crate) struct Tiles(ThreadLocal<Cell<Option<Tile<'static>>>>);

impl fmt::Debug for Tiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Tiles").finish_non_exhaustive()
    }
}

impl Tiles {
    /// Does `work` with the tile of this thread and with `neighborhoods`.
    #[inline(always)]
    pub fn with<'a>(&self, neighborhoods: &mut Option<Neighborhoods<'a>>, work: impl FnOnce(&mut Tile<'a>)) {
        let kept = self.0.get_or_default();
        let mut tile = Tile { neighborhoods: neighborhoods.take(), ..kept.take().unwrap_or_default() };
        work(&mut tile);
        *neighborhoods = tile.neighborhoods.take();
        kept.set(Some(tile.without_neighborhoods()));
    }
}

impl<'a> Tile<'a> {
    /// What is kept of the tile: neighbourhoods belong to a frame.
    fn without_neighborhoods(self) -> Tile<'static> {
        let Self { left, top, width, height, pixels, nearest, columns, neighborhoods: _ } = self;
        Tile { left, top, width, height, pixels, nearest, columns, neighborhoods: None }
    }

    /// Starts the tile with the interpolated current frame.
    #[inline(always)]
    pub fn begin<S: Simd>(&mut self, simd: S, surface: &Surface, scale: f32) {
        if let Some(neighborhoods) = &mut self.neighborhoods {
            neighborhoods.begin(STRIDE, ROWS);
        }
        for r in 0..self.height {
            let y = self.top + r;
            let to_sample = |f: f32| f.min(1.0 - f) * scale;
            let dy = to_sample(surface.y_place(y).fraction);
            let mut weights = [0.0; crate::MAX_SCALE as usize];
            for (weight, fraction) in weights.iter_mut().zip(surface.x_fractions()) {
                let dx = to_sample(fraction);
                let d2 = dx * dx + dy * dy;
                *weight = 1.0 / (NOISE + SURFACE * d2 * d2 / (1.0 + SURFACE * d2));
            }
            let row = &mut self.pixels[(PAD_Y + r) * STRIDE..][..STRIDE];
            surface.row(simd, y, self.left..self.left + self.width, &weights, &mut self.columns, row);
        }
    }

    /// Empties the pixels of `sampled`. Splatting then makes them the prediction of the history alone.
    pub fn clear_pixels(&mut self, sampled: &SampledPixels) {
        for (_, y) in sampled.along(1, self.top, self.height) {
            for (_, x) in sampled.along(0, self.left, self.width) {
                self.pixels[(PAD_Y + y) * STRIDE + PAD_X + x] = [0.0; 4];
            }
        }
    }

    /// Adds the samples of the current frame `frame` to the pixels of `sampled`, which [`Self::clear_pixels`]
    /// emptied. The difference of each sample on `wanted` pixels from the history's prediction goes into `rows`. The
    /// first row of samples in `rows` is row `first_row`.
    pub fn insert_current(
        &mut self,
        sampled: &SampledPixels,
        frame: &SampleFrame,
        wanted: &Wanted,
        rows: &mut [[f32; 4]],
        first_row: usize,
    ) {
        let is_wanted = |at: usize, first: usize, count: usize| (first..first + count).contains(&at);
        let [columns, lines] = frame.picture_size();
        for (j, y) in sampled.along(1, self.top, self.height) {
            for (i, x) in sampled.along(0, self.left, self.width) {
                if i >= columns || j >= lines {
                    continue;
                }
                let [r, g, b, ..] = *frame.picture_sample(i, j);
                let color = [r, g, b, 1.0];
                let pixel = &mut self.pixels[(PAD_Y + y) * STRIDE + PAD_X + x];
                let [.., weight] = *pixel;
                if is_wanted(self.left + x, wanted.left, wanted.width)
                    && is_wanted(self.top + y, wanted.top, wanted.height)
                    && let Some(out) = rows.get_mut((j - first_row) * columns + i)
                {
                    *out = [0.0, 0.0, 0.0, weight / (1.0 + weight)];
                    if weight > FAINT {
                        for c in 0..3 {
                            out[c] = color[c] - pixel[c] / weight;
                        }
                    }
                }
                for (sum, value) in pixel.iter_mut().zip(color) {
                    *sum += value / NOISE;
                }
            }
        }
    }

    /// Writes colours and uncertainties of the `wanted` pixels into `rows`, image rows from the first wanted row on.
    /// The expected squared errors of the blocks of 4×4 pixels in these rows go into `errors`.
    #[inline(always)]
    pub fn resolve<S: Simd>(&mut self, simd: S, wanted: &Wanted, rows: &mut [[f32; 4]], errors: &mut [f32]) {
        let mut sums = [[0.0; CHANNELS_OF_ROW]; TILE_WIDTH / BLOCK_SIDE];
        let blocks_per_row = wanted.stride.div_ceil(BLOCK_SIDE);
        let mut neighborhoods = self.neighborhoods.take();
        let mut resolved = [const { Resolved::new() }; 3];
        let (before_row, within) = (wanted.top - self.top, wanted.left - self.left);
        // Neighbours beyond the image are its border pixels.
        let row_at = |r: isize| (r.max(0) as usize).min(self.height - 1);
        let [a, b, c] = &mut resolved;
        let (mut above, mut here, mut below) = (a, b, c);
        above.fill(simd, self, row_at(before_row as isize - 1), within);
        here.fill(simd, self, row_at(before_row as isize), within);
        for r in 0..wanted.height {
            below.fill(simd, self, row_at((before_row + r + 1) as isize), within);
            let place = r * wanted.stride + wanted.left;
            let out = &mut rows[place..][..wanted.width];
            correct(simd, [&*above, &*here, &*below], out, &mut sums);
            if (r + 1).is_multiple_of(BLOCK_SIDE) || r + 1 == wanted.height {
                let first = r / BLOCK_SIDE * blocks_per_row + wanted.left / BLOCK_SIDE;
                let blocks = wanted.width.div_ceil(BLOCK_SIDE);
                for (error, sums) in errors[first..first + blocks].iter_mut().zip(&mut sums) {
                    *error = PER_LAPLACIAN * f32x16::load_array(simd, std::mem::take(sums)).reduce_sum();
                }
            }
            if let Some(neighborhoods) = &mut neighborhoods {
                let pixels = here.pixels[RING..].chunks(QUAD).zip(out.chunks(QUAD));
                for (i, (before, after)) in (0..).step_by(QUAD).zip(pixels) {
                    let before = load(simd, before[..after.len()].as_flattened());
                    let after = load(simd, after.as_flattened());
                    // Uncertainties are not changed.
                    let mut changed = (after - before).abs().simd_gt(neighborhoods.threshold).to_bitmask();
                    while changed != 0 {
                        let k = changed.trailing_zeros() as usize / 4;
                        changed &= !(0xf << (4 * k));
                        neighborhoods.want([PAD_X + within + i + k, PAD_Y + before_row + r], place + i + k);
                    }
                }
            }
            (above, here, below) = (here, below, above);
        }
        if let Some(neighborhoods) = &mut neighborhoods {
            neighborhoods.krige(simd, rows);
        }
        self.neighborhoods = neighborhoods;
    }
}

/// The part of a tile that is written to an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    pub left: usize,
    pub top: usize,
    pub width: usize,
    pub height: usize,
    /// Pixels per row of the image.
    pub stride: usize,
}

/// A row of colours and uncertainties: the wanted pixels, with one pixel on their left and one on their right.
struct Resolved {
    pixels: [[f32; 4]; STRIDE],
}

impl Resolved {
    const fn new() -> Self {
        Self { pixels: [[0.0; 4]; STRIDE] }
    }

    /// Loads row `r` of `tile`. The first wanted pixel of the row is pixel `within`: 0 or [`RING`].
    #[inline(always)]
    fn fill<S: Simd>(&mut self, simd: S, tile: &Tile<'_>, r: usize, within: usize) {
        let row = &tile.pixels[(PAD_Y + r) * STRIDE + PAD_X..];
        let start = RING - within;
        // Every lane of a block gets the value of lane k.
        let lane = |k: usize| u8x64::from_fn(simd, |i| (4 * k + i % 4) as u8);
        let place = f32x16::from_fn(simd, |i| (i % 4) as f32);
        let of_quad = |k: usize| place.simd_eq(k as f32);
        let (lanes, of_quads) =
            ([lane(0), lane(1), lane(2), lane(3)], [of_quad(0), of_quad(1), of_quad(2), of_quad(3)]);
        let runs = tile.width.div_ceil(RUN);
        for (pixels, out) in row.chunks_exact(RUN).zip(self.pixels[start..].chunks_exact_mut(RUN)).take(runs)
        {
            let (pixels, out) = (pixels.as_flattened(), out.as_flattened_mut());
            // Lane 4 b + k has the weight of pixel b of vector k.
            let mut weight = f32x16::splat(simd, 1.0);
            for (k, of_quad) in of_quads.into_iter().enumerate() {
                let sums = f32x16::from_slice(simd, &pixels[RUN * k..RUN * k + RUN]);
                weight = of_quad.select(sums.swizzle_dyn_within_blocks(lanes[3]), weight);
            }
            let variance = 1.0 / weight;
            let uncertainty = (variance.sqrt() - EXACT).max(0.0).min(1.0);
            for k in 0..RUN / 4 {
                let sums = f32x16::from_slice(simd, &pixels[RUN * k..RUN * k + RUN]);
                let color = sums * variance.swizzle_dyn_within_blocks(lanes[k]);
                let pixel = of_quads[3].select(uncertainty.swizzle_dyn_within_blocks(lanes[k]), color);
                pixel.store_slice(&mut out[RUN * k..RUN * k + RUN]);
            }
        }
        if start == RING {
            self.pixels[0] = self.pixels[RING];
        }
        // At the right border this pixel repeats the last pixel. Elsewhere this writes an entry that is never read.
        let end = start + tile.width;
        self.pixels[end] = self.pixels[end - 1];
    }
}

/// Corrects the row between two other rows for the curvature that first-order predictions leave out. The squared
/// products of curvature and uncertainty are added to `sums`, one sum per four pixels.
#[inline(always)]
fn correct<S: Simd>(simd: S, rows: [&Resolved; 3], out: &mut [[f32; 4]], sums: &mut [[f32; 16]]) {
    let uncertainty_lane = u8x64::from_fn(simd, |i| (12 + i % 4) as u8);
    // Uncertainties are not corrected.
    let factor = f32x16::from_fn(simd, |i| if i % 4 == 3 { 0.0 } else { CURVATURE });
    let at = |row: &Resolved, x: usize| f32x16::from_slice(simd, row.pixels[x..x + QUAD].as_flattened());
    for ((k, out), sums) in out.chunks_mut(QUAD).enumerate().zip(sums) {
        let x = RING + k * QUAD;
        let here = at(rows[1], x);
        let around = (at(rows[0], x) + at(rows[2], x)) + (at(rows[1], x - 1) + at(rows[1], x + 1));
        let laplacian = here.mul_add(-4.0, around);
        let uncertainty = here.swizzle_dyn_within_blocks(uncertainty_lane);
        let remainder = laplacian * (uncertainty * factor);
        let corrected = here + remainder;
        let add = |remainder: f32x16<S>, sums: &mut [f32; 16]| {
            remainder.mul_add(remainder, f32x16::load_array_ref(simd, sums)).store_array(sums);
        };
        match out.as_flattened_mut().first_chunk_mut() {
            Some(out) => {
                add(remainder, sums);
                corrected.store_array(out);
            }
            None => {
                // What lies beyond the image is no pixel, and perhaps no number.
                let count = (4 * out.len()) as f32;
                let is_pixel = f32x16::from_fn(simd, |i| i as f32).simd_lt(count);
                add(is_pixel.select(remainder, f32x16::splat(simd, 0.0)), sums);
                let corrected = corrected.to_array();
                for (pixel, corrected) in out.iter_mut().zip(corrected.as_chunks().0) {
                    *pixel = *corrected;
                }
            }
        }
    }
}
