//! The depths of two neighbours, reprojected to the pose between them.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, mask32x16, prelude::*};
use gs3_scene::Camera;
use rayon::prelude::*;

use crate::cpu::lanes::{load_all, repeat, spread};
use crate::cpu::neighbor_depth::NeighborDepth;
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE};

/// Inverse depths at the LR pixel centres of the in-between frame.
#[derive(Debug, Default)]
pub(crate) struct MiddleDepth {
    pub width: usize,
    pub height: usize,
    scale: usize,
    /// `[height, width]`, ≥ 0.
    pub inverse: Vec<f32>,
    /// Places of HR columns among the samples, from column −[`MARGIN`] on.
    columns: Vec<Place>,
    /// Places of HR rows among the samples.
    rows: Vec<Place>,
    /// The nearest splatted inverse depth, as [`encode`]d bits.
    splatted: Vec<AtomicU32>,
    /// Holes being filled, each with the neighbouring place that it copies.
    ring: Vec<(usize, usize)>,
    /// The holes beside the holes being filled.
    next: Vec<(usize, usize)>,
    /// Moving surfaces.
    moving: Moving,
}

/// Displacements in the world of the surfaces of the in-between frame, from the first neighbour to the second.
#[derive(Debug, Default)]
struct Moving {
    /// `[height, width]`; none if nothing moves.
    displacements: Vec<[f32; 3]>,
    /// Whether each row has any displacement.
    rows: Vec<bool>,
    /// Number of the nearest sample plus one, counted over both neighbours, one after the other; only samples that
    /// move.
    nearest: Vec<AtomicU32>,
    /// Focal length of the in-between frame, in HR pixels.
    focal: f32,
}

/// Moving objects between the neighbours of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Passage<'a> {
    /// Displacements in the world of the samples of the first neighbour and of the second, from the first neighbour
    /// to the second, `[height, width]`.
    pub displacements: [&'a [[f32; 3]]; 2],
    /// Time of the in-between frame, `[0, 1]`.
    pub t: f32,
}

impl Passage<'_> {
    /// The shares of the displacements from the in-between frame to each neighbour.
    pub const fn to_neighbors(t: f32) -> [f32; 2] {
        [-t, 1.0 - t]
    }
}

/// The samples of a neighbour on their way to the in-between frame.
struct Splatter<'a> {
    neighbor: &'a NeighborDepth,
    reprojection: Reprojection,
    scale: f32,
    /// The displacements of the neighbour's samples, and the share of them that leads to the in-between frame.
    moving: Option<(&'a [[f32; 3]], f32)>,
}

/// Samples with displacements that differ by more than this, in HR pixels, are on different surfaces, at any depths.
const TORN: f32 = 0.5;

/// Number of HR columns and rows outside the image, on either side, with valid depths: the depths of the border.
const MARGIN: usize = 64;

/// The place of an HR column or row: between two samples. Before the first and after the last sample, both are one
/// sample.
#[derive(Clone, Copy, Debug)]
struct Place {
    samples: [u32; 2],
    /// Fraction of the way, `[0, 1)`.
    fraction: f32,
}

impl MiddleDepth {
    /// Splats the depths of both neighbours to `camera` (the nearest wins), with moving samples displaced according
    /// to `passage`, and fills the holes.
    pub fn set(
        &mut self,
        level: Level,
        neighbors: &[NeighborDepth; 2],
        cameras: [&Camera; 2],
        camera: &Camera,
        scale: u32,
        passage: Option<Passage<'_>>,
    ) {
        (self.width, self.height) = (neighbors[0].width, neighbors[0].height);
        self.scale = scale as usize;
        set_places(&mut self.columns, self.width, scale as usize);
        set_places(&mut self.rows, self.height, scale as usize);
        self.splatted.resize_with(self.width * self.height, || AtomicU32::new(HOLE));
        self.splatted.par_iter_mut().with_min_len(1 << 14).for_each(|v| *v.get_mut() = HOLE);
        let splatters = [0, 1].map(|n| Splatter {
            neighbor: &neighbors[n],
            reprojection: Reprojection::new(cameras[n], camera),
            scale: scale as f32,
            moving: passage.map(|p| (p.displacements[n], -Passage::to_neighbors(p.t)[n])),
        });
        for splatter in &splatters {
            let rows = splatter.neighbor.inverse.par_chunks_exact(self.width).enumerate().with_min_len(8);
            rows.for_each(|(row, depths)| dispatch!(level, simd => self.splat(simd, splatter, row, depths)));
        }
        self.inverse.resize(self.splatted.len(), 0.0);
        let inverse = self.inverse.par_iter_mut().zip(&self.splatted).with_min_len(1 << 14);
        inverse.for_each(|(inverse, bits)| *inverse = decode(bits.load(Relaxed)));
        self.find_displacements(level, &splatters);
        self.fill_holes();
        let Moving { displacements, rows, focal, .. } = &mut self.moving;
        rows.clear();
        rows.extend(displacements.chunks_exact(self.width).map(|row| row.iter().any(|d| *d != [0.0; 3])));
        *focal = camera.intrinsics().fx as f32;
    }

    /// Finds the displacements of the nearest samples; displacements of holes are 0.
    fn find_displacements(&mut self, level: Level, splatters: &[Splatter<'_>; 2]) {
        let size = self.width * self.height;
        self.moving.displacements.clear();
        let [Some((first, _)), Some((second, _))] = splatters.each_ref().map(|splatter| splatter.moving)
        else {
            return;
        };
        self.moving.nearest.resize_with(size, AtomicU32::default);
        self.moving.nearest.par_iter_mut().with_min_len(1 << 14).for_each(|nearest| *nearest.get_mut() = 0);
        for (n, splatter) in splatters.iter().enumerate() {
            let rows = splatter.neighbor.inverse.par_chunks_exact(self.width).enumerate().with_min_len(8);
            rows.for_each(|(row, depths)| {
                dispatch!(level, simd => self.claim(simd, splatter, row, depths, n * size));
            });
        }
        let both = |k: usize| if k < size { first[k] } else { second[k - size] };
        self.moving.displacements.extend(self.moving.nearest.iter().map(|nearest| {
            let sample = nearest.load(Relaxed) as usize;
            if sample == 0 { [0.0; 3] } else { both(sample - 1) }
        }));
    }

    /// Whether anything moves in HR row `y`.
    #[inline(always)]
    pub fn moves_in_row(&self, y: isize) -> bool {
        let Moving { rows, .. } = &self.moving;
        !rows.is_empty() && {
            let [above, below] = self.rows[(y + MARGIN as isize) as usize].samples;
            rows[above as usize] || rows[below as usize]
        }
    }

    /// Displacements at sixteen HR pixels: `columns` after column `x` and `rows` after row `y`.
    #[inline(always)]
    pub fn displacements_at<S: Simd>(
        &self,
        simd: S,
        [x, y]: [isize; 2],
        [columns, rows]: [&[usize; 16]; 2],
    ) -> [f32x16<S>; 3] {
        let (mut found, mut depths, mut fractions) = ([[[0.0; 16]; 4]; 3], [[0.0; 16]; 4], [[0.0; 16]; 2]);
        for k in 0..16 {
            let column = self.columns[(x + columns[k] as isize + MARGIN as isize) as usize];
            let row = self.rows[(y + rows[k] as isize + MARGIN as isize) as usize];
            (fractions[0][k], fractions[1][k]) = (column.fraction, row.fraction);
            for (corner, (j, i)) in [(0, 0), (0, 1), (1, 0), (1, 1)].into_iter().enumerate() {
                let at = row.samples[j] as usize * self.width + column.samples[i] as usize;
                depths[corner][k] = self.inverse[at];
                for (found, displacement) in found.iter_mut().zip(self.moving.displacements[at]) {
                    found[corner][k] = displacement;
                }
            }
        }
        let [a, b, c, d] = load_all(simd, &depths);
        let (far, near) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        let [x, y, z] = [0, 1, 2].map(|axis| found[axis]);
        let (x, y, z) = (load_all(simd, &x), load_all(simd, &y), load_all(simd, &z));
        let torn = spread_of(&x).max(spread_of(&y)).max(spread_of(&z)) * near * self.moving.focal;
        let is_surface = (near - far).simd_le(near * SAME_SURFACE) & torn.simd_le(TORN);
        let fractions = load_all(simd, &fractions);
        [
            between_of(is_surface, x, fractions),
            between_of(is_surface, y, fractions),
            between_of(is_surface, z, fractions),
        ]
    }

    /// Inverse depths at sixteen HR pixels in row `y`, from column `x` on, `step` apart.
    #[inline(always)]
    pub fn along_row<S: Simd>(&self, simd: S, x: isize, step: usize, y: isize) -> f32x16<S> {
        let Place { samples: rows, fraction } = self.rows[(y + MARGIN as isize) as usize];
        let above = &self.inverse[rows[0] as usize * self.width..][..self.width];
        let below = &self.inverse[rows[1] as usize * self.width..][..self.width];
        let places = &self.columns[(x + MARGIN as isize) as usize..];
        // Sixteen cells in a row, as everywhere at scale 4 except at the borders.
        let ([left, right], [last, _]) = (places[0].samples, places[15 * step].samples);
        let (left, right) = (left as usize, right as usize);
        if step == self.scale && last as usize == left + 15 && right == left + 1 && right + 16 <= self.width {
            let samples = [
                f32x16::from_slice(simd, &above[left..left + 16]),
                f32x16::from_slice(simd, &above[right..right + 16]),
                f32x16::from_slice(simd, &below[left..left + 16]),
                f32x16::from_slice(simd, &below[right..right + 16]),
            ];
            let fractions = [f32x16::splat(simd, places[0].fraction), f32x16::splat(simd, fraction)];
            return between(samples, fractions);
        }
        let (mut found, mut fractions) = ([[0.0; 16]; 4], [0.0; 16]);
        let places = places.iter().step_by(step);
        for (k, place) in places.take(16).enumerate() {
            let [left, right] = place.samples.map(|i| i as usize);
            fractions[k] = place.fraction;
            (found[0][k], found[1][k]) = (above[left], above[right]);
            (found[2][k], found[3][k]) = (below[left], below[right]);
        }
        let fractions = [f32x16::load_array_ref(simd, &fractions), f32x16::splat(simd, fraction)];
        between(load_all(simd, &found), fractions)
    }

    /// Inverse depths at the 4×4 HR pixels from `(x, y)` on, row by row.
    #[inline(always)]
    pub fn in_patch<S: Simd>(&self, simd: S, x: isize, y: isize) -> f32x16<S> {
        let (samples, fractions) = self.around_patch(simd, x, y);
        between(samples, fractions)
    }

    /// The least and the largest inverse depths of the samples around the 4×4 HR pixels from `(x, y)` on, row by row.
    #[inline(always)]
    pub fn ranges_in_patch<S: Simd>(&self, simd: S, x: isize, y: isize) -> [f32x16<S>; 2] {
        let ([a, b, c, d], _) = self.around_patch(simd, x, y);
        [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))]
    }

    /// Whether any sample around the 4×4 HR pixels from `(x, y)` on moves.
    #[inline(always)]
    pub fn moves_in_patch(&self, x: isize, y: isize) -> bool {
        let places = |places: &[Place], first: isize| {
            let [first, .., last] = places[(first + MARGIN as isize) as usize..][..4] else { unreachable!() };
            first.samples[0] as usize..=last.samples[1] as usize
        };
        let Moving { displacements, rows: moving, .. } = &self.moving;
        !moving.is_empty()
            && places(&self.rows, y).any(|j| {
                let mut columns = places(&self.columns, x);
                moving[j] && columns.any(|i| displacements[j * self.width + i] != [0.0; 3])
            })
    }

    /// The inverse depths of the four samples around the 4×4 HR pixels from `(x, y)` on, row by row, and the pixels'
    /// places among the samples.
    #[inline(always)]
    fn around_patch<S: Simd>(&self, simd: S, x: isize, y: isize) -> ([f32x16<S>; 4], [f32x16<S>; 2]) {
        let columns = &self.columns[(x + MARGIN as isize) as usize..][..4];
        let rows = &self.rows[(y + MARGIN as isize) as usize..][..4];
        if columns[0].samples == columns[3].samples && rows[0].samples == rows[3].samples {
            let [left, right] = columns[0].samples.map(|i| i as usize);
            let above = &self.inverse[rows[0].samples[0] as usize * self.width..][..self.width];
            let below = &self.inverse[rows[0].samples[1] as usize * self.width..][..self.width];
            let samples = [
                f32x16::splat(simd, above[left]),
                f32x16::splat(simd, above[right]),
                f32x16::splat(simd, below[left]),
                f32x16::splat(simd, below[right]),
            ];
            let of_columns = [0, 1, 2, 3].map(|k| columns[k].fraction);
            let of_rows = [0, 1, 2, 3].map(|k| rows[k].fraction);
            return (samples, [repeat(simd, &of_columns), spread(simd, &of_rows)]);
        }
        let (mut found, mut fractions) = ([[0.0; 16]; 4], [[0.0; 16]; 2]);
        for (r, row) in rows.iter().enumerate() {
            let [above, below] = row.samples.map(|j| &self.inverse[j as usize * self.width..][..self.width]);
            for (c, column) in columns.iter().enumerate() {
                let ([left, right], k) = (column.samples.map(|i| i as usize), 4 * r + c);
                (fractions[0][k], fractions[1][k]) = (column.fraction, row.fraction);
                (found[0][k], found[1][k]) = (above[left], above[right]);
                (found[2][k], found[3][k]) = (below[left], below[right]);
            }
        }
        (load_all(simd, &found), load_all(simd, &fractions))
    }

    /// Where the sixteen samples from column `first` of row `row` on, with inverse depths `w`, land: their places
    /// among the pixels, −1 for none, and their inverse depths there.
    #[inline(always)]
    fn target_pixels<S: Simd>(
        &self,
        simd: S,
        splatter: &Splatter<'_>,
        [first, row]: [usize; 2],
        depths: &[f32],
    ) -> ([i32; 16], [f32; 16]) {
        let splat = |v: f32| f32x16::splat(simd, v);
        let Splatter { neighbor, reprojection, scale, .. } = splatter;
        let lanes = f32x16::load_array(simd, std::array::from_fn(|k| k as f32 + 0.5 + neighbor.jitter[0]));
        let (width, height) = (splat(self.width as f32), splat(self.height as f32));
        let y = (row as f32 + 0.5 + neighbor.jitter[1]) * scale;
        let mut padded = [0.0; 16];
        padded[..depths.len()].copy_from_slice(depths);
        let w = f32x16::load_array(simd, padded);
        let x = (lanes + splat(first as f32)) * splat(*scale);
        let at = row * self.width + first;
        let [u, v, q] = match splatter.moved(simd, at, depths.len()) {
            None => reprojection.apply_16(simd, x, splat(y), w),
            Some(moved) => reprojection.apply_moved_16(simd, x, splat(y), w, moved),
        };
        let (u, v) = (u * splat(1.0 / scale), v * splat(1.0 / scale));
        let is_inside = q.simd_gt(splat(MIN_DIVISOR))
            & u.simd_ge(splat(0.0))
            & v.simd_ge(splat(0.0))
            & u.simd_lt(width)
            & v.simd_lt(height);
        let (i, j): (i32x16<S>, i32x16<S>) = (u.floor().to_int(), v.floor().to_int());
        let cells = j * i32x16::splat(simd, self.width as i32) + i;
        let cells = is_inside.select(cells, i32x16::splat(simd, -1)).to_array();
        (cells, (w / q).to_array())
    }

    /// Splats row `row` of samples.
    #[inline(always)]
    fn splat<S: Simd>(&self, simd: S, splatter: &Splatter<'_>, row: usize, depths: &[f32]) {
        for (run, depths) in depths.chunks(16).enumerate() {
            let (cells, nearness) = self.target_pixels(simd, splatter, [16 * run, row], depths);
            for k in 0..depths.len() {
                // −1 is no place.
                let Some(nearest) = self.splatted.get(cells[k] as usize) else { continue };
                let bits = encode(nearness[k]);
                // The largest value wins in any order, so the result does not depend on the threads.
                if bits > nearest.load(Relaxed) {
                    nearest.fetch_max(bits, Relaxed);
                }
            }
        }
    }

    /// Records the pixels where moving samples of row `row` are the nearest, once all samples are splatted. The
    /// neighbour's first sample has number `base`.
    #[inline(always)]
    fn claim<S: Simd>(&self, simd: S, splatter: &Splatter<'_>, row: usize, depths: &[f32], base: usize) {
        let Some((displacements, _)) = splatter.moving else { return };
        for (run, depths) in depths.chunks(16).enumerate() {
            let first = row * self.width + 16 * run;
            let displacements = &displacements[first..first + depths.len()];
            if displacements.iter().all(|displacement| *displacement == [0.0; 3]) {
                continue;
            }
            let (cells, nearness) = self.target_pixels(simd, splatter, [16 * run, row], depths);
            for k in (0..depths.len()).filter(|k| displacements[*k] != [0.0; 3]) {
                let at = cells[k] as usize;
                // −1 is no place.
                let Some(nearest) = self.splatted.get(at) else { continue };
                if nearest.load(Relaxed) == encode(nearness[k]) {
                    self.moving.nearest[at].fetch_max((base + first + k + 1) as u32, Relaxed);
                }
            }
        }
    }

    /// Fills LR pixels without a sample with the farthest depth beside them, ring by ring from the rims inwards. A
    /// ring reads only values filled before it, so the order within a ring does not matter.
    fn fill_holes(&mut self) {
        let Self { width, height, ref mut inverse, ref mut ring, ref mut next, ref mut moving, .. } = *self;
        let around = |k: usize| {
            let (x, y) = (k % width, k / width);
            let columns = x.saturating_sub(1)..(x + 2).min(width);
            (y.saturating_sub(1)..(y + 2).min(height))
                .flat_map(move |j| columns.clone().map(move |i| j * width + i))
        };
        ring.clear();
        let holes = inverse.iter().enumerate().filter(|(_, w)| **w < 0.0).map(|(k, _)| k);
        ring.extend(holes.filter(|&k| around(k).any(|n| inverse[n] >= 0.0)).map(|k| (k, k)));
        if ring.is_empty() && inverse.first().is_some_and(|w| *w < 0.0) {
            // There is no sample at all: everything is infinitely far.
            inverse.fill(0.0);
        }
        while !ring.is_empty() {
            for (k, farthest) in ring.iter_mut() {
                let known = around(*k).filter(|n| inverse[*n] >= 0.0);
                if let Some(n) = known.min_by(|a, b| inverse[*a].total_cmp(&inverse[*b])) {
                    *farthest = n;
                }
            }
            for &(k, farthest) in ring.iter() {
                inverse[k] = inverse[farthest];
                if !moving.displacements.is_empty() {
                    moving.displacements[k] = moving.displacements[farthest];
                }
            }
            next.clear();
            for &(k, _) in ring.iter() {
                for n in around(k) {
                    if inverse[n] == UNREACHED {
                        inverse[n] = QUEUED;
                        next.push((n, n));
                    }
                }
            }
            std::mem::swap(ring, next);
        }
    }
}

/// Finds the places of all HR columns (or rows) for `len` samples `scale` apart, and of [`MARGIN`] more on either
/// side.
fn set_places(places: &mut Vec<Place>, len: usize, scale: usize) {
    places.clear();
    places.extend((0..len * scale + 2 * MARGIN).map(|k| {
        let x = k.saturating_sub(MARGIN).min(len * scale - 1);
        // Cell c lies between samples c − 1 and c.
        let (cell, phase) = ((x + scale - scale / 2) / scale, (x + scale - scale / 2) % scale);
        let samples = [cell.saturating_sub(1), cell].map(|i| i.min(len - 1) as u32);
        let fraction = (phase as f32 + 0.5 + (scale / 2) as f32) / scale as f32 - 0.5;
        Place { samples, fraction }
    }));
}

/// Inverse depths between the samples `a b` above and `c d` below, at `(x, y)` of the way: linear within a surface,
/// and the nearest sample's at an edge.
#[inline(always)]
fn between<S: Simd>([a, b, c, d]: [f32x16<S>; 4], [x, y]: [f32x16<S>; 2]) -> f32x16<S> {
    let (far, near) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
    between_of((near - far).simd_le(near * SAME_SURFACE), [a, b, c, d], [x, y])
}

/// The same for any values, with `of_surface` true where the samples are one surface.
#[inline(always)]
fn between_of<S: Simd>(
    of_surface: mask32x16<S>,
    [a, b, c, d]: [f32x16<S>; 4],
    [x, y]: [f32x16<S>; 2],
) -> f32x16<S> {
    let (left, right) = ((c - a).mul_add(y, a), (d - b).mul_add(y, b));
    let linear = (right - left).mul_add(x, left);
    let is_above = y.simd_lt(0.5);
    let (left, right) = (is_above.select(a, c), is_above.select(b, d));
    let nearest = x.simd_lt(0.5).select(left, right);
    of_surface.select(linear, nearest)
}

/// The largest of four values less the smallest.
#[inline(always)]
fn spread_of<S: Simd>([a, b, c, d]: &[f32x16<S>; 4]) -> f32x16<S> {
    a.max(*b).max(c.max(*d)) - a.min(*b).min(c.min(*d))
}

impl Splatter<'_> {
    /// Displacements to the in-between frame of the `count` samples from sample `first` on; none if nothing moves.
    #[inline(always)]
    fn moved<S: Simd>(&self, simd: S, first: usize, count: usize) -> Option<[f32x16<S>; 3]> {
        let (displacements, share) = self.moving?;
        let displacements = &displacements[first..first + count];
        if displacements.iter().all(|displacement| *displacement == [0.0; 3]) {
            return None;
        }
        let mut moved = [[0.0; 16]; 3];
        for (k, displacement) in displacements.iter().enumerate() {
            moved.iter_mut().zip(displacement).for_each(|(moved, d)| moved[k] = share * d);
        }
        let [x, y, z] = load_all(simd, &moved);
        Some([x, y, z])
    }
}

/// No sample.
const HOLE: u32 = 0;

/// Orders inverse depths (≥ 0) as integers above [`HOLE`]: the bits of non-negative floats are ordered like them.
#[inline(always)]
fn encode(w: f32) -> u32 {
    w.max(0.0).to_bits() + 1
}

/// Stands for the inverse depth of a hole.
const UNREACHED: f32 = -1.0;

/// Stands for the inverse depth of a hole that is to be filled next.
const QUEUED: f32 = -2.0;

/// [`UNREACHED`] for [`HOLE`], else the inverse depth.
#[inline(always)]
fn decode(bits: u32) -> f32 {
    if bits == HOLE { UNREACHED } else { f32::from_bits(bits - 1) }
}
