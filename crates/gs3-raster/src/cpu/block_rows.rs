//! Which native tiles have blocks in a rectangle.

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::cover::{BLOCK, BLOCKS_X, BLOCKS_Y};
use super::splat::PixelRect;
use crate::settings::MAX_BLOCK_SCALE;

/// Largest stride: a tile's columns of blocks, and its native tiles, are the bits of a mask.
pub const MAX_STRIDE: usize = MAX_BLOCK_SCALE as usize;

/// Most rows of blocks in a tile.
pub const MAX_ROWS: usize = TILE_HEIGHT * MAX_STRIDE / BLOCK;

// A byte of a row of blocks is a native tile, a number has the columns of the widest tile, and a mask has all native tiles.
const _: () =
    assert!(BLOCKS_X == 8 && MAX_STRIDE == 8 && TILE_WIDTH * MAX_STRIDE / BLOCK == u64::BITS as usize);

/// The blocks of a tile as bits. A rectangle's native tiles take one look-up for each row of native tiles.
pub struct BlockRows {
    /// For each row of native tiles, entry `BLOCKS_Y · from + to` has the blocks of its rows `from..=to`.
    together: [[u64; BLOCKS_Y * BLOCKS_Y]; MAX_STRIDE],
}

impl BlockRows {
    pub fn new(rows: &[u64; MAX_ROWS]) -> Self {
        let mut together = [[0; BLOCKS_Y * BLOCKS_Y]; MAX_STRIDE];
        for (rows, together) in rows.as_chunks::<BLOCKS_Y>().0.iter().zip(&mut together) {
            for from in 0..BLOCKS_Y {
                let mut blocks = 0;
                for to in from..BLOCKS_Y {
                    blocks |= rows[to];
                    together[BLOCKS_Y * from + to] = blocks;
                }
            }
        }
        Self { together }
    }

    /// The native tiles with a block that `rect` meets, bit `MAX_STRIDE · row + column` for each. `rect` meets the tile of
    /// `size` at `corner`; what lies outside the tile is left out.
    #[inline(always)]
    pub fn native_tiles_met(&self, rect: PixelRect, corner: [usize; 2], size: [usize; 2]) -> u64 {
        let first = |from: u16, a: usize| usize::from(from).saturating_sub(corner[a]) / BLOCK;
        let last =
            |to: u16, a: usize| (usize::from(to) - 1).saturating_sub(corner[a]).min(size[a] - 1) / BLOCK;
        let (left, right) = (first(rect.x0, 0), last(rect.x1, 0));
        let (top, bottom) = (first(rect.y0, 1), last(rect.y1, 1));
        let columns = (u64::MAX >> (63 - right)) & (u64::MAX << left);
        let mut tiles = 0;
        for row in top / BLOCKS_Y..=bottom / BLOCKS_Y {
            let from = top.saturating_sub(BLOCKS_Y * row);
            let to = (bottom - BLOCKS_Y * row).min(BLOCKS_Y - 1);
            let met = self.together[row][BLOCKS_Y * from + to] & columns;
            tiles |= u64::from(bytes_set(met)) << (MAX_STRIDE * row);
        }
        tiles
    }
}

/// Which bytes are not zero: of a row of blocks, the native tiles with a block.
const fn bytes_set(row: u64) -> u8 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let highest = (((row & LOW) + LOW) | row) & !LOW;
    // Adds byte i, which is 0 or 1, to bit i of the highest byte: 2^(8i) · 2^(56 − 7i).
    ((highest >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_meet_the_native_tiles_of_their_blocks() {
        let mut random = 1_u64;
        let mut next = |below: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % below
        };
        for stride in 1..=MAX_STRIDE {
            let size = [TILE_WIDTH * stride, TILE_HEIGHT * stride];
            let mut rows = [0; MAX_ROWS];
            for _ in 0..20 {
                let [x, y] = size.map(|side| next((side / BLOCK) as u64));
                rows[y as usize] |= 1 << x;
            }
            let blocks = BlockRows::new(&rows);
            for _ in 0..200 {
                // From before the tile, which begins at (50, 40), to beyond its end.
                let [x0, y0] = [next(50 + size[0] as u64), next(40 + size[1] as u64)];
                let [x1, y1] = [x0.max(50) + 1 + next(90), y0.max(40) + 1 + next(70)];
                let rect = PixelRect { x0: x0 as u16, y0: y0 as u16, x1: x1 as u16, y1: y1 as u16 };
                let mut expected = 0;
                for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
                    let is_in = (x0..x1).contains(&(x as u64 + 50)) && (y0..y1).contains(&(y as u64 + 40));
                    if is_in && rows[y / BLOCK] >> (x / BLOCK) & 1 == 1 {
                        expected |= 1 << (y / TILE_HEIGHT * MAX_STRIDE + x / TILE_WIDTH);
                    }
                }
                let met = blocks.native_tiles_met(rect, [50, 40], size);
                assert_eq!(met, expected, "stride {stride}, {rect:?}, {rows:?}");
            }
        }
    }
}
