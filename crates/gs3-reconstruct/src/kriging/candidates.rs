//! Of the samples around pixels, the best.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::system::load;
use super::{FARTHEST, NONE, SAMPLES};
use crate::samples::CHUNK;

/// Room for the samples around a pixel, but where the camera flees from the scene: a power of two.
pub(super) const SEEN: usize = 32;

/// The samples around sixteen pixels. A key is the variance of a sample's first-order prediction, whose last bits are its place
/// in the list.
pub(super) struct Candidates {
    keys: [[f32; CHUNK]; SEEN],
    pub samples: [[u32; SEEN]; CHUNK],
}

impl Candidates {
    pub const fn new() -> Self {
        Self { keys: [[FARTHEST; CHUNK]; SEEN], samples: [[NONE; SEEN]; CHUNK] }
    }

    /// Adds a sample to `count` others, in place of the worst if there is no room; how many there are.
    #[inline(always)]
    pub fn add(&mut self, lane: usize, count: usize, variance: f32, sample: u32) -> usize {
        let mut place = count;
        if count == SEEN {
            let of = |k: usize| self.keys[k][lane];
            place = (1..SEEN).fold(0, |worst, k| if of(k) > of(worst) { k } else { worst });
            if variance >= of(place) {
                return count;
            }
        }
        self.keys[place][lane] = f32::from_bits(variance.to_bits() & !(SEEN as u32 - 1) | place as u32);
        self.samples[lane][place] = sample;
        count.max(place + 1)
    }

    /// The least keys of the first `count`, in order, and forgets all.
    #[inline(always)]
    pub fn least<S: Simd>(&mut self, simd: S, count: usize, least: &mut [[f32; CHUNK]; SAMPLES + 1]) {
        let none = f32x16::splat(simd, FARTHEST);
        let mut best = [none; SAMPLES + 1];
        for keys in &mut self.keys[..count] {
            let mut key = load(simd, keys);
            none.store_array(keys);
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
