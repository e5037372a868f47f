//! What samples are made from: LR frames and exact blocks.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*, u8x64};
use gs3_scene::{BLOCK_SIDE, ExactBlock, GBuffer, Gradients, Margin, Planes, Size};
use rayon::prelude::*;

use super::chunk::{Chunk, DX, DY, Extent};
use super::{BLOCKS_PER_ROW, CROSSING, CROSSING_OF_BLOCKS, EDGE_RATIO, HALF_WAY, Layout, SampleFrame};
use crate::cpu::lanes::{CHUNK, load};
use crate::error::ReconstructError;
use crate::reprojection::inverse_depth_16;

impl SampleFrame {
    /// Copies a checked G-buffer of an output `scale` times larger. Memory is reused.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if `gbuffer` has no gradients.
    pub fn fill(&mut self, level: Level, gbuffer: &GBuffer, scale: u32) -> Result<(), ReconstructError> {
        let Some(gradients) = &gbuffer.gradients else {
            return Err(ReconstructError::Missing { what: "image gradients" });
        };
        self.layout = Layout::Rows;
        (self.width, self.height) = (gbuffer.width(), gbuffer.height());
        (self.jitter, self.margin) = (gbuffer.jitter, gbuffer.margin);
        let per_row = self.chunks_per_row();
        self.chunks.resize(per_row * self.height, Chunk::EMPTY);
        self.extents.resize(per_row * self.height, Extent::default());
        self.displacements.clear();
        let depth = gbuffer.geometry.as_ref().map(|geometry| &geometry.depth_median);
        let planes =
            SamplePlanes { color: &gbuffer.color, gradients, depth, per_hr_pixel: 1.0 / scale as f32 };
        let rows = self.chunks.par_chunks_exact_mut(per_row).zip(self.extents.par_chunks_exact_mut(per_row));
        rows.enumerate().with_min_len(8).for_each_init(Vec::new, |nearest, (y, (chunks, extents))| {
            dispatch!(level, simd => {
                planes.find_nearest(simd, y, nearest);
                for (k, (chunk, extent)) in chunks.iter_mut().zip(extents).enumerate() {
                    *extent = planes.fill(simd, [k * CHUNK, y], nearest, chunk);
                }
            });
        });
        Ok(())
    }

    /// Copies exact blocks of a picture of size `picture`, each with its column and row. `lr` is the LR frame (no blocks) of
    /// the same camera, `scale` times coarser. Memory is reused.
    pub fn fill_blocks(
        &mut self,
        level: Level,
        blocks: &[([u16; 2], &ExactBlock)],
        picture: Size,
        lr: &Self,
        scale: u32,
    ) {
        debug_assert!(!lr.is_blocks(), "expected an LR frame");
        let corners: Vec<_> =
            blocks.iter().map(|(place, _)| place.map(|k| (usize::from(k) * BLOCK_SIDE) as f32)).collect();
        let counts = corners.chunks(BLOCKS_PER_ROW).map(<[_]>::len).collect();
        self.layout = Layout::Blocks { corners, counts, picture: picture.to_array().map(|side| side as f32) };
        (self.width, self.height) = (0, blocks.len().div_ceil(BLOCKS_PER_ROW));
        (self.jitter, self.margin) = ([0.0; 2], Margin::NONE);
        self.displacements.clear();
        // What chunks held before is overwritten. New ones are written by all threads: one alone takes long to touch the new
        // pages of a frame that is exact as a whole.
        self.chunks.truncate(blocks.len());
        let new = blocks.len() - self.chunks.len();
        self.chunks.par_extend(rayon::iter::repeat_n(Chunk::EMPTY, new));
        self.extents.resize(blocks.len(), Extent::default());
        let chunks = self.chunks.par_iter_mut().zip(&mut self.extents);
        chunks.zip(blocks).with_min_len(64).for_each(|((chunk, extent), (place, block))| {
            let around = lr.nearest_around(*place, scale);
            *extent = dispatch!(level, simd => fill_block(simd, block, around, chunk));
        });
    }

    /// The largest inverse depth of nine samples of this LR frame: the sample nearest to the middle of the block at `place`,
    /// and the samples around that one. From scale 4 on they surround the block.
    fn nearest_around(&self, place: [u16; 2], scale: u32) -> f32 {
        let offset = self.offset();
        let last = [self.width, self.height].map(|count| count - 1);
        let [columns, rows] = [0, 1].map(|a| {
            let middle = (usize::from(place[a]) * BLOCK_SIDE + BLOCK_SIDE / 2) as f32;
            // Before the first sample, the first one is taken (the conversion turns negative numbers into 0), and beyond the
            // last sample the last one.
            let nearest = ((middle / scale as f32 - offset[a] + HALF_WAY) as usize).min(last[a]);
            nearest.saturating_sub(1)..=(nearest + 1).min(last[a])
        });
        let depths = rows.flat_map(|y| columns.clone().map(move |x| self.inverse_depth(x, y)));
        depths.fold(0.0, f32::max)
    }
}

/// Fills the chunk of an exact block. `around` is the largest inverse depth of the LR samples around the block: a surface that
/// begins beside the block has an edge that may reach into the block.
#[inline(always)]
fn fill_block<S: Simd>(simd: S, block: &ExactBlock, around: f32, chunk: &mut Chunk) -> Extent {
    let here = inverse_depth_16(simd, f32x16::load_array_ref(simd, &block.depth_median));
    let near = nearest_in_block(simd, here).max(around);
    let planes = |c: usize| {
        [
            f32x16::load_array_ref(simd, &block.color[c]),
            f32x16::load_array_ref(simd, &block.color_dx[c]),
            f32x16::load_array_ref(simd, &block.color_dy[c]),
        ]
    };
    fill_chunk(simd, planes, here, near, CROSSING_OF_BLOCKS, mask32x16::splat(simd, true), chunk)
}

/// For each pixel of a block, the largest of the values of the pixel and the pixels around it, within the block.
#[inline(always)]
pub(super) fn nearest_in_block<S: Simd>(simd: S, values: f32x16<S>) -> f32x16<S> {
    let before = values.swizzle_dyn_within_blocks(u8x64::load_array_ref(simd, &BEFORE));
    let after = values.swizzle_dyn_within_blocks(u8x64::load_array_ref(simd, &AFTER));
    let beside = before.max(after);
    let (top, bottom) = values.max(beside).split();
    let ((a, b), (c, d)) = (top.split(), bottom.split());
    let (top, middle, bottom) = (a.max(b), b.max(c), c.max(d));
    top.combine(top.max(c)).combine(middle.max(d).combine(bottom))
}

/// For each lane of four, the bytes of the lane before it, and of the lane after it; of the lane itself at the ends.
const BEFORE: [u8; 64] = lane_bytes([0, 0, 1, 2]);
const AFTER: [u8; 64] = lane_bytes([1, 2, 3, 3]);

/// The bytes of `lanes`, for each four lanes of a vector.
const fn lane_bytes(lanes: [u8; 4]) -> [u8; 64] {
    let mut bytes = [0; 64];
    let mut k = 0;
    while k < bytes.len() {
        bytes[k] = lanes[k / 4 % 4] * 4 + k as u8 % 4;
        k += 1;
    }
    bytes
}

/// Fills a chunk. `planes` gives colour and derivatives per HR pixel of a channel; `here` has inverse depths, `near` the largest of
/// the samples around each. `crossing` is [`CROSSING`] or [`CROSSING_OF_BLOCKS`]. A lane outside `is_sample` has no sample.
#[inline(always)]
fn fill_chunk<S: Simd>(
    simd: S,
    planes: impl Fn(usize) -> [f32x16<S>; 3],
    here: f32x16<S>,
    near: f32x16<S>,
    crossing: f32,
    is_sample: mask32x16<S>,
    chunk: &mut Chunk,
) -> Extent {
    let zero = f32x16::splat(simd, 0.0);
    let (mut squares, mut is_bare) = (zero, mask32x16::splat(simd, true));
    for c in 0..3 {
        let [color, dx, dy] = planes(c);
        squares = dx.mul_add(dx, dy.mul_add(dy, squares));
        is_bare &= color.simd_eq(color[0]) & dx.simd_eq(0.0) & dy.simd_eq(0.0);
        chunk.set_plane(2 + c, color);
        chunk.set_samples(c, color);
        chunk.set_samples(DX + c, dx);
        chunk.set_samples(DY + c, dy);
    }
    chunk.set_plane(0, here);
    let change = (near - here) * crossing * squares.sqrt();
    chunk.set_plane(1, here.simd_lt(near * EDGE_RATIO).select(change, zero));
    let far = is_sample.select(here, f32x16::splat(simd, f32::INFINITY)).reduce_min();
    let near = here.reduce_max();
    let [r, g, b] = chunk.colors().map(|plane| plane[0]);
    let is_bare = near == 0.0 && (is_bare | !is_sample).all_true();
    Extent { far, near, bare: is_bare.then_some([r, g, b]) }
}

/// The planes that samples are made from.
struct SamplePlanes<'a> {
    color: &'a Planes<3>,
    gradients: &'a Gradients,
    depth: Option<&'a Planes<1>>,
    /// LR pixels per HR pixel.
    per_hr_pixel: f32,
}

impl SamplePlanes<'_> {
    /// Per column of row `y`, the largest inverse depth of the samples in this row, the row above and the row below,
    /// from entry 1 on. Entries beyond the first and the last column are 0.
    #[inline(always)]
    fn find_nearest<S: Simd>(&self, simd: S, y: usize, nearest: &mut Vec<f32>) {
        let (width, height) = (self.color.width(), self.color.height());
        nearest.clear();
        nearest.resize(width.next_multiple_of(CHUNK) + 2, 0.0);
        let Some(depth) = self.depth else { return };
        let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
        for first in (0..width).step_by(CHUNK) {
            let mut near = f32x16::splat(simd, 0.0);
            for y in [above, y, below] {
                near = near.max(inverse_depth_16(simd, load(simd, &depth.row(0, y)[first..])));
            }
            near.store_slice(&mut nearest[1 + first..][..CHUNK]);
        }
    }

    /// Fills the chunk with its first sample in column `first` of row `y`.
    #[inline(always)]
    fn fill<S: Simd>(&self, simd: S, [first, y]: [usize; 2], nearest: &[f32], chunk: &mut Chunk) -> Extent {
        let count = CHUNK.min(self.color.width() - first);
        let is_sample = f32x16::from_fn(simd, |i| i as f32).simd_lt(count as f32);
        let Gradients { color_dx, color_dy, .. } = self.gradients;
        let planes = |c: usize| {
            [
                load(simd, &self.color.row(c, y)[first..]),
                load(simd, &color_dx.row(c, y)[first..]) * self.per_hr_pixel,
                load(simd, &color_dy.row(c, y)[first..]) * self.per_hr_pixel,
            ]
        };
        let here = match self.depth {
            Some(depth) => inverse_depth_16(simd, load(simd, &depth.row(0, y)[first..])),
            None => f32x16::splat(simd, 0.0),
        };
        let column = |k: usize| f32x16::from_slice(simd, &nearest[first + k..][..CHUNK]);
        let near = column(0).max(column(1)).max(column(2));
        fill_chunk(simd, planes, here, near, CROSSING, is_sample, chunk)
    }
}
