//! Selects the best of the samples around pixels.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

use super::{FARTHEST, SAMPLES};
use crate::cpu::samples::CHUNK;

/// Capacity for the samples around a pixel, a power of two. It overflows only if the camera moves away from the scene
/// very fast. Then all samples except the best ones are dropped to make room.
pub(super) const SEEN: usize = 64;

/// The samples around sixteen pixels that are near enough.
pub(super) struct Candidates {
    /// Per pixel, variances of the samples' first-order predictions: the capacity, plus one vector.
    variances: [[f32; SEEN + CHUNK]; CHUNK],
    /// The places of the same samples.
    pub places: [[u32; SEEN + CHUNK]; CHUNK],
    counts: [u32; CHUNK],
}

impl Candidates {
    pub const fn new() -> Self {
        Self {
            variances: [[FARTHEST; SEEN + CHUNK]; CHUNK],
            places: [[0; SEEN + CHUNK]; CHUNK],
            counts: [0; CHUNK],
        }
    }

    /// Removes all samples.
    pub fn begin(&mut self) {
        self.counts = [0; CHUNK];
    }

    /// Adds samples around the pixel of a lane: the samples that are `near`.
    #[inline(always)]
    pub fn see<S: Simd>(&mut self, lane: usize, near: mask32x16<S>, variances: f32x16<S>, places: u32x16<S>) {
        let count = near.to_bitmask().count_ones();
        if self.counts[lane] + count > SEEN as u32 {
            self.keep_best(lane);
        }
        let end = self.counts[lane] as usize;
        variances.compress(near).store_slice(&mut self.variances[lane][end..end + CHUNK]);
        places.compress(near).store_slice(&mut self.places[lane][end..end + CHUNK]);
        self.counts[lane] += count;
    }

    /// Drops all samples around a pixel except the best ones.
    #[cold]
    #[inline(never)]
    fn keep_best(&mut self, lane: usize) {
        let (variances, places) = (&mut self.variances[lane], &mut self.places[lane]);
        let count = self.counts[lane] as usize;
        let mut all: Vec<(f32, u32)> = variances[..count].iter().copied().zip(*places).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.truncate(SAMPLES + 1);
        self.counts[lane] = all.len() as u32;
        for (k, (variance, place)) in all.into_iter().enumerate() {
            (variances[k], places[k]) = (variance, place);
        }
    }

    /// The least variances around each pixel, in order. Their last bits are the sample's place in the list.
    #[inline(always)]
    pub fn least<S: Simd>(&self, simd: S, least: &mut [[f32; CHUNK]; SAMPLES + 1]) {
        let none = f32x16::splat(simd, FARTHEST);
        let counts = u32x16::load_array_ref(simd, &self.counts);
        let most = self.counts.iter().fold(0, |most, count| *count.max(&most)) as usize;
        let mut best = [none; SAMPLES + 1];
        for first in (0..most).step_by(CHUNK) {
            let mut variances = [none; CHUNK];
            for (variances, all) in variances.iter_mut().zip(&self.variances) {
                *variances = f32x16::from_slice(simd, &all[first..first + CHUNK]);
            }
            for (k, variance) in (first..most).zip(transposed(variances)) {
                let bits: u32x16<S> = variance.bitcast();
                let key: f32x16<S> = ((bits & !(SEEN as u32 - 1)) | k as u32).bitcast();
                let mut key = counts.simd_gt(k as u32).select(key, none);
                for best in &mut best {
                    let less = best.min(key);
                    key = best.max(key);
                    *best = less;
                }
            }
        }
        for (best, to) in best.iter().zip(least) {
            best.store_array(to);
        }
    }
}

/// Transposes: columns of `rows`.
#[inline(always)]
fn transposed<S: Simd>(rows: [f32x16<S>; CHUNK]) -> [f32x16<S>; CHUNK] {
    // Interleaving both halves, as in a shuffle of cards, moves one bit of the row's number to the end of the
    // column's.
    let mut all = rows;
    for _ in 0..CHUNK.ilog2() {
        let before = all;
        for k in 0..CHUNK / 2 {
            let (a, b) = (before[k], before[k + CHUNK / 2]);
            (all[2 * k], all[2 * k + 1]) = (a.zip_low(b), a.zip_high(b));
        }
    }
    all
}
