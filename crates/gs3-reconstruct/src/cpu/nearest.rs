//! The depth pre-pass: a z-buffer of all samples, current and past, around the pixels of a tile.
//!
//! The current frame alone misses surfaces thinner than the distance between its samples. Past samples behind such a
//! thin surface would show through it. But other past frames have samples on the thin surface.

use fearless_simd::{Simd, f32x16, i32x16, prelude::*};

use crate::cpu::samples::CHUNK;
use crate::cpu::tile_size::{RING, SPAN, TILE_HEIGHT};

/// Pixels around the tile: samples up to two pixels away reach the tile, and these samples look one pixel further.
pub(crate) const RIM: usize = 3;

/// Pixels from the start of one row to the next.
const STRIDE: usize = (SPAN + 2 * RIM).next_multiple_of(LANES) + LANES;

/// Number of rows in memory.
const ROWS: usize = TILE_HEIGHT + 2 * RING + 2 * RIM;

const LANES: usize = CHUNK;

/// Number of places: a power of two, so that no masked index is ever outside.
pub(crate) const PLACES: usize = (STRIDE * ROWS).next_power_of_two();

/// The pre-pass reads every second frame. Each sample covers nine pixels, so half of S² frames miss next to nothing.
pub(crate) const EVERY: usize = 2;

/// Largest inverse depths, 0 where there is no sample. The tile's first pixel is `(RIM, RIM)`.
pub(crate) struct Nearest {
    /// Largest inverse depth of the samples nearest to each pixel.
    pub at: Vec<f32>,
    /// Largest inverse depth of the samples nearest to the pixel and to the eight pixels around it.
    around: Vec<f32>,
}

impl Nearest {
    pub fn new() -> Self {
        Self { at: vec![0.0; PLACES], around: vec![0.0; PLACES] }
    }

    /// Removes all samples.
    pub fn clear(&mut self) {
        self.at[..STRIDE * ROWS].fill(0.0);
    }

    /// Fills `around`, once all samples are in.
    #[inline(always)]
    pub fn spread<S: Simd>(&mut self, simd: S) {
        let load = |row: &[f32], x: usize| f32x16::from_slice(simd, &row[x..x + LANES]);
        // The first pixel of a row is outside the pixels that are read.
        let runs = || (1..STRIDE - LANES).step_by(LANES);
        let mut across = [[0.0; STRIDE]; 3];
        for r in 0..ROWS {
            let row = &self.at[r * STRIDE..(r + 1) * STRIDE];
            let here = &mut across[r % 3];
            for x in runs() {
                let most = load(row, x - 1).max(load(row, x)).max(load(row, x + 1));
                most.store_slice(&mut here[x..x + LANES]);
            }
            if r < 2 {
                continue;
            }
            let out = &mut self.around[(r - 1) * STRIDE..r * STRIDE];
            for x in runs() {
                let most = load(&across[0], x).max(load(&across[1], x)).max(load(&across[2], x));
                most.store_slice(&mut out[x..x + LANES]);
            }
        }
    }

    /// The largest inverse depths around sixteen pixels, given relative to the tile's first pixel. Values of pixels
    /// more than two pixels outside are unspecified.
    #[inline(always)]
    pub fn around<S: Simd>(&self, simd: S, pixels: [f32x16<S>; 2]) -> f32x16<S> {
        let places = place(simd, pixels).to_array();
        // The length is known to the compiler, so no index needs a check.
        let Some(around) = self.around.first_chunk::<PLACES>() else { return f32x16::splat(simd, 0.0) };
        f32x16::load_array(simd, places.map(|place| around[place as usize % PLACES]))
    }
}

/// Places of pixels, given relative to the tile's first pixel.
#[inline(always)]
pub(crate) fn place<S: Simd>(simd: S, [x, y]: [f32x16<S>; 2]) -> i32x16<S> {
    let rim = f32x16::splat(simd, (RIM * STRIDE + RIM) as f32);
    y.mul_add(STRIDE as f32, x + rim).to_int()
}
