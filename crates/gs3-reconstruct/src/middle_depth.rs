//! The depths of two neighbours, seen from the pose between them.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::Camera;
use rayon::prelude::*;

use crate::neighbor_depth::NeighborDepth;
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// Inverse depths at the pixel centres of the LR grid of the middle frame.
#[derive(Debug, Default)]
pub(crate) struct MiddleDepth {
    pub width: usize,
    pub height: usize,
    /// `[height, width]`, ≥ 0.
    pub inverse: Vec<f32>,
    /// The nearest inverse depth splatted, as [`encode`]d bits.
    splatted: Vec<AtomicU32>,
    /// Holes being filled, and the depths they get.
    ring: Vec<(usize, f32)>,
    /// The holes beside those.
    next: Vec<(usize, f32)>,
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
            let [u, v, q] = reprojection.apply_16(simd, x, y, w);
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

    /// Fills LR pixels that no sample reached with the farthest depth beside them, ring by ring from the rims inwards. A
    /// ring reads only what was filled before it, so that the order within it does not matter.
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
