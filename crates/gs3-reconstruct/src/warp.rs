//! Gathers the frame between two neighbours from them, block by block.
//!
//! Depths, positions and weights are made for a block of pixels at a time, sixteen lanes wide. Four pixels in a row that
//! move alike are gathered at once; the others one by one.

use fearless_simd::{Simd, f32x16, i32x16, prelude::*};
use gs3_scene::Image;

use crate::gather::{Gather, QUAD, UNITS, sum_of_pixels};
use crate::middle_depth::MiddleDepth;
use crate::neighbor_depth::{HIDDEN, NeighborDepth, SAME_SURFACE};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// Pixels of a block: few enough that what is made for them stays in the first-level cache.
const BLOCK: usize = 64;

const LANES: usize = 16;

/// Rows of pixels that a task makes block by block, so that the rows they gather from are still in the first-level cache.
pub(crate) const BAND: usize = 8;

/// Four pixels whose displacements lie within this many pixels, along x and along y, are gathered at once, moved by the
/// middle of the displacements. The largest error, half of it, is 1/32 px; on real scenes it costs no more than 0.001 dB.
const RIGID: f32 = 1.0 / 16.0;

/// Weights that do not show in the finest of displays.
const NEGLIGIBLE: f32 = 1e-4;

/// All that rows are made from.
pub(crate) struct Warp<'a> {
    pub scale: usize,
    pub t: f32,
    pub gather: &'a Gather,
    pub middle: &'a MiddleDepth,
    pub depths: &'a [NeighborDepth; 2],
    pub images: [&'a Image; 2],
    pub reprojections: [Reprojection; 2],
}

/// Rows of pixels of both neighbours, apart.
pub(crate) struct Parts<'a> {
    /// Colours per neighbour, `[rows, width]`.
    pub images: [&'a mut [[f32; 4]]; 2],
    /// Visibility per neighbour, `[rows, width]`.
    pub visibility: [&'a mut [f32]; 2],
    /// Share of the second neighbour, `[rows, width]`.
    pub share: &'a mut [f32],
}

/// Where the pixels of a block are found in the neighbours, and how they are blended.
struct Block {
    /// Fixed-point x and y per neighbour; those of a rigid quad differ by whole pixels.
    places: [[[i32; BLOCK]; 2]; 2],
    /// Per neighbour, a bit per pixel: whether the four pixels of its quad move alike.
    rigid: [u64; 2],
    /// Visibility per neighbour.
    visibility: [[f32; BLOCK]; 2],
    /// Share of the second neighbour.
    share: [f32; BLOCK],
    /// A bit per pixel: whether the four pixels of its quad are blended alike.
    even: u64,
}

impl Warp<'_> {
    /// Blends whole rows of pixels from row `top` on.
    #[inline(always)]
    pub fn blend<S: Simd>(&self, simd: S, top: usize, rows: &mut [[f32; 4]]) {
        let width = self.images[0].width();
        let mut block = Block::new();
        for x in (0..width).step_by(BLOCK) {
            for (y, row) in (top..).zip(rows.chunks_exact_mut(width)) {
                self.place(simd, x, y, &mut block);
                let end = (x + BLOCK).min(width);
                self.gather_blended(simd, &block, &mut row[x..end]);
            }
        }
    }

    /// Makes whole rows of pixels from row `top` on, both neighbours apart.
    #[inline(always)]
    pub fn separate<S: Simd>(&self, simd: S, top: usize, parts: Parts<'_>) {
        let width = self.images[0].width();
        let mut block = Block::new();
        let Parts { images, visibility, share } = parts;
        for x in (0..width).step_by(BLOCK) {
            for row in 0..share.len() / width {
                self.place(simd, x, top + row, &mut block);
                let at = row * width + x..row * width + (x + BLOCK).min(width);
                let count = at.len();
                share[at.clone()].copy_from_slice(&block.share[..count]);
                for n in 0..2 {
                    visibility[n][at.clone()].copy_from_slice(&block.visibility[n][..count]);
                    self.gather_single(simd, n, &block, &mut images[n][at.clone()]);
                }
            }
        }
    }

    /// Inverse depths of a block of the middle frame: linear within a surface, the nearest sample's at an edge.
    #[inline(always)]
    fn middle_depths(&self, x: usize, y: usize, depths: &mut [f32; BLOCK]) {
        let (scale, width) = (self.scale, self.middle.width);
        // Cell c lies between samples c − 1 and c.
        let (cell_y, phase_y) = ((y + scale - scale / 2) / scale, (y + scale - scale / 2) % scale);
        let fraction = |phase: usize| (phase as f32 + 0.5 + (scale / 2) as f32) / scale as f32 - 0.5;
        let row = |j: usize| &self.middle.inverse[j.min(self.middle.height - 1) * width..][..width];
        let (top, bottom, fy) = (row(cell_y.saturating_sub(1)), row(cell_y), fraction(phase_y));
        let fractions: [f32; crate::MAX_SCALE as usize] = std::array::from_fn(fraction);
        let (mut cell, mut phase) = ((x + scale - scale / 2) / scale, (x + scale - scale / 2) % scale);
        let mut k = 0;
        while k < BLOCK {
            let [i0, i1] = [cell.saturating_sub(1), cell].map(|i| i.min(width - 1));
            let [a, b, c, d] = [top[i0], top[i1], bottom[i0], bottom[i1]];
            let (far, near) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
            let count = (scale - phase).min(BLOCK - k);
            if near - far <= SAME_SURFACE * near {
                let (left, right) = (a + (c - a) * fy, b + (d - b) * fy);
                for (depth, f) in depths[k..k + count].iter_mut().zip(&fractions[phase..]) {
                    *depth = left + (right - left) * f;
                }
            } else {
                let [left, right] = if fy < 0.5 { [a, b] } else { [c, d] };
                for (depth, f) in depths[k..k + count].iter_mut().zip(&fractions[phase..]) {
                    *depth = if *f < 0.5 { left } else { right };
                }
            }
            k += count;
            (cell, phase) = (cell + 1, 0);
        }
    }

    /// Where the pixels of the block from `(x, y)` on are found in the neighbours, and how they are blended.
    #[inline(always)]
    fn place<S: Simd>(&self, simd: S, x: usize, y: usize, block: &mut Block) {
        let mut depths = [0.0; BLOCK];
        self.middle_depths(x, y, &mut depths);
        (block.rigid, block.even) = ([0; 2], 0);
        let splat = |v: f32| f32x16::splat(simd, v);
        let lanes = f32x16::load_array(simd, std::array::from_fn(|k| k as f32));
        for from in (0..BLOCK).step_by(LANES) {
            let at = from..from + LANES;
            let depth = f32x16::from_slice(simd, &depths[at.clone()]);
            let x = lanes + splat((x + from) as f32);
            let mut weights = [splat(1.0 - self.t), splat(self.t)];
            for n in 0..2 {
                let [u, v, w] = self.reproject(simd, n, x, y as f32, depth);
                let visibility = self.visibility(simd, n, [u, v, w]);
                visibility.store_slice(&mut block.visibility[n][at.clone()]);
                weights[n] *= visibility;
                // Displacements within the quad.
                let moved = [u - x, v - splat(y as f32)];
                let [(least_x, most_x), (least_y, most_y)] = moved.map(extremes);
                let is_rigid =
                    (most_x - least_x).simd_le(splat(RIGID)) & (most_y - least_y).simd_le(splat(RIGID));
                block.rigid[n] |= is_rigid.to_bitmask() << from;
                let common = [(least_x + most_x) * 0.5, (least_y + most_y) * 0.5];
                for c in 0..2 {
                    let moved = is_rigid.select(common[c], moved[c]);
                    let units: i32x16<S> = moved.mul_add(splat(UNITS), splat(0.5)).floor().to_int();
                    let pixel: i32x16<S> = if c == 0 { x.to_int() } else { i32x16::splat(simd, y as i32) };
                    let place = units + pixel * UNITS as i32;
                    place.store_slice(&mut block.places[n][c][at.clone()]);
                }
            }
            let share = weights[1] / (weights[0] + weights[1]);
            let share = share.simd_lt(splat(NEGLIGIBLE)).select(splat(0.0), share);
            let share = share.simd_gt(splat(1.0 - NEGLIGIBLE)).select(splat(1.0), share);
            share.store_slice(&mut block.share[at]);
            let (least, most) = extremes(share);
            block.even |= least.simd_eq(most).to_bitmask() << from;
        }
    }

    /// Pixel positions in neighbour `n` and inverse depths there, −1 behind it.
    #[inline(always)]
    fn reproject<S: Simd>(&self, simd: S, n: usize, x: f32x16<S>, y: f32, w: f32x16<S>) -> [f32x16<S>; 3] {
        let splat = |v: f32| f32x16::splat(simd, v);
        // Pixel centres of cameras are at halves.
        let [u, v, q] = self.reprojections[n].apply_16(simd, x + splat(0.5), y + 0.5, w);
        let w = q.simd_gt(splat(MIN_DIVISOR)).select(w / q, splat(-1.0));
        [u - splat(0.5), v - splat(0.5), w]
    }

    /// How well neighbour `n` sees points at its positions `(u, v)` and inverse depths `w`: 1, less at
    /// silhouettes, near 0 hidden, nearer outside.
    #[inline(always)]
    fn visibility<S: Simd>(&self, simd: S, n: usize, [u, v, w]: [f32x16<S>; 3]) -> f32x16<S> {
        let splat = |v: f32| f32x16::splat(simd, v);
        let (width, height) = (self.images[n].width() as f32, self.images[n].height() as f32);
        let inside = u.simd_ge(splat(-0.5))
            & v.simd_ge(splat(-0.5))
            & u.simd_le(splat(width - 0.5))
            & v.simd_le(splat(height - 0.5))
            & w.simd_ge(splat(0.0));
        let seen = self.depths[n].visibility(simd, [u, v, w], self.scale as f32);
        inside.select(seen, splat(HIDDEN * HIDDEN))
    }

    /// Gathers the pixels of a block, both neighbours blended.
    #[inline(always)]
    fn gather_blended<S: Simd>(&self, simd: S, block: &Block, out: &mut [[f32; 4]]) {
        for (first, pixels) in (0..).step_by(QUAD).zip(out.chunks_mut(QUAD)) {
            let is_even = block.even >> first & 1 == 1;
            if !(is_even && pixels.len() == QUAD && self.blend_quad(simd, block, first, pixels)) {
                for (k, pixel) in (first..).zip(pixels) {
                    let mut sum = f32x16::splat(simd, 0.0);
                    for (n, weight) in [1.0 - block.share[k], block.share[k]].into_iter().enumerate() {
                        if weight > 0.0 {
                            sum += self.gather.pixel(simd, self.images[n], block.place(n, k), weight);
                        }
                    }
                    *pixel = sum_of_pixels(sum);
                }
            }
        }
    }

    /// Whether all that an evenly blended quad needs moves alike and is inside the neighbours; if not, nothing has been
    /// written.
    #[inline(always)]
    fn blend_quad<S: Simd>(&self, simd: S, block: &Block, first: usize, pixels: &mut [[f32; 4]]) -> bool {
        let share = block.share[first];
        let mut sum = f32x16::splat(simd, 0.0);
        for (n, weight) in [1.0 - share, share].into_iter().enumerate() {
            if weight > 0.0 {
                let Some(quad) = self.quad(simd, n, block, first) else { return false };
                sum = quad.mul_add(f32x16::splat(simd, weight), sum);
            }
        }
        sum.store_slice(pixels.as_flattened_mut());
        true
    }

    /// Gathers the pixels of a block from neighbour `n` alone.
    #[inline(always)]
    fn gather_single<S: Simd>(&self, simd: S, n: usize, block: &Block, out: &mut [[f32; 4]]) {
        for (first, pixels) in (0..).step_by(QUAD).zip(out.chunks_mut(QUAD)) {
            match self.quad(simd, n, block, first) {
                Some(quad) if pixels.len() == QUAD => quad.store_slice(pixels.as_flattened_mut()),
                _ => {
                    for (k, pixel) in (first..).zip(pixels) {
                        let taps = self.gather.pixel(simd, self.images[n], block.place(n, k), 1.0);
                        *pixel = sum_of_pixels(taps);
                    }
                }
            }
        }
    }

    /// The quad from `first` on in neighbour `n`, if it moves alike and is inside.
    #[inline(always)]
    fn quad<S: Simd>(&self, simd: S, n: usize, block: &Block, first: usize) -> Option<f32x16<S>> {
        let is_rigid = block.rigid[n] >> first & 1 == 1;
        if is_rigid { self.gather.quad(simd, self.images[n], block.place(n, first)) } else { None }
    }
}

impl Block {
    const fn new() -> Self {
        Self {
            places: [[[0; BLOCK]; 2]; 2],
            rigid: [0; 2],
            visibility: [[0.0; BLOCK]; 2],
            share: [0.0; BLOCK],
            even: 0,
        }
    }

    /// Fixed-point position of pixel `k` in neighbour `n`.
    #[inline(always)]
    const fn place(&self, n: usize, k: usize) -> [i32; 2] {
        [self.places[n][0][k], self.places[n][1][k]]
    }
}

/// The least and the largest of every four lanes, in all of them.
#[inline(always)]
fn extremes<S: Simd>(v: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let turned = v.slide_within_blocks::<1>(v);
    let (least, most) = (v.min(turned), v.max(turned));
    (least.min(least.slide_within_blocks::<2>(least)), most.max(most.slide_within_blocks::<2>(most)))
}
