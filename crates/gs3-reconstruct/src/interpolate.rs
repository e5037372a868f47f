//! A frame between two reconstructed frames, at its true pose, without learning.
//!
//! Depth forward, colour backward: the depths of both neighbours are splatted to the middle pose on the LR grid (nearest
//! wins), holes take the farthest depth beside them, and every HR pixel then gathers its colour from both HR neighbours,
//! blended by visibility and time.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, camera_size, check_gbuffer, check_scale, check_size, image_size};
use crate::gather::Places;
use crate::lattice::{Axis, Place};
use crate::reprojection::{MIN_DIVISOR, Reprojection, inverse_depth};
use crate::resample::clamped;

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

/// Interpolates frames between two neighbours.
#[derive(Debug)]
pub struct Interpolator {
    scale: u32,
    level: Level,
    /// The middle frame's LR pixel centres, along x as along y.
    axis: Axis,
    /// Nearest inverse depth at the middle pose, as [`encode`]d bits, on the LR grid.
    splatted: Vec<AtomicU32>,
    /// The same without holes.
    middle: DepthGrid,
    /// Inverse median depths of the neighbours.
    neighbors: [DepthGrid; 2],
    /// LR pixels that no sample reached: the ring being filled and the next, with the depths they get.
    holes: [Vec<(usize, f32)>; 2],
}

/// Inverse depths of an LR grid whose samples lie `jitter` off the pixel centres.
#[derive(Debug, Default)]
struct DepthGrid {
    width: usize,
    height: usize,
    jitter: [f32; 2],
    inverse: Vec<f32>,
    /// Inverse depths that belong to what is seen between four samples, from and to: `[height, width]`.
    ranges: Vec<[f32; 2]>,
}

impl DepthGrid {
    /// The cells at sixteen HR positions; outside, the nearest. Not finite positions give any cell.
    #[inline(always)]
    fn cell<S: Simd>(&self, x: f32x16<S>, y: f32x16<S>, per_scale: f32) -> [i32; 16] {
        let place = |x: f32x16<S>, axis: usize, len: usize| {
            let u = x * per_scale + (0.5 * per_scale - 0.5 - self.jitter[axis]);
            // In this order, NaN becomes 0.
            u.max(0.0).min((len - 1) as f32).floor().to_int::<i32x16<S>>()
        };
        (place(y, 1, self.height) * self.width as i32 + place(x, 0, self.width)).to_array()
    }

    /// The up to nine samples at and beside sample `k`.
    fn around(&self, k: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.width, self.height);
        let (x, y) = (k % width, k / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        (y.saturating_sub(1)..(y + 2).min(height))
            .flat_map(move |j| columns.clone().map(move |i| j * width + i))
    }

    /// Sets the ranges of depth between the samples.
    fn set_ranges(&mut self) {
        let (width, height, inverse) = (self.width, self.height, &self.inverse);
        self.ranges.resize(width * height, [0.0; 2]);
        self.ranges.par_chunks_exact_mut(width).enumerate().with_min_len(16).for_each(|(j, ranges)| {
            let rows = [j, (j + 1).min(height - 1)].map(|j| &inverse[j * width..][..width]);
            for (i, range) in ranges.iter_mut().enumerate() {
                let next = (i + 1).min(width - 1);
                let w = [rows[0][i], rows[0][next], rows[1][i], rows[1][next]];
                let (far, near) = far_and_near(w);
                *range = [far * (1.0 - SAME_SURFACE), near * (1.0 + SAME_SURFACE)];
            }
        });
    }
}

/// Smallest and largest of four inverse depths.
#[inline(always)]
fn far_and_near(w: [f32; 4]) -> (f32, f32) {
    (w[0].min(w[1]).min(w[2].min(w[3])), w[0].max(w[1]).max(w[2].max(w[3])))
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
            axis: Axis::new(scale, 0.0),
            splatted: Vec::new(),
            middle: DepthGrid::default(),
            neighbors: [DepthGrid::default(), DepthGrid::default()],
            holes: [Vec::new(), Vec::new()],
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
        self.neighbors.iter_mut().for_each(DepthGrid::set_ranges);
        self.splat(&before, &after, camera);
        self.fill_holes();
        out.resize(size.0, size.1);
        let reprojections = [&before, &after].map(|n| Reprojection::new(camera, n.camera));
        let images = [before.image, after.image];
        out.pixels_mut().par_chunks_exact_mut(size.0).enumerate().with_min_len(8).for_each_init(Scratch::default, |scratch, (y, row)| {
            dispatch!(self.level, simd => self.fill_row(simd, y, &reprojections, images, t, scratch, row));
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

    /// Fills LR pixels that no sample reached with the farthest depth beside them.
    fn fill_holes(&mut self) {
        let (width, height) = (self.neighbors[0].width, self.neighbors[0].height);
        let grid = &mut self.middle;
        (grid.width, grid.height) = (width, height);
        grid.inverse.clear();
        grid.inverse.extend(self.splatted.iter().map(|v| decode(v.load(Relaxed))));
        // Ring by ring from the rims inwards, so that every hole is visited once. A ring reads only what was filled
        // before it: the order within it does not matter.
        let [ring, next] = &mut self.holes;
        ring.clear();
        for k in 0..grid.inverse.len() {
            if grid.inverse[k] < 0.0 && grid.around(k).any(|n| grid.inverse[n] >= 0.0) {
                ring.push((k, 0.0));
            }
        }
        for (k, _) in ring.iter() {
            grid.inverse[*k] = QUEUED;
        }
        if ring.is_empty() && grid.inverse.first().is_some_and(|w| *w < 0.0) {
            // Nothing was seen at all: everything is as far as can be.
            grid.inverse.fill(0.0);
        }
        while !ring.is_empty() {
            for (k, farthest) in ring.iter_mut() {
                let seen = grid.around(*k).map(|n| grid.inverse[n]).filter(|w| *w >= 0.0);
                *farthest = seen.fold(f32::INFINITY, f32::min);
            }
            next.clear();
            for (k, farthest) in ring.iter() {
                grid.inverse[*k] = *farthest;
            }
            for (k, _) in ring.iter() {
                for n in grid.around(*k) {
                    if grid.inverse[n] == UNVISITED {
                        grid.inverse[n] = QUEUED;
                        next.push((n, 0.0));
                    }
                }
            }
            std::mem::swap(ring, next);
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
        scratch: &mut Scratch,
        out: &mut [[f32; 4]],
    ) {
        let lanes = f32x16::from_fn(simd, |i| i as f32 + 0.5);
        scratch.depths.resize(out.len(), 0.0);
        self.middle_depths(y, scratch);
        scratch.depths.resize(out.len().next_multiple_of(16), 0.0);
        for (run, pixels) in out.chunks_mut(16).enumerate() {
            let depths = f32x16::from_slice(simd, &scratch.depths[16 * run..16 * run + 16]);
            let x = lanes + (16 * run) as f32;
            let before = self.see(simd, 0, &reprojections[0], images[0], x, y as f32 + 0.5, depths);
            let after = self.see(simd, 1, &reprojections[1], images[1], x, y as f32 + 0.5, depths);
            for (k, pixel) in pixels.iter_mut().enumerate() {
                let a = (1.0 - t) * before.visibility(&self.neighbors[0], k);
                let b = t * after.visibility(&self.neighbors[1], k);
                // At either end of the interval only one neighbour counts, hidden or not.
                let share = if a + b > 0.0 { b / (a + b) } else { t };
                let color = if share == 0.0 {
                    before.places.gather(simd, images[0], k)
                } else if share == 1.0 {
                    after.places.gather(simd, images[1], k)
                } else {
                    before.places.gather(simd, images[0], k) * (1.0 - share)
                        + after.places.gather(simd, images[1], k) * share
                };
                *pixel = color.to_array();
            }
        }
    }

    /// How neighbour `n` sees sixteen pixels of a row of the middle frame at inverse depths `w`.
    #[inline(always)]
    fn see<S: Simd>(
        &self,
        simd: S,
        n: usize,
        reprojection: &Reprojection,
        image: &Image,
        x: f32x16<S>,
        y: f32,
        w: f32x16<S>,
    ) -> Seen {
        let [u, v, q] = reprojection.apply_16(simd, x, y, w);
        Seen::new(simd, [u - 0.5, v - 0.5], w / q, q, &self.neighbors[n], image, self.scale)
    }

    /// Inverse depths of the middle frame along HR row `y`: linear within a surface, the nearest sample's at an edge.
    #[inline(always)]
    fn middle_depths(&self, y: usize, scratch: &mut Scratch) {
        let grid = &self.middle;
        let Place { index, fraction: fy } = self.axis.place(y);
        let rows =
            [index, index + 1].map(|j| &grid.inverse[clamped(j, grid.height) * grid.width..][..grid.width]);
        // Cell −1 lies before the first sample.
        scratch.edges.clear();
        for i in 0..=grid.width {
            let (i0, i1) = (i.saturating_sub(1), i.min(grid.width - 1));
            let w = [rows[0][i0], rows[0][i1], rows[1][i0], rows[1][i1]];
            let (far, near) = far_and_near(w);
            let is_smooth = near - far <= SAME_SURFACE * near;
            let f = if is_smooth { fy } else { fy.round() };
            let between = |a: f32, b: f32| a + (b - a) * f;
            scratch.edges.push(Edges { left: between(w[0], w[2]), right: between(w[1], w[3]), is_smooth });
        }
        let (phases, edges) = (self.axis.phases(), &scratch.edges);
        for (q, depths) in scratch.depths.chunks_mut(phases.len()).enumerate() {
            for (depth, place) in depths.iter_mut().zip(phases) {
                let Edges { left, right, is_smooth } = edges[(q + 1).wrapping_add_signed(place.index)];
                let f = if is_smooth { place.fraction } else { place.fraction.round() };
                *depth = left + (right - left) * f;
            }
        }
    }
}

/// Inverse depths at the left and right of a cell between four samples, at the height of an HR row.
#[derive(Clone, Copy, Debug)]
struct Edges {
    left: f32,
    right: f32,
    /// Whether the four samples belong to one surface.
    is_smooth: bool,
}

/// Memory of one task.
#[derive(Debug, Default)]
struct Scratch {
    edges: Vec<Edges>,
    /// Inverse depths of an HR row, to whole vectors.
    depths: Vec<f32>,
}

/// Sixteen points of the middle frame as a neighbour sees them.
struct Seen {
    places: Places,
    w: [f32; 16],
    cell: [i32; 16],
    /// Bit `k`: point `k` is in front of the neighbour's camera and inside its image.
    inside: u64,
}

impl Seen {
    #[inline(always)]
    fn new<S: Simd>(
        simd: S,
        [u, v]: [f32x16<S>; 2],
        w: f32x16<S>,
        q: f32x16<S>,
        grid: &DepthGrid,
        image: &Image,
        scale: u32,
    ) -> Self {
        let inside = q.simd_gt(MIN_DIVISOR)
            & u.simd_ge(-0.5)
            & v.simd_ge(-0.5)
            & u.simd_le(image.width() as f32 - 0.5)
            & v.simd_le(image.height() as f32 - 0.5);
        // What is behind the camera has no place.
        let behind = q.simd_le(MIN_DIVISOR);
        let far_out = f32x16::splat(simd, -1.0);
        let (u, v) = (behind.select(far_out, u), behind.select(far_out, v));
        Self {
            places: Places::new(u, v),
            w: w.to_array(),
            cell: grid.cell(u, v, 1.0 / scale as f32),
            inside: inside.to_bitmask(),
        }
    }

    /// How far the neighbour sees point `k`: 1 visible, near 0 hidden, nearer outside. The small values decide where
    /// neither neighbour sees it.
    #[inline(always)]
    fn visibility(&self, grid: &DepthGrid, k: usize) -> f32 {
        if self.inside >> k & 1 == 0 {
            return HIDDEN * HIDDEN;
        }
        let [from, to] = grid.ranges[self.cell[k] as usize];
        if !(from..=to).contains(&self.w[k]) {
            HIDDEN
        } else if to - from <= 4.0 * SAME_SURFACE * to {
            1.0
        } else {
            SILHOUETTE
        }
    }
}

/// Weight of a neighbour whose depths change between the samples around a point, so that the point may be hidden or mixed
/// with another surface (empirical).
const SILHOUETTE: f32 = 0.3;

/// Weight of a neighbour that does not see a point: its colour shows at most as one step of 8 bits beside one that does.
const HIDDEN: f32 = 1e-3;

/// No sample.
const HOLE: u32 = 0;

/// Orders inverse depths (≥ 0) as integers above [`HOLE`]: the bits of non-negative floats are ordered like them.
#[inline(always)]
fn encode(w: f32) -> u32 {
    w.max(0.0).to_bits() + 1
}

/// Inverse depth of a hole that no ring has reached.
const UNVISITED: f32 = -1.0;

/// Inverse depth of a hole in a ring that has not been filled.
const QUEUED: f32 = -2.0;

/// [`UNVISITED`] for [`HOLE`].
#[inline(always)]
fn decode(bits: u32) -> f32 {
    if bits == HOLE { UNVISITED } else { f32::from_bits(bits - 1) }
}
