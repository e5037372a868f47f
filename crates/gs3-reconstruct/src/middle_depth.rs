//! The depths of two neighbours, seen from the pose between them.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::Camera;
use rayon::prelude::*;

use crate::lanes::{repeat, spread};
use crate::neighbor_depth::NeighborDepth;
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE};

/// Inverse depths at the pixel centres of the LR grid of the middle frame.
#[derive(Debug, Default)]
pub(crate) struct MiddleDepth {
    pub width: usize,
    pub height: usize,
    scale: usize,
    /// `[height, width]`, ≥ 0.
    pub inverse: Vec<f32>,
    /// Where HR columns are among the samples, from column −[`MARGIN`] on.
    columns: Vec<Place>,
    /// The same for rows.
    rows: Vec<Place>,
    /// The nearest inverse depth splatted, as [`encode`]d bits.
    splatted: Vec<AtomicU32>,
    /// Holes being filled, and the depths they get.
    ring: Vec<(usize, f32)>,
    /// The holes beside those.
    next: Vec<(usize, f32)>,
}

/// HR columns and rows outside the image whose depths may be asked for, on either side. They are those at the border.
const MARGIN: usize = 64;

/// Where an HR column or row is: between two samples, which are one outside of the first and the last.
#[derive(Clone, Copy, Debug)]
struct Place {
    samples: [u32; 2],
    /// `[0, 1)` of the way.
    fraction: f32,
}

impl MiddleDepth {
    /// Splats the depths of both neighbours to `camera` (nearest wins) and fills the holes.
    pub fn set(
        &mut self,
        level: Level,
        neighbors: &[NeighborDepth; 2],
        cameras: [&Camera; 2],
        camera: &Camera,
        scale: u32,
    ) {
        (self.width, self.height) = (neighbors[0].width, neighbors[0].height);
        self.scale = scale as usize;
        set_places(&mut self.columns, self.width, scale as usize);
        set_places(&mut self.rows, self.height, scale as usize);
        self.splatted.resize_with(self.width * self.height, || AtomicU32::new(HOLE));
        self.splatted.par_iter_mut().with_min_len(1 << 14).for_each(|v| *v.get_mut() = HOLE);
        for (neighbor, from) in neighbors.iter().zip(cameras) {
            let reprojection = Reprojection::new(from, camera);
            let rows = neighbor.inverse.par_chunks_exact(self.width).enumerate().with_min_len(8);
            rows.for_each(|(row, depths)| {
                let y = (row as f32 + 0.5 + neighbor.jitter[1]) * scale as f32;
                dispatch!(level, simd => self.splat(simd, depths, neighbor.jitter[0], y, &reprojection, scale as f32));
            });
        }
        self.inverse.resize(self.splatted.len(), 0.0);
        let inverse = self.inverse.par_iter_mut().zip(&self.splatted).with_min_len(1 << 14);
        inverse.for_each(|(inverse, bits)| *inverse = decode(bits.load(Relaxed)));
        self.fill_holes();
    }

    /// Inverse depths at the sixteen HR pixels in row `y` from column `x` on, `step` apart.
    #[inline(always)]
    pub fn along_row<S: Simd>(&self, simd: S, x: isize, step: usize, y: isize) -> f32x16<S> {
        let Place { samples: rows, fraction } = self.rows[(y + MARGIN as isize) as usize];
        let above = &self.inverse[rows[0] as usize * self.width..][..self.width];
        let below = &self.inverse[rows[1] as usize * self.width..][..self.width];
        let places = &self.columns[(x + MARGIN as isize) as usize..];
        // Sixteen cells in a row, as at scale 4, all but at the borders.
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
            return between(samples, [repeat(simd, &of_columns), spread(simd, &of_rows)]);
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
        between(load_all(simd, &found), load_all(simd, &fractions))
    }

    /// Splats a row of samples at HR height `y`.
    #[inline(always)]
    fn splat<S: Simd>(
        &self,
        simd: S,
        depths: &[f32],
        jitter: f32,
        y: f32,
        reprojection: &Reprojection,
        scale: f32,
    ) {
        let splat = |v: f32| f32x16::splat(simd, v);
        let lanes = f32x16::load_array(simd, std::array::from_fn(|k| k as f32 + 0.5 + jitter));
        let (width, height) = (splat(self.width as f32), splat(self.height as f32));
        for (run, depths) in depths.chunks(16).enumerate() {
            let mut padded = [0.0; 16];
            padded[..depths.len()].copy_from_slice(depths);
            let w = f32x16::load_array(simd, padded);
            let x = (lanes + splat((16 * run) as f32)) * splat(scale);
            let [u, v, q] = reprojection.apply_16(simd, x, splat(y), w);
            let (u, v) = (u * splat(1.0 / scale), v * splat(1.0 / scale));
            let is_inside = q.simd_gt(splat(MIN_DIVISOR))
                & u.simd_ge(splat(0.0))
                & v.simd_ge(splat(0.0))
                & u.simd_lt(width)
                & v.simd_lt(height);
            let (i, j): (i32x16<S>, i32x16<S>) = (u.floor().to_int(), v.floor().to_int());
            let cells = j * i32x16::splat(simd, self.width as i32) + i;
            let cells = is_inside.select(cells, i32x16::splat(simd, -1)).to_array();
            let nearness = (w / q).to_array();
            for k in 0..depths.len() {
                // −1 is no place.
                let Some(nearest) = self.splatted.get(cells[k] as usize) else { continue };
                let bits = encode(nearness[k]);
                // The largest wins, whichever comes first: the result does not depend on the threads.
                if bits > nearest.load(Relaxed) {
                    nearest.fetch_max(bits, Relaxed);
                }
            }
        }
    }

    /// Fills LR pixels that no sample reached with the farthest depth beside them, ring by ring from the rims
    /// inwards. A ring reads only what was filled before it, so that the order within it does not matter.
    fn fill_holes(&mut self) {
        let Self { width, height, ref mut inverse, ref mut ring, ref mut next, .. } = *self;
        let around = |k: usize| {
            let (x, y) = (k % width, k / width);
            let columns = x.saturating_sub(1)..(x + 2).min(width);
            (y.saturating_sub(1)..(y + 2).min(height))
                .flat_map(move |j| columns.clone().map(move |i| j * width + i))
        };
        ring.clear();
        let holes = inverse.iter().enumerate().filter(|(_, w)| **w < 0.0).map(|(k, _)| k);
        ring.extend(holes.filter(|&k| around(k).any(|n| inverse[n] >= 0.0)).map(|k| (k, 0.0)));
        if ring.is_empty() && inverse.first().is_some_and(|w| *w < 0.0) {
            // Nothing was seen at all: everything is as far as can be.
            inverse.fill(0.0);
        }
        while !ring.is_empty() {
            for (k, farthest) in ring.iter_mut() {
                *farthest =
                    around(*k).map(|n| inverse[n]).filter(|w| *w >= 0.0).fold(f32::INFINITY, f32::min);
            }
            for &(k, farthest) in ring.iter() {
                inverse[k] = farthest;
            }
            next.clear();
            for &(k, _) in ring.iter() {
                for n in around(k) {
                    if inverse[n] == UNREACHED {
                        inverse[n] = QUEUED;
                        next.push((n, 0.0));
                    }
                }
            }
            std::mem::swap(ring, next);
        }
    }
}

/// Finds the places of all HR columns (or rows) of `len` samples `scale` apart, and of [`MARGIN`] more on either side.
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

/// Vectors of `N` times sixteen values.
#[inline(always)]
fn load_all<S: Simd, const N: usize>(simd: S, values: &[[f32; 16]; N]) -> [f32x16<S>; N] {
    let mut vectors = [f32x16::splat(simd, 0.0); N];
    for (vector, values) in vectors.iter_mut().zip(values) {
        *vector = f32x16::load_array_ref(simd, values);
    }
    vectors
}

/// Inverse depths between the samples `a b` above and `c d` below, `(x, y)` of the way: linear within a surface, the
/// nearest sample's at an edge.
#[inline(always)]
fn between<S: Simd>([a, b, c, d]: [f32x16<S>; 4], [x, y]: [f32x16<S>; 2]) -> f32x16<S> {
    let (far, near) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
    let (left, right) = ((c - a).mul_add(y, a), (d - b).mul_add(y, b));
    let linear = (right - left).mul_add(x, left);
    let is_above = y.simd_lt(0.5);
    let (left, right) = (is_above.select(a, c), is_above.select(b, d));
    let nearest = x.simd_lt(0.5).select(left, right);
    (near - far).simd_le(near * SAME_SURFACE).select(linear, nearest)
}

/// No sample.
const HOLE: u32 = 0;

/// Orders inverse depths (≥ 0) as integers above [`HOLE`]: the bits of non-negative floats are ordered like them.
#[inline(always)]
fn encode(w: f32) -> u32 {
    w.max(0.0).to_bits() + 1
}

/// In place of the inverse depth of a hole.
const UNREACHED: f32 = -1.0;

/// The same, of one that is to be filled next.
const QUEUED: f32 = -2.0;

/// [`UNREACHED`] for [`HOLE`].
#[inline(always)]
fn decode(bits: u32) -> f32 {
    if bits == HOLE { UNREACHED } else { f32::from_bits(bits - 1) }
}
