//! Gaussians along a space-filling curve, which makes neighbours in a file neighbours in space.

use rayon::prelude::*;

/// Indices of `count` points in the order of a Morton curve of 16 bits an axis; `codes` gives a point's place between
/// the bounds of all, as shares of 65,535.
pub(super) fn order(count: usize, codes: impl Fn(usize) -> [u16; 3] + Sync) -> Vec<u32> {
    let mut keys: Vec<(u64, u32)> = (0..count as u32)
        .into_par_iter()
        .map(|i| {
            let [x, y, z] = codes(i as usize).map(spread);
            (x | y << 1 | z << 2, i)
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|(_, i)| i).collect()
}

/// The 16 bits with two zeros after each.
fn spread(code: u16) -> u64 {
    let mut bits = u64::from(code);
    bits = (bits | bits << 16) & 0x0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x0c30_c30c_30c3;
    (bits | bits << 2) & 0x2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_bits_are_spread_one_by_one() {
        for code in [0, 1, 0x8000, 0xffff, 0xa5c3, 0x1234] {
            let expected = (0..16).fold(0, |bits, k| bits | u64::from(code >> k & 1u16) << (3 * k));
            assert_eq!(spread(code), expected, "code {code:04x}");
        }
        // The far corner of a cube comes last, in any order of the points.
        assert_eq!(order(3, |i| [[9, 9, 9], [0, 0, 0], [9, 0, 0]][i]), [1, 2, 0]);
    }
}
