//! Gathers the frame between two neighbours from them, patch by patch.
//!
//! A patch is 4×4 pixels. Sixteen patches in a row are looked at together, by their corners: where a patch moves alike and
//! is seen alike, all of it is gathered with one displacement. The others are looked at pixel by pixel, sixteen lanes,
//! and gathered four pixels or one at a time. Patches lie on the cells between LR samples where they can (at scales 2, 4
//! and 8), so that a patch seldom holds two surfaces.
//!
//! A patch costs 14 loads, 48 multiply-adds and 12 shifts per neighbour; the floor is memory, 16 B read from each
//! neighbour and 16 B written a pixel.

use fearless_simd::{Simd, f32x16, i32x16, mask32x16, prelude::*};
use gs3_scene::Image;
use rayon::prelude::*;

use crate::gather::{Gather, QUAD, UNITS, sum_of_pixels};
use crate::lanes::spread;
use crate::middle_depth::MiddleDepth;
use crate::neighbor_depth::{HIDDEN, NeighborDepth};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// Pixels along a side of a patch.
const SIDE: usize = QUAD;

/// Patches looked at together, and pixels of a patch.
const LANES: usize = 16;

/// Pixels along the patches looked at together.
const RUN: usize = LANES * SIDE;

/// Rows of pixels of a task.
const BAND: usize = 32;

/// Pixels whose displacements lie within this many pixels, along x and along y, are gathered at once, moved by the middle
/// of the displacements. The largest error, half of it, is 1/32 px; on real scenes it costs no more than 0.001 dB.
pub(crate) const RIGID: f32 = 1.0 / 16.0;

/// Weights that do not show in the finest of displays.
pub(crate) const NEGLIGIBLE: f32 = 1e-4;

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

/// Sixteen patches in a row.
struct Run {
    /// Bit `k`: patch `k` moves alike in both neighbours; places are specified for such patches only.
    rigid: u64,
    /// Bit `k`: patch `k` is seen alike; visibility and share are specified for such patches only.
    even: u64,
    /// Fixed-point x and y of the first pixels in each neighbour.
    places: [[[i32; LANES]; 2]; 2],
    /// Visibility per neighbour.
    visibility: [[f32; LANES]; 2],
    /// Share of the second neighbour.
    share: [f32; LANES],
}

/// The pixels of a patch, row by row.
struct Patch {
    /// Fixed-point x and y in each neighbour; those of a rigid row differ by whole pixels.
    places: [[[i32; LANES]; 2]; 2],
    /// Per neighbour, a bit per pixel: whether the four pixels of its row move alike.
    rigid: [u64; 2],
    /// Visibility per neighbour.
    visibility: [[f32; LANES]; 2],
    /// Share of the second neighbour.
    share: [f32; LANES],
    /// A bit per pixel: whether the four pixels of its row are blended alike.
    even: u64,
}

/// The pixels of a patch that are in the image and in the rows being made.
struct Clip {
    /// Of the patch.
    rows: std::ops::Range<usize>,
    /// Of the patch.
    columns: std::ops::Range<usize>,
    /// Place of the patch's first pixel among the rows being made; may be before them.
    origin: isize,
    width: usize,
}

/// Splits rows of `width` values into the bands that tasks make: the first ends where patches begin.
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

/// Where the first whole patch begins: a cell between samples begins half an LR pixel after the image.
pub(crate) const fn offset(scale: usize) -> usize {
    scale / 2 % SIDE
}

impl Warp<'_> {
    /// Blends the rows of pixels `rows` from row `top` on, a band.
    #[inline(always)]
    pub fn blend<S: Simd>(&self, simd: S, top: usize, rows: &mut [[f32; 4]]) {
        let width = self.images[0].width();
        let (count, mut first) = (rows.len(), [[[0.0; 4 * SIDE]; SIDE]; LANES]);
        for [x, y] in self.runs(count / width, top) {
            let run = self.look_at_run(simd, x, y);
            let clip = |k: usize| Clip::new(x + (k * SIDE) as isize, y, top, width, count);
            // One neighbour after the other, so that the rows gathered from stay in the cache.
            let mut rigid = 0;
            for k in 0..LANES {
                if run.rigid >> k & 1 == 1 && clip(k).is_whole() {
                    rigid |= u64::from(self.gather_first(simd, &run, k, &mut first[k])) << k;
                }
            }
            for k in 0..LANES {
                let (clip, x) = (clip(k), x + (k * SIDE) as isize);
                if clip.is_empty() {
                    continue;
                }
                let is_rigid = rigid >> k & 1 == 1;
                let is_even = run.even >> k & 1 == 1;
                if is_rigid && is_even && self.gather_second(simd, &run, k, &first[k], &clip, rows) {
                    continue;
                }
                let patch = self.look_at_patch(simd, x, y);
                if !(is_rigid && self.mix_second(simd, &run, k, &first[k], &patch.share, &clip, rows)) {
                    self.blend_patch(simd, &patch, &clip, rows);
                }
            }
        }
    }

    /// Makes the rows of pixels of `parts` from row `top` on, a band, both neighbours apart.
    #[inline(always)]
    pub fn separate<S: Simd>(&self, simd: S, top: usize, parts: Parts<'_>) {
        let width = self.images[0].width();
        let Parts { images, visibility, share } = parts;
        let count = share.len();
        for [x, y] in self.runs(count / width, top) {
            let run = self.look_at_run(simd, x, y);
            for k in 0..LANES {
                let clip = Clip::new(x + (k * SIDE) as isize, y, top, width, count);
                if clip.is_empty() {
                    continue;
                }
                if (run.rigid & run.even) >> k & 1 == 1 && clip.is_whole() {
                    let quads = [self.quads(simd, 0, &run, k), self.quads(simd, 1, &run, k)];
                    if let [Some(before), Some(after)] = quads {
                        for r in 0..SIDE {
                            let at = clip.row(r);
                            before[r].store_slice(images[0][at.clone()].as_flattened_mut());
                            after[r].store_slice(images[1][at.clone()].as_flattened_mut());
                            visibility[0][at.clone()].fill(run.visibility[0][k]);
                            visibility[1][at.clone()].fill(run.visibility[1][k]);
                            share[at].fill(run.share[k]);
                        }
                        continue;
                    }
                }
                let patch = self.look_at_patch(simd, x + (k * SIDE) as isize, y);
                for r in clip.rows.clone() {
                    let (at, of_patch) =
                        (clip.row(r), r * SIDE + clip.columns.start..r * SIDE + clip.columns.end);
                    share[at.clone()].copy_from_slice(&patch.share[of_patch.clone()]);
                    for n in 0..2 {
                        visibility[n][at.clone()].copy_from_slice(&patch.visibility[n][of_patch.clone()]);
                        self.gather_row(simd, n, &patch, of_patch.start, &mut images[n][at.clone()]);
                    }
                }
            }
        }
    }

    /// The first pixels of every sixteen patches of a band, row by row: what is gathered from is read in long streams.
    fn runs(&self, rows: usize, top: usize) -> impl Iterator<Item = [isize; 2]> + use<> {
        let (width, offset) = (self.images[0].width() as isize, offset(self.scale) as isize);
        // The first patches may begin before the image.
        let start = |first: isize| if first == 0 && offset > 0 { offset - SIDE as isize } else { first };
        let (left, top, bottom) = (start(0), start(top as isize), (top + rows) as isize);
        (top..bottom).step_by(SIDE).flat_map(move |y| (left..width).step_by(RUN).map(move |x| [x, y]))
    }

    /// Looks at the corners of the sixteen patches from `(x, y)` on.
    #[inline(always)]
    fn look_at_run<S: Simd>(&self, simd: S, x: isize, y: isize) -> Run {
        let splat = |v: f32| f32x16::splat(simd, v);
        let firsts = f32x16::from_fn(simd, |k| (k * SIDE) as f32) + x as f32;
        let mut least = [[splat(f32::INFINITY); 3]; 2];
        let mut most = [[splat(f32::NEG_INFINITY); 3]; 2];
        let end = SIDE - 1;
        for [dx, dy] in [[0, 0], [end, 0], [0, end], [end, end]] {
            let depth = self.middle.along_row(simd, x + dx as isize, SIDE, y + dy as isize);
            let (x, y) = (firsts + dx as f32, splat((y + dy as isize) as f32));
            for n in 0..2 {
                let [u, v, w] = self.reproject(simd, n, x, y, depth);
                let seen = self.depths[n].visibility_along(simd, [u, v, w], self.scale as f32);
                let found = [u - x, v - y, self.inside(simd, n, [u, v, w], seen)];
                for ((least, most), found) in least[n].iter_mut().zip(&mut most[n]).zip(found) {
                    (*least, *most) = (least.min(found), most.max(found));
                }
            }
        }
        // At scale 1, pixels between the corners have samples of their own.
        let every = if self.scale > 1 { 0xffff } else { 0 };
        let rigid = is_rigid(&least[0], &most[0]) & is_rigid(&least[1], &most[1]);
        let even = most[0][2].simd_eq(least[0][2]) & most[1][2].simd_eq(least[1][2]);
        let y = splat(y as f32);
        Run {
            rigid: rigid.to_bitmask() & every,
            even: even.to_bitmask() & every,
            places: [
                [middle(&least[0], &most[0], 0, firsts), middle(&least[0], &most[0], 1, y)],
                [middle(&least[1], &most[1], 0, firsts), middle(&least[1], &most[1], 1, y)],
            ],
            visibility: [most[0][2].to_array(), most[1][2].to_array()],
            share: self.share(simd, [most[0][2], most[1][2]]).to_array(),
        }
    }

    /// Looks at every pixel of the patch from `(x, y)` on.
    #[inline(always)]
    fn look_at_patch<S: Simd>(&self, simd: S, x: isize, y: isize) -> Patch {
        let depth = self.middle.in_patch(simd, x, y);
        let x = f32x16::from_fn(simd, |k| (k % SIDE) as f32) + x as f32;
        let y = f32x16::from_fn(simd, |k| (k / SIDE) as f32) + y as f32;
        let mut patch = Patch {
            places: [[[0; LANES]; 2]; 2],
            rigid: [0; 2],
            visibility: [[0.0; LANES]; 2],
            share: [0.0; LANES],
            even: 0,
        };
        let mut visibility = [f32x16::splat(simd, 0.0); 2];
        for n in 0..2 {
            let [u, v, w] = self.reproject(simd, n, x, y, depth);
            let seen = self.depths[n].visibility_within(simd, [u, v, w], self.scale as f32);
            visibility[n] = self.inside(simd, n, [u, v, w], seen);
            patch.visibility[n] = visibility[n].to_array();
            let (moved_x, moved_y) = (u - x, v - y);
            let (least_x, most_x) = extremes(moved_x);
            let (least_y, most_y) = extremes(moved_y);
            let is_rigid = (most_x - least_x).simd_le(RIGID) & (most_y - least_y).simd_le(RIGID);
            patch.rigid[n] = is_rigid.to_bitmask();
            let common_x = is_rigid.select((least_x + most_x) * 0.5, moved_x);
            let common_y = is_rigid.select((least_y + most_y) * 0.5, moved_y);
            patch.places[n] = [units(common_x, x).to_array(), units(common_y, y).to_array()];
        }
        let share = self.share(simd, visibility);
        let (least, most) = extremes(share);
        (patch.share, patch.even) = (share.to_array(), least.simd_eq(most).to_bitmask());
        patch
    }

    /// The share of the second neighbour.
    #[inline(always)]
    fn share<S: Simd>(&self, simd: S, visibility: [f32x16<S>; 2]) -> f32x16<S> {
        let splat = |v: f32| f32x16::splat(simd, v);
        let [before, after] = [visibility[0] * (1.0 - self.t), visibility[1] * self.t];
        let share = after / (before + after);
        let share = share.simd_lt(NEGLIGIBLE).select(splat(0.0), share);
        share.simd_gt(1.0 - NEGLIGIBLE).select(splat(1.0), share)
    }

    /// Pixel positions in neighbour `n` and inverse depths there, −1 behind it.
    #[inline(always)]
    fn reproject<S: Simd>(
        &self,
        simd: S,
        n: usize,
        x: f32x16<S>,
        y: f32x16<S>,
        w: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        // Pixel centres of cameras are at halves.
        let [u, v, q] = self.reprojections[n].apply_16(simd, x + 0.5, y + 0.5, w);
        let w = q.simd_gt(MIN_DIVISOR).select(w / q, f32x16::splat(simd, -1.0));
        [u - 0.5, v - 0.5, w]
    }

    /// The visibility `seen` within neighbour `n`, next to nothing outside.
    #[inline(always)]
    fn inside<S: Simd>(&self, simd: S, n: usize, [u, v, w]: [f32x16<S>; 3], seen: f32x16<S>) -> f32x16<S> {
        let (width, height) = (self.images[n].width() as f32, self.images[n].height() as f32);
        let inside = u.simd_ge(-0.5)
            & v.simd_ge(-0.5)
            & u.simd_le(width - 0.5)
            & v.simd_le(height - 0.5)
            & w.simd_ge(0.0);
        inside.select(seen, f32x16::splat(simd, HIDDEN * HIDDEN))
    }

    /// Patch `k` of a run in neighbour `n`, row by row, if all it needs is inside.
    #[inline(always)]
    fn quads<S: Simd>(&self, simd: S, n: usize, run: &Run, k: usize) -> Option<[f32x16<S>; SIDE]> {
        let [x, y] = &run.places[n];
        self.gather.patch(simd, self.images[n], [x[k], y[k]])
    }

    /// Gathers what the first neighbour gives to a rigid patch: by its weight where it is even, else all; `false` if that
    /// is not all inside.
    #[inline(always)]
    fn gather_first<S: Simd>(&self, simd: S, run: &Run, k: usize, out: &mut [[f32; 4 * SIDE]; SIDE]) -> bool {
        let is_even = run.even >> k & 1 == 1;
        let weight = if is_even { 1.0 - run.share[k] } else { 1.0 };
        if weight == 0.0 {
            *out = [[0.0; 4 * SIDE]; SIDE];
            return true;
        }
        let Some(quads) = self.quads(simd, 0, run, k) else { return false };
        for (quad, out) in quads.into_iter().zip(out) {
            (quad * weight).store_array(out);
        }
        true
    }

    /// Adds what the second neighbour gives to an even patch, and writes it; `false`, and nothing written, if that is not
    /// all inside.
    #[inline(always)]
    fn gather_second<S: Simd>(
        &self,
        simd: S,
        run: &Run,
        k: usize,
        first: &[[f32; 4 * SIDE]; SIDE],
        clip: &Clip,
        rows: &mut [[f32; 4]],
    ) -> bool {
        let weight = run.share[k];
        let mut quads = [f32x16::splat(simd, 0.0); SIDE];
        if weight > 0.0 {
            let Some(second) = self.quads(simd, 1, run, k) else { return false };
            quads = second;
        }
        for (r, (quad, first)) in quads.into_iter().zip(first).enumerate() {
            let sum = quad.mul_add(weight, f32x16::load_array_ref(simd, first));
            sum.store_slice(rows[clip.row(r)].as_flattened_mut());
        }
        true
    }

    /// Mixes what the first neighbour gives to a patch with what the second does, pixel by pixel, and writes it; `false`,
    /// and nothing written, if that is not all inside.
    #[inline(always)]
    fn mix_second<S: Simd>(
        &self,
        simd: S,
        run: &Run,
        k: usize,
        first: &[[f32; 4 * SIDE]; SIDE],
        share: &[f32; LANES],
        clip: &Clip,
        rows: &mut [[f32; 4]],
    ) -> bool {
        let Some(second) = self.quads(simd, 1, run, k) else { return false };
        for r in 0..SIDE {
            let share = spread(simd, &share[r * SIDE..(r + 1) * SIDE]);
            let first = f32x16::load_array_ref(simd, &first[r]);
            let mixed = (second[r] - first).mul_add(share, first);
            mixed.store_slice(rows[clip.row(r)].as_flattened_mut());
        }
        true
    }

    /// Blends the pixels of a patch.
    #[inline(always)]
    fn blend_patch<S: Simd>(&self, simd: S, patch: &Patch, clip: &Clip, rows: &mut [[f32; 4]]) {
        for r in clip.rows.clone() {
            let first = r * SIDE + clip.columns.start;
            let pixels = &mut rows[clip.row(r)];
            let is_even = patch.even >> first & 1 == 1;
            if is_even && pixels.len() == QUAD && self.blend_quad(simd, patch, first, pixels) {
                continue;
            }
            for (k, pixel) in (first..).zip(pixels) {
                let mut sum = f32x16::splat(simd, 0.0);
                for (n, weight) in [1.0 - patch.share[k], patch.share[k]].into_iter().enumerate() {
                    if weight > 0.0 {
                        sum += self.gather.pixel(simd, self.images[n], patch.place(n, k), weight);
                    }
                }
                *pixel = sum_of_pixels(sum);
            }
        }
    }

    /// Whether all that an evenly blended quad needs moves alike and is inside the neighbours; if not, nothing has been
    /// written.
    #[inline(always)]
    fn blend_quad<S: Simd>(&self, simd: S, patch: &Patch, first: usize, pixels: &mut [[f32; 4]]) -> bool {
        let share = patch.share[first];
        let mut sum = f32x16::splat(simd, 0.0);
        for (n, weight) in [1.0 - share, share].into_iter().enumerate() {
            if weight > 0.0 {
                let Some(quad) = self.quad(simd, n, patch, first) else { return false };
                sum = quad.mul_add(weight, sum);
            }
        }
        sum.store_slice(pixels.as_flattened_mut());
        true
    }

    /// Gathers pixels of a row of a patch, from its pixel `first` on, from neighbour `n` alone.
    #[inline(always)]
    fn gather_row<S: Simd>(&self, simd: S, n: usize, patch: &Patch, first: usize, pixels: &mut [[f32; 4]]) {
        if pixels.len() == QUAD
            && let Some(quad) = self.quad(simd, n, patch, first)
        {
            return quad.store_slice(pixels.as_flattened_mut());
        }
        for (k, pixel) in (first..).zip(pixels) {
            *pixel = sum_of_pixels(self.gather.pixel(simd, self.images[n], patch.place(n, k), 1.0));
        }
    }

    /// The row of a patch from pixel `first` on in neighbour `n`, if it moves alike and is inside.
    #[inline(always)]
    fn quad<S: Simd>(&self, simd: S, n: usize, patch: &Patch, first: usize) -> Option<f32x16<S>> {
        let is_rigid = patch.rigid[n] >> first & 1 == 1;
        if is_rigid { self.gather.quad(simd, self.images[n], patch.place(n, first)) } else { None }
    }
}

impl Patch {
    /// Fixed-point position of pixel `k` in neighbour `n`.
    #[inline(always)]
    const fn place(&self, n: usize, k: usize) -> [i32; 2] {
        [self.places[n][0][k], self.places[n][1][k]]
    }
}

impl Clip {
    /// The patch from `(x, y)` on within the image, `width` wide, and its `count` pixels from row `top` on.
    #[inline(always)]
    fn new(x: isize, y: isize, top: usize, width: usize, count: usize) -> Self {
        let y = y - top as isize;
        let inside = |first: isize, len: usize| {
            let end = (len as isize - first).clamp(0, SIDE as isize);
            ((-first).clamp(0, end)) as usize..end as usize
        };
        let (rows, columns) = (inside(y, count / width), inside(x, width));
        Self { rows, columns, origin: y * width as isize + x, width }
    }

    #[inline(always)]
    fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    #[inline(always)]
    fn is_whole(&self) -> bool {
        self.rows.len() == SIDE && self.columns.len() == SIDE
    }

    /// The pixels of row `r` of the patch among the rows being made.
    #[inline(always)]
    fn row(&self, r: usize) -> std::ops::Range<usize> {
        let at = |column: usize| (self.origin + (r * self.width + column) as isize) as usize;
        at(self.columns.start)..at(self.columns.end)
    }
}

/// Whether displacements, x and y, are rigid between their least and most.
#[inline(always)]
fn is_rigid<S: Simd>(least: &[f32x16<S>; 3], most: &[f32x16<S>; 3]) -> mask32x16<S> {
    (most[0] - least[0]).simd_le(RIGID) & (most[1] - least[1]).simd_le(RIGID)
}

/// Fixed-point positions, along axis `c`, of pixels moved by the middle of the displacements.
#[inline(always)]
fn middle<S: Simd>(
    least: &[f32x16<S>; 3],
    most: &[f32x16<S>; 3],
    c: usize,
    pixel: f32x16<S>,
) -> [i32; LANES] {
    units((least[c] + most[c]) * 0.5, pixel).to_array()
}

/// Fixed-point positions of pixels moved by `moved`. Whole pixels are added in whole numbers, so that pixels that move
/// alike stay whole pixels apart.
#[inline(always)]
fn units<S: Simd>(moved: f32x16<S>, pixel: f32x16<S>) -> i32x16<S> {
    let units: i32x16<S> = (moved * UNITS + 0.5).floor().to_int();
    units + (pixel * UNITS).to_int::<i32x16<S>>()
}

/// The least and the largest of every four lanes, in all of them.
#[inline(always)]
fn extremes<S: Simd>(v: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let turned = v.slide_within_blocks::<1>(v);
    let (least, most) = (v.min(turned), v.max(turned));
    (least.min(least.slide_within_blocks::<2>(least)), most.max(most.slide_within_blocks::<2>(most)))
}
