//! The motion of a frame's surfaces from another frame, on the LR grid.
//!
//! Every sample is reprojected through its own depth. It counts as seen there to the degree that the samples around
//! that place belong to the same surface.

use fearless_simd::{Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::{Camera, GBuffer, Planes, Size};
use rayon::prelude::*;

use crate::error::{ReconstructError, check_gbuffer, check_jitter, check_scale, check_size};
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE, inverse_depth};

const LANES: usize = 16;

/// A camera on its own grid of samples, with depths.
#[derive(Clone, Copy, Debug)]
pub struct DepthView<'a> {
    /// The camera with the grid as its pixels: [`Camera::low_resolution`] of the HR camera.
    pub camera: Camera,
    /// Offset of the samples from the pixel centres, in pixels of the grid, within ±1.
    pub jitter: [f32; 2],
    /// Depths of the samples.
    pub depth: Depth<'a>,
}

/// View-space depths z in one of two forms, `[height, width]`.
#[derive(Clone, Copy, Debug)]
pub enum Depth<'a> {
    /// z in world units; 0 where there is no surface.
    Z(&'a Planes<1>),
    /// 1/z; 0 where there is no surface.
    Inverse(&'a Planes<1>),
}

/// The places of a frame's surfaces in another frame.
///
/// Memory: 24 B per sample.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Per sample of the frame, the offset to its place among the other frame's samples, x and y, in pixels of the
    /// grid. The surface at index `(i, j)` was at index `(i + flow₀, j + flow₁)`, with the jitter of both frames
    /// included. Finite; 0 where the validity is 0.
    pub flow: Planes<2>,
    /// Share of the bilinear interpolation at that place that belongs to the same surface, `[0, 1]`: 0 for surfaces
    /// hidden in the other frame, between 0 and 1 at silhouettes. Background (no surface) is infinitely far and
    /// belongs to background.
    pub validity: Planes<1>,
    /// Inverse depths of the other frame, `[height, width]`.
    inverse: Vec<f32>,
    /// The inverse depths, and the largest difference from them on the same surface, `[height, width]`.
    surfaces: Vec<[f32; 2]>,
}

impl<'a> DepthView<'a> {
    /// The LR frame of the HR `camera`, `scale` times larger, with its median depth.
    ///
    /// # Errors
    /// [`ReconstructError`] if `scale` is not supported, or `gbuffer` is not the LR frame of `camera` or lacks
    /// geometry.
    pub fn of_gbuffer(gbuffer: &'a GBuffer, camera: &Camera, scale: u32) -> Result<Self, ReconstructError> {
        check_scale(scale)?;
        check_gbuffer(gbuffer, scale, camera.size())?;
        let Some(geometry) = &gbuffer.geometry else {
            return Err(ReconstructError::Missing { what: "depth" });
        };
        let depth = Depth::Z(&geometry.depth_median);
        Ok(Self { camera: camera.low_resolution(scale), jitter: gbuffer.jitter, depth })
    }

    fn size(&self) -> Size {
        self.camera.size()
    }

    fn check(&self) -> Result<(), ReconstructError> {
        let (Depth::Z(plane) | Depth::Inverse(plane)) = self.depth;
        check_size("depth", self.size(), plane.size())?;
        check_jitter(self.jitter)
    }

    /// Inverse depths of row `y`, with values outside the valid range replaced by 0.
    fn inverse_depths(&self, y: usize, out: &mut [f32]) {
        match self.depth {
            Depth::Z(plane) => {
                out.iter_mut().zip(plane.row(0, y)).for_each(|(w, z)| *w = inverse_depth(*z));
            }
            Depth::Inverse(plane) => {
                // The same range as in inverse_depth.
                let fit = |w: f32| if (0.0..=1e6).contains(&w) { w } else { 0.0 };
                out.iter_mut().zip(plane.row(0, y)).for_each(|(to, w)| *to = fit(*w));
            }
        }
    }
}

impl Motion {
    /// Computes the motion from the samples of `now` to their places in `before`. Memory is reused.
    ///
    /// # Errors
    /// [`ReconstructError`] if the grids have different sizes or a jitter is not usable.
    pub fn set(&mut self, now: &DepthView<'_>, before: &DepthView<'_>) -> Result<(), ReconstructError> {
        now.check()?;
        before.check()?;
        check_size("previous view", now.size(), before.size())?;
        let [width, height] = now.size().to_usize();
        self.find_surfaces(before);
        self.flow.resize(width, height);
        self.validity.resize(width, height);
        let reprojection = Reprojection::new(&now.camera, &before.camera);
        let target = Target { width, height, jitter: before.jitter, surfaces: &self.surfaces };
        let level = gs3_simd::level();
        let (flow_x, flow_y) = self.flow.data_mut().split_at_mut(width * height);
        let flow = flow_x.par_chunks_exact_mut(width).zip(flow_y.par_chunks_exact_mut(width));
        let rows = flow.zip(self.validity.data_mut().par_chunks_exact_mut(width)).enumerate();
        rows.with_min_len(4).for_each_init(
            || vec![0.0; width.next_multiple_of(LANES)],
            |depths, (y, ((flow_x, flow_y), validity))| {
                now.inverse_depths(y, &mut depths[..width]);
                dispatch!(level, simd => for (run, depths) in depths.chunks_exact(LANES).enumerate() {
                    let at = [run * LANES, y];
                    let w = f32x16::from_slice(simd, depths);
                    let found = target.find(simd, &reprojection, now.jitter, at, w);
                    for (value, out) in found.into_iter().zip([&mut *flow_x, flow_y, validity]) {
                        let out = &mut out[run * LANES..];
                        let count = out.len().min(LANES);
                        out[..count].copy_from_slice(&value.to_array()[..count]);
                    }
                });
            },
        );
        Ok(())
    }

    /// Inverse depths of `view` and their tolerance: the larger of [`SAME_SURFACE`] of the inverse depth and the
    /// surface's slope.
    fn find_surfaces(&mut self, view: &DepthView<'_>) {
        let [width, height] = view.size().to_usize();
        self.inverse.resize(width * height, 0.0);
        let rows = self.inverse.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        rows.for_each(|(y, row)| view.inverse_depths(y, row));
        let inverse = |x: usize, y: usize| self.inverse[y * width + x];
        self.surfaces.resize(width * height, [0.0; 2]);
        let rows = self.surfaces.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        rows.for_each(|(y, row)| {
            let [above, middle, below] = around(y, height);
            for (x, surface) in row.iter_mut().enumerate() {
                let [left, center, right] = around(x, width);
                let slope = slope([left, center, right].map(|x| inverse(x, y)))
                    + slope([above, middle, below].map(|y| inverse(x, y)));
                let w = inverse(x, y);
                *surface = [w, slope.max(SAME_SURFACE * w)];
            }
        });
    }
}

/// The indices around `i` in `len` entries; `i` is the middle index except at the ends.
#[inline(always)]
fn around(i: usize, len: usize) -> [usize; 3] {
    let first = (i.max(1) - 1).min(len.saturating_sub(3));
    [first, first + 1, first + 2].map(|i| i.min(len - 1))
}

/// The smaller of two consecutive differences if they agree in sign (minmod), else 0. A jump to another surface is on
/// one side only, or makes a peak.
#[inline(always)]
fn slope([before, w, after]: [f32; 3]) -> f32 {
    let (a, b) = (w - before, after - w);
    if a * b > 0.0 { a.abs().min(b.abs()) } else { 0.0 }
}

/// Places among `len` samples, moved to the nearest that is inside: whole numbers and the rest.
#[inline(always)]
fn whole_and_fraction<S: Simd>(simd: S, place: f32x16<S>, len: usize) -> (f32x16<S>, f32x16<S>) {
    // In this order, NaN becomes 0.
    let place = place.max(f32x16::splat(simd, 0.0)).min(f32x16::splat(simd, (len - 1) as f32));
    (place.floor(), place - place.floor())
}

/// The frame that surfaces are looked up in.
struct Target<'a> {
    width: usize,
    height: usize,
    jitter: [f32; 2],
    surfaces: &'a [[f32; 2]],
}

impl Target<'_> {
    /// Flow x, flow y and validity of the sixteen samples from index `at` on, which lie `jitter` off their pixel
    /// centres at inverse depths `w`.
    #[inline(always)]
    fn find<S: Simd>(
        &self,
        simd: S,
        reprojection: &Reprojection,
        jitter: [f32; 2],
        [column, row]: [usize; 2],
        w: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        let splat = |v: f32| f32x16::splat(simd, v);
        let index = f32x16::from_fn(simd, |k| k as f32) + splat(column as f32);
        let (x, y) = (index + splat(0.5 + jitter[0]), splat(row as f32 + 0.5 + jitter[1]));
        let [u, v, q] = reprojection.apply_16(simd, x, y, w);
        let (width, height) = (splat(self.width as f32), splat(self.height as f32));
        let is_inside = q.simd_gt(splat(MIN_DIVISOR))
            & u.simd_ge(splat(0.0))
            & v.simd_ge(splat(0.0))
            & u.simd_le(width)
            & v.simd_le(height);
        // Differences first: a resting surface then has no flow, despite rounding of its position.
        let flow_x = u - x + splat(jitter[0] - self.jitter[0]);
        let flow_y = v - y + splat(jitter[1] - self.jitter[1]);
        let (i, along_x) = whole_and_fraction(simd, index + flow_x, self.width);
        let (j, along_y) = whole_and_fraction(simd, splat(row as f32) + flow_y, self.height);
        let w = w / q;
        let is_background = w.simd_eq(splat(0.0));
        let mut validity = splat(0.0);
        let last = [self.width - 1, self.height - 1].map(|last| i32x16::splat(simd, last as i32));
        let (i, j): (i32x16<S>, i32x16<S>) = (i.to_int(), j.to_int());
        let one = splat(1.0);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let column = (i + i32x16::splat(simd, dx)).min(last[0]);
            let cells = (j + i32x16::splat(simd, dy)).min(last[1]) * self.width as i32 + column;
            let surfaces = cells.to_array().map(|cell| self.surfaces[cell as usize]);
            let seen = f32x16::load_array(simd, surfaces.map(|s| s[0]));
            let tolerance = f32x16::load_array(simd, surfaces.map(|s| s[1]));
            let same_kind = !(seen.simd_eq(splat(0.0)) ^ is_background);
            let agrees = (w - seen).abs().simd_le(tolerance.max(w * SAME_SURFACE)) & same_kind;
            let weight_x = if dx == 0 { one - along_x } else { along_x };
            let weight_y = if dy == 0 { one - along_y } else { along_y };
            validity = agrees.select((weight_x * weight_y) + validity, validity);
        }
        let validity = is_inside.select(validity.min(1.0), splat(0.0));
        let is_valid = validity.simd_gt(splat(0.0));
        [is_valid.select(flow_x, splat(0.0)), is_valid.select(flow_y, splat(0.0)), validity]
    }
}
