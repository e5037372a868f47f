//! Which splats of a run touch which blocks of 4×4 samples: the exact extent per row of blocks, for sixteen splats at
//! a time.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::splat::{SPAN_SLACK, SPAN_SLACK_PER_PIXEL, Splat};

/// Side of a block in samples: its sixteen samples are the lanes of a vector.
pub const BLOCK: usize = 4;
pub const BLOCKS_X: usize = TILE_WIDTH / BLOCK;
pub const BLOCKS_Y: usize = TILE_HEIGHT / BLOCK;
pub const BLOCKS: usize = BLOCKS_X * BLOCKS_Y;

/// Splats processed at a time: as many as a byte can name. The lists stay in the first-level cache. A block's state is loaded
/// and stored once for the dozens of splats of a run that touch it.
pub const RUN: usize = 256;

/// The samples of a tile: 8×4 blocks of 4×4, row by row.
#[derive(Clone, Copy, Debug)]
pub struct TileSamples {
    /// Distance between samples, pixels.
    pub pitch: f32,
    /// Position of the first sample, pixels.
    pub corner: [f32; 2],
}

/// The first sample of block `b` of a tile: its column and its row.
#[inline(always)]
pub const fn block_first(b: usize) -> [usize; 2] {
    [b % BLOCKS_X * BLOCK, b / BLOCKS_X * BLOCK]
}

impl TileSamples {
    /// Positions of the samples of block `b`, pixels.
    #[inline(always)]
    pub fn of_block<S: Simd>(&self, s: S, b: usize) -> [f32x16<S>; 2] {
        // Not a closure: a closure may be compiled without the kernel's vector instructions.
        let [column, row] = block_first(b);
        let x = f32x16::from_slice(s, &LANES_X) + column as f32;
        let y = f32x16::from_slice(s, &LANES_Y) + row as f32;
        let corner = [f32x16::splat(s, self.corner[0]), f32x16::splat(s, self.corner[1])];
        [x.mul_add(self.pitch, corner[0]), y.mul_add(self.pitch, corner[1])]
    }
}

/// Columns and rows of the samples of a block.
pub static LANES_X: [f32; 16] = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
/// See [`LANES_X`].
pub static LANES_Y: [f32; 16] = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];

/// Slack on the edges of a splat, in samples: edges are inexact by 2⁻²³ of at most 256 pixels.
const SNAP: f32 = 1e-4;

/// The values that extents depend on, one array per value.
#[derive(Clone)]
struct Extents {
    mean_x: [f32; RUN],
    mean_y: [f32; RUN],
    l11: [f32; RUN],
    l21: [f32; RUN],
    l22: [f32; RUN],
    support: [f32; RUN],
    /// First and last sample of the rectangle.
    rect: [[f32; RUN]; 4],
}

/// For each block, the splats of a run that touch it, in order.
#[derive(Clone)]
pub struct Cover {
    /// The splats.
    run: [u32; RUN],
    extents: Extents,
    /// Places in the run. Eight entries are stored at a time; a list is never longer than the part of the run before them.
    lists: [[u8; RUN]; BLOCKS],
    counts: [usize; BLOCKS],
}

// A byte is a place, and every byte is one.
const _: () = assert!(RUN == 1 << u8::BITS);

impl Default for Cover {
    fn default() -> Self {
        let zeros = [0.0; RUN];
        Self {
            run: [0; RUN],
            extents: Extents {
                mean_x: zeros,
                mean_y: zeros,
                l11: zeros,
                l21: zeros,
                l22: zeros,
                support: zeros,
                rect: [zeros; 4],
            },
            lists: [[0; RUN]; BLOCKS],
            counts: [0; BLOCKS],
        }
    }
}

impl Cover {
    /// The splats of the run that touch `block`, front to back.
    #[inline(always)]
    pub fn of_block(&self, block: usize) -> impl ExactSizeIterator<Item = u32> {
        let places = &self.lists[block][..self.counts[block]];
        places.iter().map(|place| self.run[usize::from(*place)])
    }

    /// Makes the lists of a run of splats, which `visited` names in order, for the blocks of a tile in the bit mask
    /// `open`. Rectangles of splats count from the pixel at position `origin`.
    ///
    /// Over a row of blocks, a support's right edge is farthest right at [`Splat::dy_at_max_dx`] or at the sample row nearest
    /// to it. The left edge follows by symmetry at the negative value (Speedy-Splat's AccuTile, Hanson et al. 2025;
    /// see [`Splat::x_span`]).
    #[inline(always)]
    pub fn fill<S: Simd>(
        &mut self,
        s: S,
        splats: &[Splat],
        visited: &[u32],
        samples: &TileSamples,
        origin: [f32; 2],
        open: u32,
    ) {
        let zero = f32x16::splat(s, 0.0);
        self.counts = [0; BLOCKS];
        let (e, count) = (&mut self.extents, visited.len());
        let rect_origin = [0, 1].map(|a| samples.corner[a] - origin[a]);
        for (i, &index) in visited.iter().enumerate() {
            e.set(i, &splats[index as usize], samples.corner, rect_origin);
        }
        let padded = count.next_multiple_of(16);
        self.run[..count].copy_from_slice(visited);
        // An empty rectangle keeps padding splats out of every list.
        e.rect[0][count..padded].fill(f32::INFINITY);
        e.rect[1][count..padded].fill(f32::INFINITY);
        let per_pixel = 1.0 / samples.pitch;
        let last_of_block = (BLOCK - 1) as f32;
        for start in (0..padded).step_by(16) {
            let mean_x = load(s, &e.mean_x, start);
            let mean_y = load(s, &e.mean_y, start);
            let inv_l11 = 1.0 / load(s, &e.l11, start);
            let l21 = load(s, &e.l21, start);
            let l22 = load(s, &e.l22, start);
            let support = load(s, &e.support, start);
            // As [`Splat::dy_at_max_dx`].
            let dy_right = (zero - l21) / l22 * (support / l21.mul_add(l21, l22 * l22)).sqrt();
            let dy_left = zero - dy_right;
            let (left, right) = (load(s, &e.rect[0], start), load(s, &e.rect[2], start));
            // Rows of samples in the rectangle.
            let top = (load(s, &e.rect[1], start) * per_pixel - SNAP).ceil();
            let bottom = (load(s, &e.rect[3], start) * per_pixel + SNAP).floor();
            // The first place of each half of the sixteen splats, in every byte.
            let places = [start as u64, start as u64 + 8].map(|place| place * 0x0101_0101_0101_0101);
            for row in 0..BLOCKS_Y {
                let first_row = (row * BLOCK) as f32;
                let row_open = open >> (row * BLOCKS_X) & ((1 << BLOCKS_X) - 1);
                let last_row = first_row + last_of_block;
                let in_rows = top.simd_le(last_row) & bottom.simd_ge(first_row) & top.simd_le(bottom);
                if row_open == 0 || !in_rows.any_true() {
                    continue;
                }
                let (low, high) = (mean_y - last_row * samples.pitch, mean_y - first_row * samples.pitch);
                let dy = dy_right.min(high).max(low);
                let v = l22 * dy;
                let half = (support - v * v).max(zero).sqrt();
                let reach_right = (half - l21 * dy) * inv_l11;
                let dy = dy_left.min(high).max(low);
                let v = l22 * dy;
                let half = (support - v * v).max(zero).sqrt();
                let reach_left = (zero - half - l21 * dy) * inv_l11;
                // The slack covers rounding. One block too many only costs time.
                let slack = (reach_right - reach_left)
                    .mul_add(f32x16::splat(s, SPAN_SLACK_PER_PIXEL), f32x16::splat(s, SPAN_SLACK));
                // Columns of samples between the edges.
                let from = ((mean_x - reach_right - slack).max(left) * per_pixel - SNAP).ceil();
                let to = ((mean_x - reach_left + slack).min(right) * per_pixel + SNAP).floor();
                let in_rows = in_rows & from.simd_le(to);
                for column in 0..BLOCKS_X {
                    if row_open >> column & 1 == 0 {
                        continue;
                    }
                    let (block, first) = (row * BLOCKS_X + column, (column * BLOCK) as f32);
                    let touches = in_rows & from.simd_le(first + last_of_block) & to.simd_ge(first);
                    let touches = touches.to_bitmask();
                    let list = &mut self.lists[block];
                    let mut end = self.counts[block];
                    for (k, place) in places.into_iter().enumerate() {
                        let bits = touches as usize >> (8 * k) & 255;
                        list[end..end + 8].copy_from_slice(&(BITS[bits] + place).to_le_bytes());
                        end += bits.count_ones() as usize;
                    }
                    self.counts[block] = end;
                }
            }
        }
    }
}

/// For each byte, the numbers of its bits that are set, one byte each, from the lowest byte on. A look-up for eight lanes
/// is faster than compressing a vector where there is no instruction for that, as on AVX2. With AVX-512 both take as long.
static BITS: [u64; 256] = {
    let mut all = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut bit, mut count) = (0, 0);
        while bit < 8 {
            if byte >> bit & 1 == 1 {
                all[byte] |= bit << (8 * count);
                count += 1;
            }
            bit += 1;
        }
        byte += 1;
    }
    all
};

impl Extents {
    /// Stores splat `i` of the run, for samples from position `corner` on. `rect_origin` is the same corner as a
    /// pixel in the rectangles' coordinates.
    #[inline(always)]
    fn set(&mut self, i: usize, splat: &Splat, corner: [f32; 2], rect_origin: [f32; 2]) {
        self.mean_x[i] = splat.mean[0] - corner[0];
        self.mean_y[i] = splat.mean[1] - corner[1];
        self.l11[i] = splat.l11;
        self.l21[i] = splat.l21;
        self.l22[i] = splat.l22;
        self.support[i] = splat.support;
        self.rect[0][i] = f32::from(splat.rect.x0) - rect_origin[0];
        self.rect[1][i] = f32::from(splat.rect.y0) - rect_origin[1];
        self.rect[2][i] = f32::from(splat.rect.x1) - 1.0 - rect_origin[0];
        self.rect[3][i] = f32::from(splat.rect.y1) - 1.0 - rect_origin[1];
    }
}

#[inline(always)]
fn load<S: Simd>(s: S, values: &[f32; RUN], start: usize) -> f32x16<S> {
    f32x16::from_slice(s, &values[start..start + 16])
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::super::splat::PixelRect;
    use super::*;

    /// A round splat of a radius in pixels.
    fn splat(mean: [f32; 2], radius: f32) -> Splat {
        let l11 = 1.0 / radius;
        let [x, y] = mean;
        let rect =
            [x - radius, y - radius, x + radius + 1.0, y + radius + 1.0].map(|v| v.ceil().max(0.0) as u16);
        let [x0, y0, x1, y1] = rect;
        let rect = PixelRect { x0, y0, x1, y1 };
        Splat { mean, l11, l22: l11, support: 1.0, rect, opacity: 1.0, ..Splat::default() }
    }

    /// Numbers from 0 to the argument.
    fn random_numbers() -> impl FnMut(f32) -> f32 {
        let mut random = 1_u64;
        move |most| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 40) as f32 / (1_u64 << 24) as f32 * most
        }
    }

    fn fill(
        level: Level,
        cover: &mut Cover,
        splats: &[Splat],
        visited: &[u32],
        samples: &TileSamples,
        open: u32,
    ) {
        dispatch!(level, s => cover.fill(s, splats, visited, samples, [0.0; 2], open));
    }

    #[test]
    fn numbers_of_bits_are_those_that_are_set() {
        for (byte, numbers) in BITS.iter().enumerate() {
            let expected: Vec<u8> = (0..8).filter(|bit| byte >> bit & 1 == 1).collect();
            assert_eq!(numbers.to_le_bytes()[..expected.len()], expected, "{byte:#b}");
        }
    }

    #[test]
    fn splats_over_a_whole_tile_are_in_every_list_in_the_order_visited() {
        let splats = vec![splat([16.0, 8.0], 100.0); 300];
        let samples = TileSamples { pitch: 1.0, corner: [0.0; 2] };
        let mut cover = Cover::default();
        // After a full run, shorter ones find its numbers in the last sixteen places.
        let counts = [RUN, 1, 7, 8, 9, 15, 16, 17, 255];
        for ((name, level), count) in gs3_simd::levels().into_iter().flat_map(|of| counts.map(|n| (of, n))) {
            let visited: Vec<u32> = (0..count as u32).map(|k| (k * 7 + 3) % 300).collect();
            fill(level, &mut cover, &splats, &visited, &samples, 0x00ff_00f1);
            for b in 0..BLOCKS {
                let expected = if 0x00ff_00f1_u32 >> b & 1 == 1 { &visited[..] } else { &[] };
                assert!(cover.of_block(b).eq(expected.iter().copied()), "{name}, {count} splats, block {b}");
            }
        }
    }

    /// The rightmost and leftmost points of slanted splats lie above or below their means.
    #[test]
    fn slanted_splats_are_listed_where_they_have_a_sample() {
        let mut next = random_numbers();
        for (pitch, (name, level)) in gs3_simd::levels().into_iter().flat_map(|of| [(1.0, of), (4.0, of)]) {
            let rect = PixelRect { x0: 0, y0: 0, x1: 400, y1: 400 };
            let splats: Vec<Splat> = (0..RUN)
                .map(|_| Splat {
                    mean: [64.0 + next(31.0 * pitch), 32.0 + next(15.0 * pitch)],
                    l11: 0.1 + next(1.0),
                    l21: next(4.0) - 2.0,
                    l22: 0.1 + next(1.0),
                    support: 1.0 + next(7.0),
                    rect,
                    ..Splat::default()
                })
                .collect();
            let visited: Vec<u32> = (0..RUN as u32).collect();
            let (corner, mut cover) = ([64.0, 32.0], Cover::default());
            fill(level, &mut cover, &splats, &visited, &TileSamples { pitch, corner }, u32::MAX);
            for b in 0..BLOCKS {
                let listed: Vec<u32> = cover.of_block(b).collect();
                let [column, row] = block_first(b);
                for (k, splat) in splats.iter().enumerate() {
                    let has_sample = (0..BLOCK * BLOCK).any(|i| {
                        let dx = splat.mean[0] - corner[0] - (column + i % BLOCK) as f32 * pitch;
                        let dy = splat.mean[1] - corner[1] - (row + i / BLOCK) as f32 * pitch;
                        let (u, v) = (splat.l11 * dx + splat.l21 * dy, splat.l22 * dy);
                        u * u + v * v <= splat.support
                    });
                    assert!(
                        !has_sample || listed.contains(&(k as u32)),
                        "{name}: splat {k} of block {b}, pitch {pitch}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_splat_is_listed_where_it_has_a_sample_and_not_where_all_are_a_sample_away() {
        let mut next = random_numbers();
        let levels = gs3_simd::levels();
        for (pitch, (name, level)) in levels.into_iter().flat_map(|of| [(1.0, of), (4.0, of)]) {
            let corner = [64.0, 32.0];
            let splats: Vec<Splat> = (0..RUN)
                .map(|_| {
                    splat([64.0 + next(31.0 * pitch), 32.0 + next(15.0 * pitch)], 0.3 + next(3.0 * pitch))
                })
                .collect();
            let visited: Vec<u32> = (0..RUN as u32).rev().collect();
            let mut cover = Cover::default();
            fill(level, &mut cover, &splats, &visited, &TileSamples { pitch, corner }, u32::MAX);
            for b in 0..BLOCKS {
                let listed: Vec<u32> = cover.of_block(b).collect();
                assert!(listed.is_sorted_by(|a, b| a > b), "the order visited, each once");
                for (k, splat) in splats.iter().enumerate() {
                    let [column, row] = block_first(b);
                    // The distance of the block's nearest sample.
                    let nearest = (0..BLOCK * BLOCK).map(|i| {
                        let x = corner[0] + (column + i % BLOCK) as f32 * pitch;
                        let y = corner[1] + (row + i / BLOCK) as f32 * pitch;
                        (splat.mean[0] - x).hypot(splat.mean[1] - y)
                    });
                    let nearest = nearest.fold(f32::INFINITY, f32::min);
                    let is_listed = listed.contains(&(k as u32));
                    assert!(
                        is_listed || nearest > 1.0 / splat.l11,
                        "{name}: splat {k} of block {b}, pitch {pitch}"
                    );
                    assert!(
                        !is_listed || nearest < 1.0 / splat.l11 + pitch,
                        "{name}: splat {k} of block {b}, pitch {pitch}"
                    );
                }
            }
        }
    }
}
