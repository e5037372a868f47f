//! The places of an in-between frame's pixels in its neighbours, patch by patch.
//!
//! A patch is 4×4 pixels. Sixteen patches in a row are examined together by their corners. If the corners of a patch
//! move alike, the whole patch is gathered with one displacement. If they are also all shown or all hidden, the patch
//! has one visibility. The other patches are examined pixel by pixel in sixteen lanes, and gathered four pixels or one
//! pixel at a time. Patches lie on the
//! cells between LR samples where possible (at scales 2, 4 and 8), so that few patches hold two surfaces.
//!
//! A patch costs 54 loads and 78 multiply-adds of sixteen lanes per neighbour. For both neighbours this is 20 cycles
//! a pixel on a CPU with eight lanes a cycle (AVX2 on Zen 1), and 5 on a CPU with two multiply-adds of sixteen lanes.
//! Per pixel, 16 B are read from each neighbour and 16 B written.
//!
//! Kernels here call no closures: a closure would be compiled for the narrowest vectors, and called with its vectors
//! in memory.

use std::ops::Range;

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*};
use gs3_scene::Image;
use rayon::prelude::*;

use crate::cpu::block_gradients::BlockGradients;
use crate::cpu::gather::{Gather, QUAD, UNITS};
use crate::cpu::lanes::load_all;
use crate::cpu::middle_depth::MiddleDepth;
use crate::cpu::neighbor_depth::{HIDDEN, NeighborDepth};
use crate::cpu::rigidity::{looseness, toward};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// Pixels along a side of a patch.
pub(crate) const SIDE: usize = QUAD;

/// Patches examined together; also the pixels of a patch.
pub(crate) const LANES: usize = 16;

/// Pixels along the patches examined together.
const RUN: usize = LANES * SIDE;

/// Width in pixels of a column that is made from the top of a band to its bottom before the next column. Nine rows of
/// this width of both neighbours are 150 KB, which second-level caches hold.
const TILE: usize = 8 * RUN;

/// Rows of pixels per task.
pub(crate) const BAND: usize = 32;

/// The first columns of sixteen patches in a row.
const FIRSTS: [f32; LANES] = {
    let mut firsts = [0.0; LANES];
    let mut k = 0;
    while k < LANES {
        firsts[k] = (k * SIDE) as f32;
        k += 1;
    }
    firsts
};

/// The first columns as whole numbers.
const FIRST_COLUMNS: [usize; LANES] = {
    let mut firsts = [0; LANES];
    let mut k = 0;
    while k < LANES {
        firsts[k] = k * SIDE;
        k += 1;
    }
    firsts
};

/// The columns and the rows of a patch's pixels.
const PATCH_COLUMNS: [usize; LANES] = [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3];
const PATCH_ROWS: [usize; LANES] = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3];

/// The columns and the rows as floating-point numbers.
const COLUMNS: [f32; LANES] = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
const ROWS: [f32; LANES] = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];

/// Inputs of the rows, gathered from `N` neighbours.
pub(crate) struct Warp<'a, const N: usize> {
    pub scale: usize,
    pub gather: &'a Gather,
    pub middle: &'a MiddleDepth,
    pub depths: [&'a NeighborDepth; N],
    pub images: [&'a Image; N],
    /// Derivatives of each image in its exact blocks.
    pub gradients: [Option<&'a BlockGradients>; N],
    pub reprojections: [Reprojection; N],
    /// Shares of the displacements from the middle frame to each neighbour ([`MiddleDepth::displacements_at`]).
    pub shares: [f32; N],
}

/// Sixteen patches in a row.
pub(crate) struct Run<const N: usize> {
    /// Bit `k`: patch `k` moves as a whole in every neighbour. Places are valid for such patches only.
    pub rigid: u64,
    /// Bit `k`: each neighbour shows patch `k` as a whole, or hides it. Visibility is valid for such patches only.
    pub even: u64,
    /// Fixed-point x and y of each patch's first pixel in each neighbour.
    places: [[[i32; LANES]; 2]; N],
    /// The middle of each patch's displacements in each neighbour, x and y.
    moved: [[[f32; LANES]; 2]; N],
    /// The share of own displacements in those of each patch's pixels in each neighbour ([`looseness`]).
    looseness: [[f32; LANES]; N],
    /// Visibility per neighbour.
    pub visibility: [[f32; LANES]; N],
}

/// The pixels of a patch, row by row.
pub(crate) struct Patch<const N: usize> {
    /// Fixed-point x and y in each neighbour. Pixels of a rigid row are whole pixels apart.
    places: [[[i32; LANES]; 2]; N],
    /// Per neighbour, one bit per pixel: whether the four pixels of its row move alike.
    rigid: [u64; N],
    /// Inverse depths.
    pub depth: [f32; LANES],
    /// Visibility per neighbour.
    pub visibility: [[f32; LANES]; N],
}

/// The pixels of a patch that are inside the image and inside the rows being made.
pub(crate) struct Clip {
    /// Rows of the patch.
    pub rows: Range<usize>,
    /// Columns of the patch.
    pub columns: Range<usize>,
    /// Place of the patch's first pixel relative to the rows being made; may be negative.
    origin: isize,
    width: usize,
}

/// Splits rows of `width` values into the bands of tasks. The first band ends where a patch begins.
pub(crate) fn bands<T: Send>(
    scale: usize,
    width: usize,
    rows: &mut [T],
) -> impl IndexedParallelIterator<Item = &mut [T]> {
    let (first, others) = rows.split_at_mut((offset(scale) * width).min(rows.len()));
    rayon::iter::once(first).chain(others.par_chunks_mut(width * BAND))
}

/// The first row of a band.
pub(crate) const fn band_top(scale: usize, band: usize) -> usize {
    if band == 0 { 0 } else { offset(scale) + (band - 1) * BAND }
}

/// Where the first whole patch begins: a cell between samples begins half an LR pixel inside the image.
pub(crate) const fn offset(scale: usize) -> usize {
    scale / 2 % SIDE
}

/// Numbers of patches of an image, in rows of patches.
pub(crate) struct Patches {
    /// The first pixel of the first patch.
    first: [isize; 2],
    /// Patches in a row.
    pub columns: usize,
}

impl Patches {
    /// The patches from row `top` on, where a band begins, of an image `width` wide.
    pub const fn new(scale: usize, width: usize, top: usize) -> Self {
        let offset = offset(scale) as isize;
        let before = if offset > 0 { SIDE as isize - offset } else { 0 };
        let first = [-before, if top == 0 { -before } else { top as isize }];
        Self { first, columns: (width + before as usize).div_ceil(SIDE) }
    }

    /// The number of the patch from `(x, y)` on.
    #[inline(always)]
    pub const fn index(&self, [x, y]: [isize; 2]) -> usize {
        let [column, row] = [(x - self.first[0]) as usize / SIDE, (y - self.first[1]) as usize / SIDE];
        row * self.columns + column
    }
}

impl<'a> Warp<'a, 2> {
    /// The same for the first neighbour alone.
    pub fn of_first(self) -> Warp<'a, 1> {
        let Self { scale, gather, middle, depths: [depth, _], images: [image, _], .. } = self;
        let [gradients, _] = self.gradients;
        let ([reprojection, _], [share, _]) = (self.reprojections, self.shares);
        let (depths, images, reprojections) = ([depth], [image], [reprojection]);
        Warp { scale, gather, middle, depths, images, gradients: [gradients], reprojections, shares: [share] }
    }
}

impl<const N: usize> Warp<'_, N> {
    /// The patches of the band that begins at row `top`.
    pub fn patches(&self, top: usize) -> Patches {
        Patches::new(self.scale, self.images[0].width(), top)
    }

    /// The first pixels of every sixteen patches of a band. The order keeps the source pixels in the cache until the
    /// patches below need them.
    pub fn runs(&self, rows: usize, top: usize) -> impl Iterator<Item = [isize; 2]> + use<N> {
        let (width, offset) = (self.images[0].width() as isize, offset(self.scale) as isize);
        // The first patches may begin outside the image.
        let start = |first: isize| if first == 0 && offset > 0 { offset - SIDE as isize } else { first };
        let (left, top, bottom) = (start(0), start(top as isize), (top + rows) as isize);
        (left..width).step_by(TILE).flat_map(move |tile| {
            let columns = tile..(tile + TILE as isize).min(width);
            (top..bottom).step_by(SIDE).flat_map(move |y| columns.clone().step_by(RUN).map(move |x| [x, y]))
        })
    }

    /// Examines the corners of the sixteen patches from `(x, y)` on.
    #[inline(always)]
    pub fn correspondence_of_run<S: Simd>(&self, simd: S, x: isize, y: isize) -> Run<N> {
        let firsts = f32x16::load_array_ref(simd, &FIRSTS) + x as f32;
        let mut least = [[f32x16::splat(simd, f32::INFINITY); 3]; N];
        let mut most = [[f32x16::splat(simd, f32::NEG_INFINITY); 3]; N];
        let end = SIDE - 1;
        for [dx, dy] in [[0, 0], [end, 0], [0, end], [end, end]] {
            let (corner_x, corner_y) = (x + dx as isize, y + dy as isize);
            let depth = self.middle.along_row(simd, corner_x, SIDE, corner_y);
            let moved = if self.middle.moves_in_row(corner_y) {
                Some(self.middle.displacements_at(simd, [corner_x, corner_y], [&FIRST_COLUMNS, &[0; LANES]]))
            } else {
                None
            };
            let (x, y) = (firsts + dx as f32, f32x16::splat(simd, (y + dy as isize) as f32));
            for n in 0..N {
                let [u, v, w] = self.reproject(simd, n, [x, y, depth], moved);
                let seen = self.depths[n].visibility_along(simd, [u, v, w], self.scale as f32);
                let found = [u - x, v - y, self.inside(simd, n, [u, v, w], seen)];
                for ((least, most), found) in least[n].iter_mut().zip(&mut most[n]).zip(found) {
                    (*least, *most) = (least.min(found), most.max(found));
                }
            }
        }
        let mut run = Run {
            rigid: 0xffff,
            even: 0xffff,
            places: [[[0; LANES]; 2]; N],
            moved: [[[0.0; LANES]; 2]; N],
            looseness: [[1.0; LANES]; N],
            visibility: [[0.0; LANES]; N],
        };
        let firsts = [firsts, f32x16::splat(simd, y as f32)];
        let mut most_seen = f32x16::splat(simd, 0.0);
        for n in 0..N {
            let (least, most) = (&least[n], &most[n]);
            // At scale 1, pixels between the corners have samples of their own.
            let loose = if self.scale > 1 {
                looseness(simd, [most[0] - least[0], most[1] - least[1]])
            } else {
                f32x16::splat(simd, 1.0)
            };
            for c in 0..2 {
                let moved = (least[c] + most[c]) * 0.5;
                run.moved[n][c] = moved.to_array();
                run.places[n][c] = units(moved, firsts[c]).to_array();
            }
            run.looseness[n] = loose.to_array();
            run.rigid &= loose.simd_eq(0.0).to_bitmask();
            let is_sure = most[2].simd_eq(1.0) | most[2].simd_le(HIDDEN);
            run.even &= (most[2].simd_eq(least[2]) & is_sure).to_bitmask();
            run.visibility[n] = most[2].to_array();
            most_seen = most_seen.max(most[2]);
        }
        // What all neighbours hide may be of another surface.
        if N > 1 {
            run.even &= !most_seen.simd_eq(HIDDEN).to_bitmask();
        }
        run
    }

    /// Examines every pixel of patch `k` of `run`, from `(x, y)` on.
    #[inline(always)]
    pub fn correspondence_of_patch<S: Simd>(
        &self,
        simd: S,
        run: &Run<N>,
        k: usize,
        x: isize,
        y: isize,
    ) -> Patch<N> {
        let depth = self.middle.in_patch(simd, x, y);
        let moved = if self.middle.moves_in_patch(x, y) {
            Some(self.middle.displacements_at(simd, [x, y], [&PATCH_COLUMNS, &PATCH_ROWS]))
        } else {
            None
        };
        let [x, y] = Patch::<N>::pixels(simd, [x, y]);
        let mut patch = Patch {
            places: [[[0; LANES]; 2]; N],
            rigid: [0; N],
            depth: depth.to_array(),
            visibility: [[0.0; LANES]; N],
        };
        for n in 0..N {
            let [u, v, w] = self.reproject(simd, n, [x, y, depth], moved);
            let seen = self.depths[n].visibility_within(simd, [u, v, w], self.scale as f32);
            patch.visibility[n] = self.inside(simd, n, [u, v, w], seen).to_array();
            let moved = [u - x, v - y];
            let ((least_x, most_x), (least_y, most_y)) = (extremes(moved[0]), extremes(moved[1]));
            let of_row = looseness(simd, [most_x - least_x, most_y - least_y]);
            let of_patch = f32x16::splat(simd, run.looseness[n][k]);
            patch.rigid[n] = (of_row.simd_eq(0.0) | of_patch.simd_eq(0.0)).to_bitmask();
            let middles = [(least_x + most_x) * 0.5, (least_y + most_y) * 0.5];
            for c in 0..2 {
                let moved = toward(middles[c], moved[c], of_row);
                let moved = toward(f32x16::splat(simd, run.moved[n][c][k]), moved, of_patch);
                patch.places[n][c] = units(moved, [x, y][c]).to_array();
            }
        }
        patch
    }

    /// Pixel positions in neighbour `n`, and inverse depths there, −1 behind its camera. `moved` is the displacement
    /// from neighbour to neighbour, if there is motion.
    #[inline(always)]
    pub fn reproject<S: Simd>(
        &self,
        simd: S,
        n: usize,
        [x, y, w]: [f32x16<S>; 3],
        moved: Option<[f32x16<S>; 3]>,
    ) -> [f32x16<S>; 3] {
        // Pixel centres of cameras are at halves.
        let [u, v, q] = match moved {
            None => self.reprojections[n].apply_16(simd, x + 0.5, y + 0.5, w),
            Some([dx, dy, dz]) => {
                let share = self.shares[n];
                let moved = [dx * share, dy * share, dz * share];
                self.reprojections[n].apply_moved_16(simd, x + 0.5, y + 0.5, w, moved)
            }
        };
        let w = q.simd_gt(MIN_DIVISOR).select(w / q, f32x16::splat(simd, -1.0));
        [u - 0.5, v - 0.5, w]
    }

    /// The visibility `seen` inside neighbour `n`, next to nothing outside.
    #[inline(always)]
    pub fn inside<S: Simd>(
        &self,
        simd: S,
        n: usize,
        [u, v, w]: [f32x16<S>; 3],
        seen: f32x16<S>,
    ) -> f32x16<S> {
        let (width, height) = (self.images[n].width() as f32, self.images[n].height() as f32);
        let inside = u.simd_ge(-0.5)
            & v.simd_ge(-0.5)
            & u.simd_le(width - 0.5)
            & v.simd_le(height - 0.5)
            & w.simd_ge(0.0);
        inside.select(seen, f32x16::splat(simd, HIDDEN * HIDDEN))
    }

    /// Patch `k` of a run in neighbour `n`, row by row, if all pixels needed are inside.
    #[inline(always)]
    pub fn quads<S: Simd>(&self, simd: S, n: usize, run: &Run<N>, k: usize) -> Option<[f32x16<S>; SIDE]> {
        let [x, y] = &run.places[n];
        let (image, place) = (self.images[n], [x[k], y[k]]);
        if let Some(gradients) = self.gradients[n]
            && let Some(cells) = gradients.cells(image.size(), place)
        {
            let mut quads = [[0.0; 4 * SIDE]; SIDE];
            cells.patch(simd.level(), image, place, &mut quads);
            return Some(load_all(simd, &quads));
        }
        self.gather.patch(simd, image, place)
    }

    /// The pixels of patch `k` of a run in neighbour `n`, row by row. Rows and columns beyond the clip are unspecified.
    #[inline(always)]
    pub fn gather_patch<S: Simd>(
        &self,
        simd: S,
        n: usize,
        run: &Run<N>,
        k: usize,
        is_rigid: bool,
        patch: &Patch<N>,
        clip: &Clip,
    ) -> [f32x16<S>; SIDE] {
        if is_rigid && let Some(quads) = self.quads(simd, n, run, k) {
            return quads;
        }
        let mut rows = [f32x16::splat(simd, 0.0); SIDE];
        for r in clip.rows.clone() {
            rows[r] = self.gather_row(simd, n, patch, r, clip.columns.clone());
        }
        rows
    }

    /// The pixels `columns` of row `r` of a patch in neighbour `n`. The other lanes are unspecified.
    #[inline(always)]
    fn gather_row<S: Simd>(
        &self,
        simd: S,
        n: usize,
        patch: &Patch<N>,
        r: usize,
        columns: Range<usize>,
    ) -> f32x16<S> {
        let (image, first) = (self.images[n], r * SIDE);
        if columns.len() == SIDE {
            let is_rigid = patch.rigid[n] >> first & 1 == 1;
            if is_rigid && let Some(quad) = self.gather.quad(simd, image, patch.place(n, first)) {
                return quad;
            }
            // Without an array in memory, as a vector loaded from four smaller stores waits for them; and without a closure,
            // which would not be compiled for wide vectors.
            let a = self.gather.pixel(simd, image, patch.place(n, first));
            let b = self.gather.pixel(simd, image, patch.place(n, first + 1));
            let c = self.gather.pixel(simd, image, patch.place(n, first + 2));
            let d = self.gather.pixel(simd, image, patch.place(n, first + 3));
            return a.combine(b).combine(c.combine(d));
        }
        let mut pixels = [f32x4::splat(simd, 0.0); SIDE];
        for k in columns {
            pixels[k] = self.gather.pixel(simd, image, patch.place(n, first + k));
        }
        let [a, b, c, d] = pixels;
        a.combine(b).combine(c.combine(d))
    }
}

impl<const N: usize> Patch<N> {
    /// The columns and the rows of the pixels of the patch from `(x, y)` on.
    #[inline(always)]
    pub fn pixels<S: Simd>(simd: S, [x, y]: [isize; 2]) -> [f32x16<S>; 2] {
        [f32x16::load_array_ref(simd, &COLUMNS) + x as f32, f32x16::load_array_ref(simd, &ROWS) + y as f32]
    }

    /// Takes the visibility that patch `k` of the run has as a whole.
    #[inline(always)]
    pub fn take_visibility(&mut self, run: &Run<N>, k: usize) {
        for n in 0..N {
            self.visibility[n] = [run.visibility[n][k]; LANES];
        }
    }

    /// Fixed-point position of pixel `k` in neighbour `n`.
    #[inline(always)]
    pub const fn place(&self, n: usize, k: usize) -> [i32; 2] {
        [self.places[n][0][k], self.places[n][1][k]]
    }
}

impl Clip {
    /// The clip of the patch from `(x, y)` on in an image `width` wide, for `count` pixels from row `top` on.
    #[inline(always)]
    pub fn new(x: isize, y: isize, top: usize, width: usize, count: usize) -> Self {
        let y = y - top as isize;
        let inside = |first: isize, len: usize| {
            let end = (len as isize - first).clamp(0, SIDE as isize);
            ((-first).clamp(0, end)) as usize..end as usize
        };
        let (rows, columns) = (inside(y, count / width), inside(x, width));
        Self { rows, columns, origin: y * width as isize + x, width }
    }

    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.rows.len() == SIDE && self.columns.len() == SIDE
    }

    /// The pixels of row `r` of the patch among the rows being made.
    #[inline(always)]
    pub fn row(&self, r: usize) -> Range<usize> {
        let at = |column: usize| (self.origin + (r * self.width + column) as isize) as usize;
        at(self.columns.start)..at(self.columns.end)
    }

    /// Writes row `r` of the patch to its place among the rows being made.
    #[inline(always)]
    pub fn store<S: Simd>(&self, row: f32x16<S>, r: usize, rows: &mut [[f32; 4]]) {
        let out = rows[self.row(r)].as_flattened_mut();
        match out.first_chunk_mut() {
            Some(out) => row.store_array(out),
            None => out.copy_from_slice(&row.to_array()[4 * self.columns.start..4 * self.columns.end]),
        }
    }
}

/// Fixed-point positions of pixels moved by `moved`. Whole pixels are added as integers, so that pixels with the same
/// motion stay whole pixels apart.
#[inline(always)]
pub(crate) fn units<S: Simd>(moved: f32x16<S>, pixel: f32x16<S>) -> i32x16<S> {
    let units: i32x16<S> = (moved * UNITS + 0.5).floor().to_int();
    units + (pixel * UNITS).to_int::<i32x16<S>>()
}

/// The least and the largest of every four lanes, in all four lanes.
#[inline(always)]
fn extremes<S: Simd>(v: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let turned = v.slide_within_blocks::<1>(v);
    let (least, most) = (v.min(turned), v.max(turned));
    (least.min(least.slide_within_blocks::<2>(least)), most.max(most.slide_within_blocks::<2>(most)))
}
