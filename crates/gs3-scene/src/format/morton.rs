//! Gaussians along a space-filling curve, which makes neighbours in a file neighbours in space.

use rayon::prelude::*;

/// Indices of `count` points in the order of a Morton curve of 16 bits an axis; `codes` gives a point's place between
/// the bounds of all, as shares of 65,535. A point's place and index share 64 bits: with more than 65,536 points the curve has
/// fewer bits, 39 in all for 33 million. Points with equal bits are in the order of their indices.
pub(super) fn order(count: usize, codes: impl Fn(usize) -> [u16; 3] + Sync) -> Vec<u32> {
    let index_bits = count.next_power_of_two().trailing_zeros();
    let dropped = (48 + index_bits).saturating_sub(u64::BITS);
    let mut keys: Vec<u64> = (0..count)
        .into_par_iter()
        .map(|i| {
            let [x, y, z] = codes(i).map(spread);
            (x | y << 1 | z << 2) >> dropped << index_bits | i as u64
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_par_iter().map(|key| (key & ((1 << index_bits) - 1)) as u32).collect()
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
        assert!(order(0, |_| [0; 3]).is_empty());
        assert_eq!(order(1, |_| [u16::MAX; 3]), [0]);
    }

    /// 17 bits for the index leave 47 for the curve: all but the lowest one.
    #[test]
    fn many_points_share_the_bits_with_their_indices() {
        let count = 1 << 17;
        let order = order(count, |i| [(i >> 1) as u16, 0, u16::MAX - (i >> 1) as u16]);
        let mut seen = vec![false; count];
        order.iter().for_each(|i| seen[*i as usize] = true);
        assert!(seen.into_iter().all(|seen| seen));
        // z counts most: from its least on, that is from the last pair of points on.
        assert_eq!(order[..2], [(count - 2) as u32, (count - 1) as u32]);
        assert_eq!(order[count - 2..], [0, 1]);
    }
}
