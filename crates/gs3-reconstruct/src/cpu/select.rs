//! The choice of blocks that are worth rasterizing exactly, and writing these blocks into a frame.

use gs3_scene::{BLOCK_SIDE, ExactBlocks, Image, Size, block_grid};
use rayon::prelude::*;

/// How many blocks may be exact, and which blocks need not be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockBudget {
    /// Largest share of an image's blocks, `[0, 1]`.
    pub most: f32,
    /// Blocks with an expected mean squared error per number (colours in `[0, 1]`) of at most this are left out; none
    /// if it is negative.
    pub least_error: f32,
}

impl BlockBudget {
    /// Every block.
    pub const ALL: Self = Self { most: 1.0, least_error: -1.0 };

    /// The most blocks of `blocks` that may be exact.
    #[must_use]
    pub fn blocks_of(self, blocks: usize) -> usize {
        (f64::from(self.most.clamp(0.0, 1.0)) * blocks as f64).round() as usize
    }
}

/// The blocks of 4×4 pixels with the largest expected errors, within `budget`, of an image of `size`. Blocks are given as
/// columns and rows. `errors` are [`crate::SuperSampler::expected_errors`] or [`crate::Interpolator::expected_errors`]. Among
/// equal errors, the first in row order wins. The order of the result is unspecified.
#[must_use]
pub fn select_blocks(errors: &[f32], size: Size, budget: BlockBudget) -> Vec<[u16; 2]> {
    let [columns, rows] = block_grid(size);
    let numbers = (3 * BLOCK_SIDE * BLOCK_SIDE) as f32;
    let least = budget.least_error * numbers;
    // Positive numbers sort like their bits. The complement of the place makes the first of equal errors the largest
    // key.
    let key = |(k, error): (usize, &f32)| u64::from(error.to_bits()) << 32 | u64::from(!(k as u32));
    let errors = errors.iter().take(columns * rows).enumerate();
    let mut keys: Vec<u64> =
        errors.filter(|(_, error)| **error > least && error.is_finite()).map(key).collect();
    let most = budget.blocks_of(columns * rows);
    if most == 0 {
        return Vec::new();
    }
    if keys.len() > most {
        keys.select_nth_unstable_by(most - 1, |a, b| b.cmp(a));
        keys.truncate(most);
    }
    let place = |key: u64| {
        let k = !(key as u32) as usize;
        [(k % columns) as u16, (k / columns) as u16]
    };
    keys.into_iter().map(place).collect()
}

/// Writes the pixels of `blocks` into `image`, with an uncertainty of 0.
pub fn write_blocks(blocks: &ExactBlocks, image: &mut Image) {
    let width = image.width();
    let [columns, rows] = block_grid(image.size());
    // The number plus one of the block to be written at each place.
    let mut number = vec![0_u32; columns * rows];
    for (k, [column, row]) in (1..).zip(&blocks.places) {
        if let Some(number) = number.get_mut(usize::from(*row) * columns + usize::from(*column)) {
            *number = k;
        }
    }
    let bands = image.pixels_mut().par_chunks_mut(BLOCK_SIDE * width).zip(number.par_chunks(columns));
    bands.with_min_len(4).for_each(|(rows, numbers)| {
        for (column, number) in numbers.iter().enumerate().filter(|(_, number)| **number > 0) {
            let block = &blocks.blocks[*number as usize - 1];
            for (y, row) in rows.chunks_mut(width).enumerate() {
                let pixels = row[column * BLOCK_SIDE..].iter_mut().take(BLOCK_SIDE).enumerate();
                for (x, pixel) in pixels {
                    let [r, g, b] = block.color.map(|plane| plane[y * BLOCK_SIDE + x]);
                    *pixel = [r, g, b, 0.0];
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40×22 pixels: 10×6 blocks, the last row half outside.
    const SIZE: Size = Size::new(40, 22);

    fn selected(errors: &[f32], most: f32, least_error: f32) -> Vec<[u16; 2]> {
        let mut places = select_blocks(errors, SIZE, BlockBudget { most, least_error });
        places.sort_unstable_by_key(|[x, y]| (*y, *x));
        places
    }

    #[test]
    fn the_largest_errors_come_first_and_ties_in_row_order() {
        let mut errors = vec![0.0; 60];
        (errors[7], errors[31], errors[59]) = (2.0, 5.0, 3.0);
        assert_eq!(selected(&errors, 2.0 / 60.0, 0.0), [[1, 3], [9, 5]]);
        assert_eq!(
            selected(&errors, 1.0, 0.0),
            [[7, 0], [1, 3], [9, 5]],
            "blocks without errors are left out"
        );
        let all = select_blocks(&errors, SIZE, BlockBudget::ALL);
        assert_eq!(all.len(), 60, "whatever their errors");
        let equal = vec![1.0; 60];
        assert_eq!(selected(&equal, 0.05, 0.0), [[0, 0], [1, 0], [2, 0]]);
        assert_eq!(selected(&equal, 1.0, 0.0).len(), 60);
        assert!(selected(&equal, 0.0, 0.0).is_empty());
    }

    #[test]
    fn a_least_error_is_a_mean_over_the_numbers_of_a_block() {
        let mut errors = vec![48.0 * 0.01; 60];
        errors[12] = 48.0 * 0.02;
        assert_eq!(selected(&errors, 1.0, 0.015), [[2, 1]]);
        assert!(selected(&errors, 1.0, 0.02).is_empty());
    }

    #[test]
    fn what_is_no_number_is_left_out() {
        let mut errors = vec![0.0; 60];
        (errors[1], errors[2], errors[3]) = (f32::NAN, f32::INFINITY, 1.0);
        assert_eq!(selected(&errors, 1.0, 0.0), [[3, 0]]);
        assert!(select_blocks(&[], SIZE, BlockBudget { most: 1.0, least_error: 0.0 }).is_empty());
    }
}
