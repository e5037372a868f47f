//! A frame between two reconstructed frames, at its true pose, without learning.
//!
//! Depth forward, colour backward: the depths of both neighbours are splatted to the middle pose on the LR grid (nearest
//! wins), holes take the farthest depth beside them, and every HR pixel then gathers its colour from both HR neighbours,
//! blended by visibility and time.
//!
//! Depths, positions and weights are made for a block of pixels at a time, sixteen lanes wide. Four pixels in a row that
//! move alike are gathered at once; the others one by one.

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, camera_size, check_gbuffer, check_scale, check_size, image_size};
use crate::gather::{Gather, QUAD, UNITS, sum_of_pixels};
use crate::middle_depth::MiddleDepth;
use crate::neighbor_depth::{HIDDEN, NeighborDepth, SAME_SURFACE};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// A reconstructed frame beside the one to be interpolated.
#[derive(Clone, Copy, Debug)]
pub struct Neighbor<'a> {
    /// The camera of `image`.
    pub camera: &'a Camera,
    /// The HR frame.
    pub image: &'a Image,
    /// The LR frame it was reconstructed from, with geometry.
    pub gbuffer: &'a GBuffer,
}

/// Pixels of a block: few enough that what is made for them stays in the first-level cache.
const BLOCK: usize = 64;

const LANES: usize = 16;

/// Rows of pixels that a task makes block by block, so that the rows they gather from are still in the first-level cache.
const BAND: usize = 8;

/// Four pixels whose displacements lie within this many pixels, along x and along y, are gathered at once, moved by the
/// middle of the displacements. The largest error, half of it, is 1/32 px; on real scenes it costs no more than 0.001 dB.
const RIGID: f32 = 1.0 / 16.0;

/// Weights that do not show in the finest of displays.
const NEGLIGIBLE: f32 = 1e-4;

/// Interpolates frames between two neighbours.
#[derive(Debug)]
pub struct Interpolator {
    scale: u32,
    level: Level,
    gather: Gather,
    middle: MiddleDepth,
    neighbors: [NeighborDepth; 2],
}

/// All that rows are made from.
struct Warp<'a> {
    scale: usize,
    t: f32,
    gather: &'a Gather,
    middle: &'a MiddleDepth,
    depths: &'a [NeighborDepth; 2],
    images: [&'a Image; 2],
    reprojections: [Reprojection; 2],
}

/// Where the pixels of a block are found in the neighbours, and how they are blended.
struct Block {
    /// Fixed-point x and y per neighbour; the first of a rigid quad's is its place.
    places: [[[i32; BLOCK]; 2]; 2],
    /// Weights per neighbour.
    weights: [[f32; BLOCK]; 2],
    /// 1 where the four pixels of a quad move alike and are blended alike, else 0.
    rigid: [f32; BLOCK],
}

impl Interpolator {
    /// An interpolator for frames `scale` times (1 to [`crate::MAX_SCALE`]) the size of their G-buffers.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if `scale` is not supported.
    pub fn new(scale: u32) -> Result<Self, ReconstructError> {
        check_scale(scale)?;
        Ok(Self {
            scale,
            level: Level::new(),
            gather: Gather::new(),
            middle: MiddleDepth::default(),
            neighbors: [NeighborDepth::default(), NeighborDepth::default()],
        })
    }

    /// Interpolates what `camera` sees at time `t` ∈ `[0, 1]` between `before` (0) and `after` (1) into `out`, which is
    /// resized. The fourth channel is the blended one of the neighbours.
    ///
    /// # Errors
    /// [`ReconstructError`] if sizes do not match `camera`, geometry is missing or `t` is outside.
    pub fn interpolate(
        &mut self,
        before: Neighbor<'_>,
        after: Neighbor<'_>,
        t: f32,
        camera: &Camera,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        let size = camera_size(camera);
        if !(0.0..=1.0).contains(&t) {
            return Err(ReconstructError::Time { actual: t });
        }
        for neighbor in [&before, &after] {
            check_size("neighbour camera", size, camera_size(neighbor.camera))?;
            check_size("neighbour image", size, image_size(neighbor.image))?;
            check_gbuffer(neighbor.gbuffer, self.scale, size)?;
        }
        for (depth, neighbor) in self.neighbors.iter_mut().zip([&before, &after]) {
            let Some(geometry) = &neighbor.gbuffer.geometry else {
                return Err(ReconstructError::Missing { what: "depth" });
            };
            depth.set(neighbor.gbuffer, geometry);
        }
        self.middle.set(self.level, &self.neighbors, [before.camera, after.camera], camera, self.scale);
        let warp = Warp {
            scale: self.scale as usize,
            t,
            gather: &self.gather,
            middle: &self.middle,
            depths: &self.neighbors,
            images: [before.image, after.image],
            reprojections: [&before, &after].map(|n| Reprojection::new(camera, n.camera)),
        };
        out.resize(size.0, size.1);
        out.pixels_mut().par_chunks_mut(size.0 * BAND).enumerate().for_each(|(band, rows)| {
            dispatch!(self.level, simd => warp.fill_band(simd, band * BAND, rows));
        });
        Ok(())
    }
}

impl Warp<'_> {
    /// Fills whole rows of pixels from row `top` on.
    #[inline(always)]
    fn fill_band<S: Simd>(&self, simd: S, top: usize, rows: &mut [[f32; 4]]) {
        let width = self.images[0].width();
        let mut depths = [0.0; BLOCK];
        let mut block =
            Block { places: [[[0; BLOCK]; 2]; 2], weights: [[0.0; BLOCK]; 2], rigid: [0.0; BLOCK] };
        for x in (0..width).step_by(BLOCK) {
            for (y, row) in (top..).zip(rows.chunks_exact_mut(width)) {
                self.middle_depths(x, y, &mut depths);
                self.place(simd, x, y, &depths, &mut block);
                let end = (x + BLOCK).min(width);
                self.gather(simd, &block, &mut row[x..end]);
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

    /// Where the block's pixels are found in the neighbours, and with which weights they are blended.
    #[inline(always)]
    fn place<S: Simd>(&self, simd: S, x: usize, y: usize, depths: &[f32; BLOCK], block: &mut Block) {
        let splat = |v: f32| f32x16::splat(simd, v);
        let lanes = f32x16::load_array(simd, std::array::from_fn(|k| k as f32));
        for from in (0..BLOCK).step_by(LANES) {
            let depth = f32x16::from_slice(simd, &depths[from..from + LANES]);
            let x = lanes + splat((x + from) as f32);
            let mut spread = splat(0.0);
            let mut weights = [splat(1.0 - self.t), splat(self.t)];
            for n in 0..2 {
                let [u, v, w] = self.reproject(simd, n, x, y as f32, depth);
                weights[n] *= self.visibility(simd, n, [u, v, w]);
                // Displacements within the quad.
                let mut place = [u, v];
                for (position, pixel) in place.iter_mut().zip([x, splat(y as f32)]) {
                    let moved = *position - pixel;
                    let (least, most) = extremes(moved);
                    spread = spread.max(most - least);
                    let common = (least + most) * splat(0.5);
                    let is_rigid = (most - least).simd_le(splat(RIGID));
                    *position = is_rigid.select(common + pixel, *position);
                }
                for (position, out) in place.into_iter().zip(&mut block.places[n]) {
                    let units: i32x16<S> = position.mul_add(splat(UNITS), splat(0.5)).floor().to_int();
                    units.store_slice(&mut out[from..from + LANES]);
                }
            }
            let share = weights[1] / (weights[0] + weights[1]);
            let share = share.simd_lt(splat(NEGLIGIBLE)).select(splat(0.0), share);
            let share = share.simd_gt(splat(1.0 - NEGLIGIBLE)).select(splat(1.0), share);
            let (least, most) = extremes(share);
            let is_rigid = spread.simd_le(splat(RIGID)) & least.simd_eq(most);
            (splat(1.0) - share).store_slice(&mut block.weights[0][from..from + LANES]);
            share.store_slice(&mut block.weights[1][from..from + LANES]);
            is_rigid.select(splat(1.0), splat(0.0)).store_slice(&mut block.rigid[from..from + LANES]);
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

    #[inline(always)]
    fn gather<S: Simd>(&self, simd: S, block: &Block, out: &mut [[f32; 4]]) {
        for (quad, pixels) in out.chunks_mut(QUAD).enumerate() {
            let first = quad * QUAD;
            if block.rigid[first] == 0.0
                || pixels.len() < QUAD
                || !self.gather_quad(simd, block, first, pixels)
            {
                for (k, pixel) in (first..).zip(pixels) {
                    let mut sum = f32x16::splat(simd, 0.0);
                    for n in 0..2 {
                        let weight = block.weights[n][k];
                        if weight > 0.0 {
                            let [x, y] = &block.places[n];
                            sum += self.gather.pixel(simd, self.images[n], [x[k], y[k]], weight);
                        }
                    }
                    *pixel = sum_of_pixels(sum);
                }
            }
        }
    }

    /// Whether all the quad needs is inside the neighbours; if not, nothing has been written.
    #[inline(always)]
    fn gather_quad<S: Simd>(&self, simd: S, block: &Block, first: usize, pixels: &mut [[f32; 4]]) -> bool {
        let mut sum = f32x16::splat(simd, 0.0);
        for n in 0..2 {
            let weight = block.weights[n][first];
            if weight > 0.0 {
                let [x, y] = &block.places[n];
                let Some(quad) = self.gather.quad(simd, self.images[n], [x[first], y[first]]) else {
                    return false;
                };
                sum = quad.mul_add(f32x16::splat(simd, weight), sum);
            }
        }
        sum.store_slice(pixels.as_flattened_mut());
        true
    }
}

/// The least and the largest of every four lanes, in all of them.
#[inline(always)]
fn extremes<S: Simd>(v: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let turned = v.slide_within_blocks::<1>(v);
    let (least, most) = (v.min(turned), v.max(turned));
    (least.min(least.slide_within_blocks::<2>(least)), most.max(most.slide_within_blocks::<2>(most)))
}
