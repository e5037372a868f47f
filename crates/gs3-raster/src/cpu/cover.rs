//! Which splats of a run touch which 4×4 blocks of a tile: the exact extent per row of blocks, sixteen splats at a
//! time.

use fearless_simd::{Simd, f32x16, prelude::*, u32x16};

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::splat::Splat;

/// Side of a block in pixels: its sixteen pixels are the lanes of a vector.
pub const BLOCK: usize = 4;
pub const BLOCKS_X: usize = TILE_WIDTH / BLOCK;
pub const BLOCKS_Y: usize = TILE_HEIGHT / BLOCK;
pub const BLOCKS: usize = BLOCKS_X * BLOCKS_Y;

/// Splats handled at a time. The lists stay in the second-level cache, and a block's state is loaded and stored once
/// for the dozens of splats of a run that touch it.
pub const RUN: usize = 256;

/// What the extents depend on, one array per value.
#[derive(Clone)]
struct Extents {
    mean_x: [f32; RUN],
    mean_y: [f32; RUN],
    l21: [f32; RUN],
    l22: [f32; RUN],
    inv_l11: [f32; RUN],
    support: [f32; RUN],
    dy_at_max_dx: [f32; RUN],
    /// First and last sample of the rectangle.
    rect: [[f32; RUN]; 4],
}

/// For each block, the splats of a run that touch it, in order.
#[derive(Clone)]
pub struct Cover {
    /// The splats.
    run: [u32; RUN],
    extents: Extents,
    /// Sixteen spare places let whole vectors be stored at the end of a list.
    lists: [[u32; RUN + 16]; BLOCKS],
    counts: [usize; BLOCKS],
}

impl Default for Cover {
    fn default() -> Self {
        let zeros = [0.0; RUN];
        Self {
            run: [0; RUN],
            extents: Extents {
                mean_x: zeros,
                mean_y: zeros,
                l21: zeros,
                l22: zeros,
                inv_l11: zeros,
                support: zeros,
                dy_at_max_dx: zeros,
                rect: [zeros; 4],
            },
            lists: [[0; RUN + 16]; BLOCKS],
            counts: [0; BLOCKS],
        }
    }
}

impl Cover {
    /// The splats of the run that touch `block`, front to back.
    #[inline(always)]
    pub fn of_block(&self, block: usize) -> &[u32] {
        &self.lists[block][..self.counts[block]]
    }

    /// Makes the lists of a run, the splats that `visited` names in order, for the blocks in the bit mask `open` of a
    /// tile at `(x0, y0)`.
    ///
    /// Over a row of blocks a support's right edge is highest at `dy_at_max_dx` or at the sample row nearest to it, the
    /// left edge by symmetry at its negative (Speedy-Splat's AccuTile, Hanson et al. 2025; see [`Splat::x_span`]).
    #[inline(always)]
    pub fn fill<S: Simd>(
        &mut self,
        s: S,
        splats: &[Splat],
        visited: &[u32],
        [x0, y0]: [usize; 2],
        open: u32,
    ) {
        let zero = f32x16::splat(s, 0.0);
        self.counts = [0; BLOCKS];
        let (e, count) = (&mut self.extents, visited.len());
        for (i, &index) in visited.iter().enumerate() {
            e.set(i, &splats[index as usize], x0 as f32, y0 as f32);
        }
        let padded = count.next_multiple_of(16);
        self.run[..count].copy_from_slice(visited);
        // An empty rectangle keeps the padding off every list.
        e.rect[0][count..padded].fill(f32::INFINITY);
        e.rect[1][count..padded].fill(f32::INFINITY);
        for start in (0..padded).step_by(16) {
            let mean_x = load(s, &e.mean_x, start);
            let mean_y = load(s, &e.mean_y, start);
            let l21 = load(s, &e.l21, start);
            let l22 = load(s, &e.l22, start);
            let inv_l11 = load(s, &e.inv_l11, start);
            let support = load(s, &e.support, start);
            let dy_right = load(s, &e.dy_at_max_dx, start);
            let dy_left = zero - dy_right;
            let (left, top) = (load(s, &e.rect[0], start), load(s, &e.rect[1], start));
            let (right, bottom) = (load(s, &e.rect[2], start), load(s, &e.rect[3], start));
            let index = u32x16::from_slice(s, &self.run[start..start + 16]);
            for by in 0..BLOCKS_Y {
                let row_open = open >> (by * BLOCKS_X) & ((1 << BLOCKS_X) - 1);
                let first_row = f32x16::splat(s, (by * BLOCK) as f32);
                let last_row = f32x16::splat(s, (by * BLOCK + BLOCK - 1) as f32);
                let in_rows = top.simd_le(last_row) & bottom.simd_ge(first_row);
                if row_open == 0 || !in_rows.any_true() {
                    continue;
                }
                let (low, high) = (mean_y - last_row, mean_y - first_row);
                let dy = dy_right.min(high).max(low);
                let v = l22 * dy;
                let half = (support - v * v).max(zero).sqrt();
                let reach_right = (half - l21 * dy) * inv_l11;
                let dy = dy_left.min(high).max(low);
                let v = l22 * dy;
                let half = (support - v * v).max(zero).sqrt();
                let reach_left = (zero - half - l21 * dy) * inv_l11;
                // The slack covers rounding; a block too many costs time only.
                let slack =
                    (reach_right - reach_left).mul_add(f32x16::splat(s, 1e-5), f32x16::splat(s, 0.01));
                let from = (mean_x - reach_right - slack).max(left);
                let to = (mean_x - reach_left + slack).min(right);
                for bx in 0..BLOCKS_X {
                    if row_open >> bx & 1 == 0 {
                        continue;
                    }
                    let first = f32x16::splat(s, (bx * BLOCK) as f32);
                    let last = f32x16::splat(s, (bx * BLOCK + BLOCK - 1) as f32);
                    let touches = in_rows & from.simd_le(last) & to.simd_ge(first);
                    let block = by * BLOCKS_X + bx;
                    let end = self.counts[block];
                    index.compress(touches).store_slice(&mut self.lists[block][end..end + 16]);
                    self.counts[block] = end + touches.to_bitmask().count_ones() as usize;
                }
            }
        }
    }
}

impl Extents {
    /// Notes splat `i` of the run for a tile at `(x0, y0)`.
    #[inline(always)]
    fn set(&mut self, i: usize, splat: &Splat, x0: f32, y0: f32) {
        self.mean_x[i] = splat.mean[0] - x0;
        self.mean_y[i] = splat.mean[1] - y0;
        self.l21[i] = splat.l21;
        self.l22[i] = splat.l22;
        self.inv_l11[i] = splat.inv_l11;
        self.support[i] = splat.support;
        self.dy_at_max_dx[i] = splat.dy_at_max_dx;
        self.rect[0][i] = f32::from(splat.rect.x0) - x0;
        self.rect[1][i] = f32::from(splat.rect.y0) - y0;
        self.rect[2][i] = f32::from(splat.rect.x1) - 1.0 - x0;
        self.rect[3][i] = f32::from(splat.rect.y1) - 1.0 - y0;
    }
}

#[inline(always)]
fn load<S: Simd>(s: S, values: &[f32; RUN], start: usize) -> f32x16<S> {
    f32x16::from_slice(s, &values[start..start + 16])
}
