//! A frame between two reconstructed frames, at its true pose, without learning.
//!
//! Depth forward, colour backward: the depths of both neighbours are splatted to the middle pose on the LR grid (nearest
//! wins), holes take the farthest depth beside them, and every HR pixel then gathers its colour from both HR neighbours,
//! blended by visibility and time.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Level, Simd, dispatch};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, camera_size, check_gbuffer, check_scale, check_size, image_size};
use crate::gather::gather;
use crate::reprojection::{Reprojection, inverse_depth};

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

/// HR pixels that one task reprojects before it gathers.
const RUN: usize = 64;

/// Interpolates frames between two neighbours.
#[derive(Debug)]
pub struct Interpolator {
    scale: u32,
    level: Level,
    /// Nearest inverse depth at the middle pose, as [`encode`]d bits, on the LR grid.
    splatted: Vec<AtomicU32>,
    /// The same without holes.
    middle: DepthGrid,
    /// Inverse median depths of the neighbours.
    neighbors: [DepthGrid; 2],
    /// LR pixels that no sample reached.
    holes: Vec<u32>,
}

/// Inverse depths of an LR grid whose samples lie `jitter` off the pixel centres.
#[derive(Debug, Default)]
struct DepthGrid {
    width: usize,
    height: usize,
    jitter: [f32; 2],
    inverse: Vec<f32>,
}

impl DepthGrid {
    /// The four inverse depths around HR position `(x, y)` (pixel centres at whole numbers), and where it lies between.
    #[inline(always)]
    fn around(&self, x: f32, y: f32, per_scale: f32) -> ([f32; 4], [f32; 2]) {
        let place = |x: f32, jitter: f32, len: usize| {
            let u = ((x + 0.5) * per_scale - 0.5 - jitter).clamp(0.0, (len - 1) as f32);
            let i = u as usize;
            (i, (i + 1).min(len - 1), u - i as f32)
        };
        let (i0, i1, fx) = place(x, self.jitter[0], self.width);
        let (j0, j1, fy) = place(y, self.jitter[1], self.height);
        let at = |i: usize, j: usize| self.inverse[j * self.width + i];
        ([at(i0, j0), at(i1, j0), at(i0, j1), at(i1, j1)], [fx, fy])
    }
}

/// Relative difference of inverse depths up to which they belong to one surface.
const SAME_SURFACE: f32 = 0.02;

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
            splatted: Vec::new(),
            middle: DepthGrid::default(),
            neighbors: [DepthGrid::default(), DepthGrid::default()],
            holes: Vec::new(),
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
        for (grid, neighbor) in self.neighbors.iter_mut().zip([&before, &after]) {
            let Some(geometry) = &neighbor.gbuffer.geometry else {
                return Err(ReconstructError::Missing { what: "depth" });
            };
            (grid.width, grid.height) = (neighbor.gbuffer.width(), neighbor.gbuffer.height());
            grid.jitter = neighbor.gbuffer.jitter;
            grid.inverse.clear();
            grid.inverse.extend(geometry.depth_median.data().iter().map(|&z| inverse_depth(z)));
        }
        self.splat(&before, &after, camera);
        self.fill_holes();
        out.resize(size.0, size.1);
        let reprojections = [&before, &after].map(|n| Reprojection::new(camera, n.camera));
        let images = [before.image, after.image];
        out.pixels_mut().par_chunks_exact_mut(size.0).enumerate().with_min_len(8).for_each(|(y, row)| {
            dispatch!(self.level, simd => self.fill_row(simd, y, &reprojections, images, t, row));
        });
        Ok(())
    }

    /// Splats the depths of both neighbours to the middle pose.
    fn splat(&mut self, before: &Neighbor<'_>, after: &Neighbor<'_>, camera: &Camera) {
        let (width, height) = (before.gbuffer.width(), before.gbuffer.height());
        self.splatted.clear();
        self.splatted.resize_with(width * height, || AtomicU32::new(HOLE));
        let scale = self.scale as f32;
        let splatted = &self.splatted;
        for (grid, neighbor) in self.neighbors.iter().zip([before, after]) {
            let reprojection = Reprojection::new(neighbor.camera, camera);
            grid.inverse.par_chunks_exact(width).enumerate().with_min_len(8).for_each(|(row, depths)| {
                let y = (row as f32 + 0.5 + grid.jitter[1]) * scale;
                for (i, &w) in depths.iter().enumerate() {
                    let x = (i as f32 + 0.5 + grid.jitter[0]) * scale;
                    let (u, v, q) = reprojection.apply(x, y, w);
                    let (u, v) = (u / scale, v / scale);
                    if q > 1e-6 && u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32 {
                        // The largest wins, whichever comes first: the result does not depend on the threads.
                        splatted[v as usize * width + u as usize].fetch_max(encode(w / q), Relaxed);
                    }
                }
            });
        }
    }

    /// Fills LR pixels that no sample reached with the farthest depth beside them, ring by ring.
    fn fill_holes(&mut self) {
        let (width, height) = (self.neighbors[0].width, self.neighbors[0].height);
        let grid = &mut self.middle;
        (grid.width, grid.height) = (width, height);
        grid.inverse.clear();
        grid.inverse.extend(self.splatted.iter().map(|v| decode(v.load(Relaxed))));
        self.holes.clear();
        self.holes.extend((0..grid.inverse.len() as u32).filter(|&k| grid.inverse[k as usize] < 0.0));
        let mut filled = Vec::new();
        while !self.holes.is_empty() {
            filled.clear();
            self.holes.retain(|&k| {
                let (x, y) = (k as usize % width, k as usize / width);
                let mut farthest = f32::INFINITY;
                for j in y.saturating_sub(1)..(y + 2).min(height) {
                    for i in x.saturating_sub(1)..(x + 2).min(width) {
                        let w = grid.inverse[j * width + i];
                        if w >= 0.0 {
                            farthest = farthest.min(w);
                        }
                    }
                }
                if farthest < f32::INFINITY {
                    filled.push((k, farthest));
                }
                farthest == f32::INFINITY
            });
            if filled.is_empty() {
                // Nothing was seen at all: everything is as far as can be.
                grid.inverse.fill(0.0);
                break;
            }
            for &(k, w) in &filled {
                grid.inverse[k as usize] = w;
            }
        }
    }

    #[inline(always)]
    fn fill_row<S: Simd>(
        &self,
        simd: S,
        y: usize,
        reprojections: &[Reprojection; 2],
        images: [&Image; 2],
        t: f32,
        out: &mut [[f32; 4]],
    ) {
        let per_scale = 1.0 / self.scale as f32;
        for (run, pixels) in out.chunks_mut(RUN).enumerate() {
            let first = run * RUN;
            let mut depths = [0.0; RUN];
            for (k, depth) in depths.iter_mut().enumerate() {
                *depth = self.middle_depth((first + k) as f32, y as f32, per_scale);
            }
            let mut places = [[[0.0; RUN]; 3]; 2];
            for (place, reprojection) in places.iter_mut().zip(reprojections) {
                let [us, vs, ws] = place;
                for k in 0..RUN {
                    let (u, v, q) = reprojection.apply((first + k) as f32 + 0.5, y as f32 + 0.5, depths[k]);
                    (us[k], vs[k]) = (u - 0.5, v - 0.5);
                    ws[k] = if q > 1e-6 { depths[k] / q } else { -1.0 };
                }
            }
            for (k, pixel) in pixels.iter_mut().enumerate() {
                let mut weights = [1.0 - t, t];
                for n in 0..2 {
                    let [u, v, w] = [places[n][0][k], places[n][1][k], places[n][2][k]];
                    weights[n] *= self.visibility(&self.neighbors[n], images[n], u, v, w, per_scale);
                }
                let sum = weights[0] + weights[1];
                let mut color = [0.0; 4];
                for n in 0..2 {
                    let weight = weights[n] / sum;
                    if weight > 0.0 {
                        let [u, v] = [places[n][0][k], places[n][1][k]];
                        let value = gather(simd, images[n], u, v);
                        for c in 0..4 {
                            color[c] += weight * value[c];
                        }
                    }
                }
                *pixel = color;
            }
        }
    }

    /// Inverse depth of the middle frame at HR pixel `(x, y)`: linear within a surface, the nearest sample's at an edge.
    #[inline(always)]
    fn middle_depth(&self, x: f32, y: f32, per_scale: f32) -> f32 {
        let (w, [fx, fy]) = self.middle.around(x, y, per_scale);
        let far = w[0].min(w[1]).min(w[2]).min(w[3]);
        let near = w[0].max(w[1]).max(w[2]).max(w[3]);
        if near - far <= SAME_SURFACE * near {
            let (top, bottom) = (w[0] + (w[1] - w[0]) * fx, w[2] + (w[3] - w[2]) * fx);
            top + (bottom - top) * fy
        } else {
            w[usize::from(fx >= 0.5) + 2 * usize::from(fy >= 0.5)]
        }
    }

    /// How far a neighbour sees the point at its position `(u, v)` and inverse depth `w`: 1 visible, near 0 hidden or
    /// outside.
    #[inline(always)]
    fn visibility(&self, grid: &DepthGrid, image: &Image, u: f32, v: f32, w: f32, per_scale: f32) -> f32 {
        const UNSEEN: f32 = 1e-3;
        let inside = w >= 0.0
            && u >= -0.5
            && v >= -0.5
            && u <= image.width() as f32 - 0.5
            && v <= image.height() as f32 - 0.5;
        if !inside {
            return UNSEEN * UNSEEN;
        }
        let (d, _) = grid.around(u, v, per_scale);
        let far = d[0].min(d[1]).min(d[2]).min(d[3]);
        let near = d[0].max(d[1]).max(d[2]).max(d[3]);
        if w >= far * (1.0 - SAME_SURFACE) && w <= near * (1.0 + SAME_SURFACE) { 1.0 } else { UNSEEN }
    }
}

/// No sample.
const HOLE: u32 = 0;

/// Orders inverse depths (≥ 0) as integers above [`HOLE`]: the bits of non-negative floats are ordered like them.
#[inline(always)]
fn encode(w: f32) -> u32 {
    w.max(0.0).to_bits() + 1
}

/// −1 for [`HOLE`].
#[inline(always)]
fn decode(bits: u32) -> f32 {
    if bits == HOLE { -1.0 } else { f32::from_bits(bits - 1) }
}
