//! Whether a rectangle meets a block, by four look-ups.

use super::cover::BLOCK;
use super::splat::PixelRect;

/// Numbers of blocks of an image, summed over all columns to the left and all rows above.
pub struct BlockTable {
    /// `[rows + 1, columns + 1]`: the first row and column are 0.
    sums: Vec<u32>,
    /// Columns and rows of blocks.
    size: [usize; 2],
}

impl BlockTable {
    /// The blocks at `places`, columns and rows, of an image of `size` pixels.
    pub fn new(places: &[[u16; 2]], size: [usize; 2]) -> Self {
        let [columns, rows] = size.map(|side| side.div_ceil(BLOCK));
        let width = columns + 1;
        let mut sums = vec![0; width * (rows + 1)];
        for [x, y] in places {
            sums[(usize::from(*y) + 1) * width + usize::from(*x) + 1] = 1;
        }
        for y in 1..=rows {
            let mut of_row = 0;
            for x in 1..=columns {
                of_row += sums[y * width + x];
                sums[y * width + x] = of_row + sums[(y - 1) * width + x];
            }
        }
        Self { sums, size: [columns, rows] }
    }

    /// Whether `rect` meets a block. What lies beyond the image is left out.
    #[inline(always)]
    pub fn meets(&self, rect: PixelRect) -> bool {
        let [columns, rows] = self.size;
        let first = |from: u16, count: usize| (usize::from(from) / BLOCK).min(count);
        let end = |to: u16, count: usize| usize::from(to).div_ceil(BLOCK).min(count);
        let (left, right) = (first(rect.x0, columns), end(rect.x1, columns));
        let (top, bottom) = (first(rect.y0, rows) * (columns + 1), end(rect.y1, rows) * (columns + 1));
        let sums = &self.sums[..];
        sums[bottom + right] + sums[top + left] != sums[bottom + left] + sums[top + right]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_meet_the_blocks_that_they_overlap() {
        let size = [38, 21];
        let places = [[0, 0], [3, 2], [9, 5], [6, 4]];
        let table = BlockTable::new(&places, size);
        let is_block = |x: u16, y: u16| places.contains(&[x / BLOCK as u16, y / BLOCK as u16]);
        let mut met = 0;
        for (y0, x0) in (0..21).flat_map(|y| (0..38).map(move |x| (y, x))) {
            for (height, width) in [(1, 1), (3, 5), (9, 2), (30, 50)] {
                let rect = PixelRect { x0, y0, x1: x0 + width, y1: y0 + height };
                let inside = |x: &u16| usize::from(*x) < size[0];
                let expected = (rect.y0..rect.y1.min(21))
                    .any(|y| (rect.x0..rect.x1).filter(inside).any(|x| is_block(x, y)));
                assert_eq!(table.meets(rect), expected, "{rect:?}");
                met += u32::from(expected);
            }
        }
        assert!((100..3000).contains(&met), "{met}");
    }
}
