//! Front-to-back order of a tile's splats: a stable radix sort of depths, so equal depths keep scene order.

/// Below this many splats a comparison sort is faster than clearing and scanning three histograms.
const SMALL: usize = 192;

/// Digits of the radix sort.
const PASSES: u32 = 3;

/// Sorts depths; keeps its memory.
#[derive(Default)]
pub struct DepthOrder {
    /// (depth bits, index) as one number each.
    keys: Vec<u64>,
    swap: Vec<u64>,
    sorted: Vec<u32>,
}

impl DepthOrder {
    /// Indices of the last sorted depths, nearest first.
    pub fn sorted(&self) -> &[u32] {
        &self.sorted
    }

    /// Sorts positions 0, 1, … by the depth bits given for them.
    pub fn sort_front_to_back(&mut self, depth_bits: impl Iterator<Item = u32>) {
        self.keys.clear();
        let (mut all_or, mut all_and) = (0, u32::MAX);
        self.keys.extend(depth_bits.zip(0_u64..).map(|(depth, i)| {
            all_or |= depth;
            all_and &= depth;
            u64::from(depth) << 32 | i
        }));
        if self.keys.len() < SMALL {
            self.keys.sort_unstable();
        } else {
            // Only bits up to the highest bit that differs need sorting.
            let varying = 32 - (all_or ^ all_and).leading_zeros();
            self.radix_sort(varying.div_ceil(PASSES).max(1));
        }
        self.sorted.clear();
        self.sorted.extend(self.keys.iter().map(|&key| key as u32));
    }

    /// Least significant digit first, `PASSES` digits of `bits` bits above the index.
    fn radix_sort(&mut self, bits: u32) {
        let buckets = 1_usize << bits;
        let digit = |key: u64, pass: u32| (key >> (32 + pass * bits)) as usize & (buckets - 1);
        let mut histograms = [[0_u32; 1 << 11]; PASSES as usize];
        for &key in &self.keys {
            for pass in 0..PASSES {
                histograms[pass as usize][digit(key, pass)] += 1;
            }
        }
        self.swap.resize(self.keys.len(), 0);
        for pass in 0..PASSES {
            let histogram = &mut histograms[pass as usize][..buckets];
            let mut start = 0;
            for count in histogram.iter_mut() {
                start += std::mem::replace(count, start);
            }
            for &key in &self.keys {
                let place = &mut histogram[digit(key, pass)];
                self.swap[*place as usize] = key;
                *place += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.swap);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sorted(depths: &[u32]) -> Vec<u32> {
        let mut order = DepthOrder::default();
        order.sort_front_to_back(depths.iter().copied());
        order.sorted().to_vec()
    }

    #[test]
    fn order_is_that_of_a_stable_comparison_sort_for_short_and_long_lists() {
        let mut random = 12345_u32;
        for count in [0, 1, 2, SMALL - 1, SMALL, 1000, 5000] {
            for mask in [u32::MAX, 0x7fff_ffff, 0x3f, 0] {
                let depths: Vec<u32> = std::iter::repeat_with(|| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    random.rotate_right(3) & mask
                })
                .take(count)
                .collect();
                let mut expected: Vec<u32> = (0..count as u32).collect();
                expected.sort_by_key(|&i| depths[i as usize]);
                assert_eq!(sorted(&depths), expected, "{count} depths of mask {mask:x}");
            }
        }
    }
}
