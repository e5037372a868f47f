//! A rectangle of HR pixels being made, small enough to stay in the caches.

use fearless_simd::{Simd, f32x16, prelude::*, u8x64};

use crate::hermite::{Columns, Surface};
use crate::samples::SampleFrame;
use crate::splat::NOISE;

/// Pixels of a tile along x, a multiple of 16.
pub(crate) const TILE_WIDTH: usize = 256;

/// Pixels of a tile along y. Width and height are large against a sample's reach, because samples that reach two tiles are
/// added twice.
pub(crate) const TILE_HEIGHT: usize = 32;

/// Pixels beside those of the tile, for what reaches beyond it: as many as a cell of samples or a sample's reach may need.
pub(crate) const PAD_X: usize = 8;

/// The same above and below.
pub(crate) const PAD_Y: usize = 2;

/// Pixels from one row of a tile to the next.
pub(crate) const STRIDE: usize = TILE_WIDTH + 2 * PAD_X;

/// Variance of the interpolated current frame at distance d from its nearest sample, pixel⁴: that of one sample's
/// first-order prediction, d⁴, times [`SURFACE`] because it joins four samples, and flattening to a square, because no
/// error exceeds the contrast of the image (both empirical).
const SURFACE: f32 = 0.5;

/// Deviation up to which a pixel counts as exact, pixel²: that of one sample on its centre, √[`NOISE`] = 0.00316, and room
/// for the rounding of places and weights.
const EXACT: f32 = 0.0033;

/// Accumulating pixels: per pixel Σ weight·RGB and Σ weight. 16 B each; the memory of the tile is in no image, because there
/// rows may lie a multiple of the caches' period apart (of 4096 pixels: 64 KiB) and drive each other out.
pub(crate) struct Tile {
    /// First column in the image.
    pub left: usize,
    /// First row in the image.
    pub top: usize,
    pub width: usize,
    pub height: usize,
    /// The first pixel of the tile is `(PAD_X, PAD_Y)`; what lies around is not specified.
    pub pixels: [[f32; 4]; STRIDE * (TILE_HEIGHT + 2 * PAD_Y)],
    columns: Columns,
}

impl Tile {
    pub const fn new() -> Self {
        Self {
            left: 0,
            top: 0,
            width: 0,
            height: 0,
            pixels: [[0.0; 4]; STRIDE * (TILE_HEIGHT + 2 * PAD_Y)],
            columns: Columns::new(),
        }
    }

    /// Begins the tile with the interpolated current frame.
    #[inline(always)]
    pub fn begin<S: Simd>(&mut self, simd: S, surface: &Surface, frame: &SampleFrame, scale: f32) {
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
            surface.row(simd, frame, y, self.left..self.left + self.width, &weights, &mut self.columns, row);
        }
    }

    /// Row `r` of the tile as the pixels of the image, `[width]`: colours and uncertainty.
    #[inline(always)]
    pub fn resolve<S: Simd>(&self, simd: S, r: usize, out: &mut [[f32; 4]]) {
        /// Pixels of four vectors, so that one division and one root serve sixteen pixels.
        const RUN: usize = 16;
        let row = &self.pixels[(PAD_Y + r) * STRIDE + PAD_X..];
        // All lanes of a block become its lane k.
        let lane = |k: usize| u8x64::from_fn(simd, |i| (4 * k + i % 4) as u8);
        let place = f32x16::from_fn(simd, |i| (i % 4) as f32);
        let of_quad = |k: usize| place.simd_eq(k as f32);
        let (lanes, of_quads) =
            ([lane(0), lane(1), lane(2), lane(3)], [of_quad(0), of_quad(1), of_quad(2), of_quad(3)]);
        for (pixels, out) in row.chunks_exact(RUN).zip(out.chunks_mut(RUN)) {
            let pixels = pixels.as_flattened();
            // Lane 4 b + k: weight of pixel b of vector k.
            let mut weight = f32x16::splat(simd, 1.0);
            for (k, of_quad) in of_quads.into_iter().enumerate() {
                let sums = f32x16::from_slice(simd, &pixels[RUN * k..RUN * k + RUN]);
                weight = of_quad.select(sums.swizzle_dyn_within_blocks(lanes[3]), weight);
            }
            let variance = 1.0 / weight;
            let uncertainty = (variance.sqrt() - EXACT).max(0.0).min(1.0);
            let mut resolved = [[0.0; 4]; RUN];
            for k in 0..RUN / 4 {
                let sums = f32x16::from_slice(simd, &pixels[RUN * k..RUN * k + RUN]);
                let color = sums * variance.swizzle_dyn_within_blocks(lanes[k]);
                let pixel = of_quads[3].select(uncertainty.swizzle_dyn_within_blocks(lanes[k]), color);
                pixel.store_slice(&mut resolved.as_flattened_mut()[RUN * k..RUN * k + RUN]);
            }
            out.copy_from_slice(&resolved[..out.len()]);
        }
    }
}
