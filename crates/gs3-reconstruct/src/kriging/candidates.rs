//! Of the samples around pixels, the best.

use fearless_simd::{Simd, f32x16, prelude::*, u32x16};

use super::system::load;
use super::{FARTHEST, SAMPLES};
use crate::samples::CHUNK;

/// Room for the samples around a pixel, but where the camera flees from the scene: a power of two. Where there are more, those seen
/// so far make way, but for the best.
pub(super) const SEEN: usize = 64;

/// The samples around sixteen pixels.
pub(super) struct Candidates {
    /// Variances of the first-order predictions of the samples seen around one pixel: of those it has room for, and a vector.
    seen: [f32; SEEN + CHUNK],
    /// And their places.
    seen_at: [u32; SEEN + CHUNK],
    count: usize,
    /// Variances of those near enough, and none after them.
    variances: [[f32; CHUNK]; SEEN],
    /// Their places.
    pub samples: [[u32; SEEN]; CHUNK],
}

impl Candidates {
    pub const fn new() -> Self {
        Self {
            seen: [FARTHEST; SEEN + CHUNK],
            seen_at: [0; SEEN + CHUNK],
            count: 0,
            variances: [[FARTHEST; CHUNK]; SEEN],
            samples: [[0; SEEN]; CHUNK],
        }
    }

    /// Begins another pixel.
    #[inline(always)]
    pub fn begin(&mut self) {
        self.count = 0;
    }

    /// Sees samples, the first `count` of a vector.
    #[inline(always)]
    pub fn see<S: Simd>(&mut self, variances: f32x16<S>, places: u32x16<S>, count: usize) {
        let count = count.min(CHUNK);
        if self.count + count > SEEN {
            self.keep_best();
        }
        variances.store_slice(&mut self.seen[self.count..self.count + CHUNK]);
        places.store_slice(&mut self.seen_at[self.count..self.count + CHUNK]);
        self.count += count;
    }

    /// Forgets all samples seen but as many as matter.
    #[cold]
    #[inline(never)]
    fn keep_best(&mut self) {
        let mut all: Vec<(f32, u32)> = self.seen[..self.count].iter().copied().zip(self.seen_at).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.truncate(SAMPLES + 1);
        self.count = all.len();
        for (k, (variance, place)) in all.into_iter().enumerate() {
            (self.seen[k], self.seen_at[k]) = (variance, place);
        }
    }

    /// Lists the samples seen that are near enough in a lane; how many.
    #[inline(always)]
    pub fn list<S: Simd>(&mut self, simd: S, lane: usize) -> usize {
        let mut listed = 0;
        for first in (0..self.count).step_by(CHUNK) {
            let variances = f32x16::from_slice(simd, &self.seen[first..first + CHUNK]);
            let seen = (self.count - first).min(CHUNK);
            let mut near = variances.simd_lt(FARTHEST).to_bitmask() & ((1 << seen) - 1);
            while near != 0 {
                let k = first + near.trailing_zeros() as usize;
                self.variances[listed][lane] = self.seen[k];
                self.samples[lane][listed] = self.seen_at[k];
                listed += 1;
                near &= near - 1;
            }
        }
        listed
    }

    /// The least variances of the first `count`, in order, their last bits the sample's place in the list, and forgets all.
    #[inline(always)]
    pub fn least<S: Simd>(&mut self, simd: S, count: usize, least: &mut [[f32; CHUNK]; SAMPLES + 1]) {
        let none = f32x16::splat(simd, FARTHEST);
        let mut best = [none; SAMPLES + 1];
        for (k, variances) in self.variances[..count].iter_mut().enumerate() {
            let variance = load(simd, variances);
            none.store_array(variances);
            let bits: u32x16<S> = variance.bitcast();
            let mut key: f32x16<S> = ((bits & !(SEEN as u32 - 1)) | k as u32).bitcast();
            for best in &mut best {
                let less = best.min(key);
                key = best.max(key);
                *best = less;
            }
        }
        for (best, to) in best.iter().zip(least) {
            best.store_array(to);
        }
    }
}
