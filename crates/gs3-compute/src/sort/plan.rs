//! Sizes of a sort, from what is sorted and what the device has: one pure function.

use crate::capabilities::{Limits, Subgroups};
use crate::error::GpuError;
use crate::wgsl::constants;

/// The most pairs of a sort. In `sort.wgsl` a count shares a word with two bits of state.
pub const MAX_PAIRS: u32 = (1 << 30) - 1;

/// Number of tiles that one workgroup counts the digits of.
const HISTOGRAMS: u32 = 4;

/// Bits of a digit at most: 256 counts for each tile.
const MAX_DIGIT_BITS: u32 = 8;

/// All sizes of a sort.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SortPlan {
    /// The most pairs.
    pub capacity: u32,
    /// Subgroups that rank keys.
    pub subgroups: Subgroups,
    /// Invocations of a workgroup.
    pub threads: u32,
    /// Pairs of an invocation.
    pub items: u32,
    /// Bits of a key that count.
    pub key_bits: u32,
    /// Digits.
    pub passes: u32,
    /// Bits of a digit.
    pub digit_bits: u32,
    /// Tiles of `threads` × `items` pairs.
    pub tiles: u32,
    /// Workgroups that count digits.
    pub histograms: u32,
    /// Bytes of the buffer of counts of dispatches.
    pub dispatch_bytes: u64,
    /// Bytes of the buffer of handed out tiles and of digits of all keys.
    pub control_bytes: u64,
    /// Bytes of the buffer of digits of every tile.
    pub status_bytes: u64,
}

impl SortPlan {
    /// Sorts of up to `capacity` pairs by the lowest `key_bits` bits of their keys: 8 bits a pass, or fewer where that
    /// needs no more passes.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] above [`MAX_PAIRS`] or 32 bits, or if the device cannot bind as much.
    pub fn new(
        limits: &Limits,
        subgroups: Subgroups,
        capacity: u32,
        key_bits: u32,
    ) -> Result<Self, GpuError> {
        let at_most = |what: &str, max: u64, actual: u64| match actual <= max {
            true => Ok(()),
            false => Err(GpuError::TooLarge { what: what.to_owned(), max, actual }),
        };
        at_most("pairs of a sort", MAX_PAIRS.into(), capacity.into())?;
        at_most("bits of a key", 32, key_bits.into())?;
        let passes = key_bits.max(1).div_ceil(MAX_DIGIT_BITS);
        let digit_bits = key_bits.max(1).div_ceil(passes);
        let bins = 1 << digit_bits;
        // The largest tile that fits: the longer, the fewer looks at other tiles.
        let mut shapes: Vec<[u32; 2]> =
            [256, 128, 64].iter().flat_map(|t| [16, 12, 8, 4, 2].map(|i| [*t, i])).collect();
        shapes.sort_by_key(|[threads, items]| std::cmp::Reverse(threads * items));
        let fits = |[threads, items]: &[u32; 2]| {
            let bytes = workgroup_bytes(subgroups, *threads, *items, bins, passes);
            *threads <= limits.workgroup_invocations && bytes <= limits.workgroup_bytes
        };
        let [threads, items] = shapes.into_iter().find(fits).ok_or_else(|| GpuError::TooLarge {
            what: "bytes of workgroup memory of a sort".to_owned(),
            max: limits.workgroup_bytes.into(),
            actual: workgroup_bytes(subgroups, 64, 2, bins, passes).into(),
        })?;
        let tiles = capacity.div_ceil(threads * items).max(1);
        let plan = Self {
            capacity,
            subgroups,
            threads,
            items,
            key_bits: key_bits.max(1),
            passes,
            digit_bits,
            tiles,
            histograms: tiles.div_ceil(HISTOGRAMS),
            dispatch_bytes: 6 * 4,
            control_bytes: u64::from(passes * (1 + bins)) * 4,
            status_bytes: 2 * u64::from(tiles) * u64::from(bins) * 4,
        };
        let max = limits.binding_bytes.min(limits.buffer_bytes);
        at_most("bytes of a sort's digits", max, plan.status_bytes)?;
        at_most("bytes of a sort's keys", max, u64::from(capacity) * 4)?;
        Ok(plan)
    }

    /// Which of the two pairs of buffers has the result: 0, the one that the input is in, or 1.
    #[must_use]
    pub fn result(&self) -> usize {
        self.passes as usize % 2
    }

    /// Constants of the WGSL: none tells how many pairs there are, so that sorts of any capacity have the same kernels.
    pub(crate) fn constants(&self) -> String {
        let mut text = constants(&[
            ("THREADS", self.threads),
            ("ITEMS", self.items),
            ("PASSES", self.passes),
            ("DIGIT_BITS", self.digit_bits),
            ("BINS", 1_u32 << self.digit_bits),
            ("KEY_MASK", u32::MAX >> (32 - self.key_bits)),
            ("HISTOGRAMS", HISTOGRAMS),
            ("MAX_PAIRS", MAX_PAIRS),
        ]);
        if let Subgroups::Present { min, .. } = self.subgroups {
            text += &constants(&[("MIN_SUBGROUP", min)]);
        }
        text
    }
}

/// Bytes of workgroup memory that the kernels declare, all in 4-byte words.
fn workgroup_bytes(subgroups: Subgroups, threads: u32, items: u32, bins: u32, passes: u32) -> u32 {
    // exchange, then local_start, global_start and recount, then single words.
    let common = threads * items + 3 * bins + 4;
    // ranks and prefix.
    let ranks = match subgroups {
        Subgroups::Present { min, .. } => (threads / min).max(1) * (bins + 1),
        Subgroups::Absent => bins * threads / 32 + bins + threads,
    };
    (common + ranks).max(passes * bins) * 4
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(binding_bytes: u64, workgroup_bytes: u32) -> Limits {
        Limits { buffer_bytes: 1 << 30, binding_bytes, workgroup_bytes, ..Limits::LEAST }
    }

    #[test]
    fn sizes_hold_up_to_fifty_million_pairs() {
        for subgroups in [8, 16, 32, 64].map(|min| Subgroups::Present { min, max: min }) {
            for (subgroups, memory) in [(subgroups, 32 << 10), (Subgroups::Absent, 16 << 10)] {
                for capacity in [0, 1, 1000, 3_000_000, 30_000_000, 50_000_000] {
                    for key_bits in [1, 8, 9, 13, 24, 32] {
                        let limits = limits(256 << 20, memory);
                        let plan = SortPlan::new(&limits, subgroups, capacity, key_bits).unwrap();
                        assert!(plan.passes * plan.digit_bits >= key_bits, "{plan:?}");
                        assert!((plan.passes - 1) * 8 < key_bits && plan.digit_bits <= 8, "{plan:?}");
                        let pairs = u64::from(plan.tiles) * u64::from(plan.threads * plan.items);
                        assert!(pairs >= capacity.into() && plan.tiles <= crate::GRID_ROW.pow(2), "{plan:?}");
                        assert!(plan.histograms * HISTOGRAMS >= plan.tiles, "{plan:?}");
                        assert!(plan.status_bytes <= limits.binding_bytes, "{plan:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn short_keys_need_fewer_and_smaller_digits() {
        let sizes = |bits| {
            let plan = SortPlan::new(&limits(1 << 30, 32 << 10), Subgroups::Absent, 1, bits).unwrap();
            (plan.passes, plan.digit_bits, plan.result())
        };
        assert_eq!([8, 12, 20, 32].map(sizes), [(1, 8, 1), (2, 6, 0), (3, 7, 1), (4, 8, 0)]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let plan = |limits, capacity, bits| SortPlan::new(&limits, Subgroups::Absent, capacity, bits);
        assert!(matches!(plan(limits(1 << 30, 32 << 10), MAX_PAIRS + 1, 8), Err(GpuError::TooLarge { .. })));
        assert!(matches!(plan(limits(1 << 30, 32 << 10), 1, 33), Err(GpuError::TooLarge { .. })));
        assert!(matches!(plan(limits(1 << 30, 1 << 10), 1, 8), Err(GpuError::TooLarge { .. })));
        assert!(matches!(plan(limits(128 << 20, 32 << 10), 50_000_000, 32), Err(GpuError::TooLarge { .. })));
    }
}
