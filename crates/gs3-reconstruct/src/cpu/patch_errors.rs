//! The errors to expect of an in-between frame: found patch by patch, told block by block.

use gs3_scene::{BLOCK_SIDE, Size, block_grid};
use rayon::prelude::*;

use crate::cpu::blend::SHARED;
use crate::cpu::warp::{BAND, Patches, SIDE, offset};

const _: () = assert!(BLOCK_SIDE == SIDE);

/// The squared errors to expect of the patches of an image.
#[derive(Debug, Default)]
pub(crate) struct PatchErrors {
    size: Size,
    scale: usize,
    /// One per patch, `[rows, columns]` of patches.
    errors: Vec<f32>,
}

impl PatchErrors {
    /// Makes room for an image of `size`; parts for the bands of [`crate::cpu::warp::bands`].
    pub fn bands(&mut self, scale: usize, size: Size) -> impl IndexedParallelIterator<Item = &mut [f32]> {
        let [width, height] = size.to_usize();
        let columns = Patches::new(scale, width, 0).columns;
        let before = (SIDE - offset(scale)) % SIDE;
        (self.size, self.scale) = (size, scale);
        self.errors.resize(columns * (height + before).div_ceil(SIDE), 0.0);
        // The first band has the rows before the first whole patch.
        let (first, others) = self.errors.split_at_mut(if before > 0 { columns } else { 0 });
        rayon::iter::once(first).chain(others.par_chunks_mut(columns * (BAND / SIDE)))
    }

    /// The errors of the blocks into `out`. A block overlaps one, two or four patches, and has of each patch's error the share
    /// of the patch that the block overlaps.
    pub fn of_blocks(&self, out: &mut Vec<f32>) {
        let Self { size, scale, errors } = self;
        let [columns, rows] = block_grid(*size);
        let of_patches = Patches::new(*scale, size.to_usize()[0], 0).columns;
        // Along an axis: which patches block 0 overlaps, and how much of them.
        let part = offset(*scale) as f32 / SIDE as f32;
        let overlaps = [(0, part), (1, 1.0 - part)];
        let overlaps = if part == 0.0 { &[(0, 1.0)][..] } else { &overlaps };
        let both = overlaps.iter().flat_map(|y| overlaps.iter().map(move |x| (x.0, y.0, x.1 * y.1)));
        let overlaps: Vec<(usize, usize, f32)> = both.collect();
        out.resize(columns * rows, 0.0);
        out.par_chunks_mut(columns.max(1)).enumerate().for_each(|(y, row)| {
            for (x, error) in row.iter_mut().enumerate() {
                let of_patch = |(dx, dy, part): &(usize, usize, f32)| {
                    // The last columns and rows may have no patch of their own.
                    let column = (x + dx).min(of_patches - 1);
                    part * errors.get((y + dy) * of_patches + column).unwrap_or(&0.0)
                };
                *error = SHARED * overlaps.iter().map(of_patch).sum::<f32>();
            }
        });
    }
}
