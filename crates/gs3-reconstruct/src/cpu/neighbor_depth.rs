//! The visibility of a point in a neighbour of an in-between frame, by its depth.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use gs3_scene::{GBuffer, Geometry};
use rayon::prelude::*;

use crate::cpu::lanes::{WINDOW, look_up, window_bytes};
use crate::reprojection::{SAME_SURFACE, inverse_depth};

/// Weight of a neighbour with different depths at the samples around a point: the point may be hidden, or mixed with
/// another surface (empirical).
pub(crate) const SILHOUETTE: f32 = 0.3;

/// Weight of a neighbour that sees another surface. It decides between two neighbours that do not show the point, and
/// is negligible beside a neighbour that does.
pub(crate) const HIDDEN: f32 = 1e-5;

/// The samples around a point are on one surface if their range of inverse depths, already widened by [`SAME_SURFACE`] at
/// both ends, is at most this share of the nearest. It leaves the samples themselves two steps of [`SAME_SURFACE`]: one
/// along x and one along y.
pub(crate) const ONE_SURFACE: f32 = 4.0 * SAME_SURFACE;

const LANES: usize = 16;

/// Number of cells of a row that are read before the first point's cell: positions need not increase along a row.
const BACK: f32 = 8.0;

/// Inverse median depths of an LR grid with samples `jitter` off the pixel centres.
#[derive(Debug, Default)]
pub(crate) struct NeighborDepth {
    pub width: usize,
    pub height: usize,
    pub jitter: [f32; 2],
    /// `[height, width]`, ≥ 0.
    pub inverse: Vec<f32>,
    /// Smallest inverse depth visible in cell `(i, j)`, between samples `(i, j)` and `(i + 1, j + 1)`: `[height,
    /// width]`, with one more window at the end, so that a window can be loaded from any place.
    far: Vec<f32>,
    /// Largest inverse depth visible in each cell, in the same layout.
    near: Vec<f32>,
}

impl NeighborDepth {
    /// Copies the depths of `geometry`, which belongs to `gbuffer`.
    pub fn set(&mut self, gbuffer: &GBuffer, geometry: &Geometry) {
        let (width, height) = (gbuffer.width(), gbuffer.height());
        (self.width, self.height, self.jitter) = (width, height, gbuffer.jitter);
        let size = width * height;
        self.inverse.resize(size, 0.0);
        let depths = geometry.depth_median.data();
        let inverse = self.inverse.par_iter_mut().zip(depths).with_min_len(1 << 14);
        inverse.for_each(|(w, &z)| *w = inverse_depth(z));
        self.far.resize(size + WINDOW, 0.0);
        self.near.resize(size + WINDOW, 0.0);
        let inverse = &self.inverse;
        let far = self.far[..size].par_chunks_exact_mut(width);
        let near = self.near[..size].par_chunks_exact_mut(width);
        far.zip(near).enumerate().with_min_len(8).for_each(|(j, (far, near))| {
            let [top, bottom] = [j, (j + 1).min(height - 1)].map(|j| &inverse[j * width..][..width]);
            for i in 0..width {
                let next = (i + 1).min(width - 1);
                let least = top[i].min(top[next]).min(bottom[i].min(bottom[next]));
                let most = top[i].max(top[next]).max(bottom[i].max(bottom[next]));
                (far[i], near[i]) = (least * (1.0 - SAME_SURFACE), most * (1.0 + SAME_SURFACE));
            }
        });
    }

    /// Visibility of points at HR positions `(u, v)`, pixel centres at whole numbers, with inverse depths `w`: 1,
    /// [`SILHOUETTE`] or [`HIDDEN`]. Outside the frame the border's depths are used. The points lie about in a row.
    #[inline(always)]
    pub fn visibility_along<S: Simd>(&self, simd: S, [u, v, w]: [f32x16<S>; 3], scale: f32) -> f32x16<S> {
        let [i, j] = self.cells(simd, [u, v], scale);
        let (row, column) = (j[0], (i[0] - BACK).max(0.0));
        let ahead = i - column;
        let is_near = ahead.simd_ge(0.0) & ahead.simd_lt(WINDOW as f32) & j.simd_eq(row);
        if !is_near.all_true() {
            let [far, near] = self.ranges_anywhere(simd, [i, j]);
            return Self::judge(simd, w, far, near);
        }
        let start = row as usize * self.width + column as usize;
        let bytes = window_bytes(ahead);
        let (far, near) =
            (look_up(simd, &self.far[start..], bytes), look_up(simd, &self.near[start..], bytes));
        Self::judge(simd, w, far, near)
    }

    /// As [`Self::visibility_along`], for points that are close to each other.
    #[inline(always)]
    pub fn visibility_within<S: Simd>(&self, simd: S, [u, v, w]: [f32x16<S>; 3], scale: f32) -> f32x16<S> {
        let [far, near] = self.ranges_within(simd, [u, v], scale);
        Self::judge(simd, w, far, near)
    }

    /// The smallest and the largest inverse depths visible at HR positions that are close to each other.
    #[inline(always)]
    pub fn ranges_within<S: Simd>(&self, simd: S, at: [f32x16<S>; 2], scale: f32) -> [f32x16<S>; 2] {
        let [i, j] = self.cells(simd, at, scale);
        let (left, top) = (i.reduce_min(), j.reduce_min());
        let (is_left, is_top) = (i.simd_eq(left), j.simd_eq(top));
        let is_near = (is_left | i.simd_eq(left + 1.0)) & (is_top | j.simd_eq(top + 1.0));
        if !is_near.all_true() {
            return self.ranges_anywhere(simd, [i, j]);
        }
        // Four cells. Values of cells beyond the grid are never used.
        let start = top as usize * self.width + left as usize;
        let far = select_cell(simd, &self.far, start, self.width, is_left, is_top);
        let near = select_cell(simd, &self.near, start, self.width, is_left, is_top);
        [far, near]
    }

    /// The smallest and the largest inverse depths visible in arbitrary cells `(i, j)`.
    #[inline(always)]
    fn ranges_anywhere<S: Simd>(&self, simd: S, [i, j]: [f32x16<S>; 2]) -> [f32x16<S>; 2] {
        let (i, j) = (i.to_array(), j.to_array());
        let (mut far, mut near) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let cell = j[k] as usize * self.width + i[k] as usize;
            (far[k], near[k]) = (self.far[cell], self.near[cell]);
        }
        [f32x16::load_array(simd, far), f32x16::load_array(simd, near)]
    }

    /// The cells, column and row, at HR positions; the nearest cells for positions outside.
    #[inline(always)]
    fn cells<S: Simd>(&self, simd: S, [u, v]: [f32x16<S>; 2], scale: f32) -> [f32x16<S>; 2] {
        let mut cells = [f32x16::splat(simd, 0.0); 2];
        for (c, len) in [self.width, self.height].into_iter().enumerate() {
            let at = [u, v][c];
            let place = at.mul_add(1.0 / scale, f32x16::splat(simd, 0.5 / scale - 0.5 - self.jitter[c]));
            // In this order, NaN becomes 0.
            cells[c] = place.max(0.0).min((len - 1) as f32).floor();
        }
        cells
    }

    /// The visibility of points with inverse depth `w` in a cell with inverse depths from `far` to `near`.
    #[inline(always)]
    fn judge<S: Simd>(simd: S, w: f32x16<S>, far: f32x16<S>, near: f32x16<S>) -> f32x16<S> {
        let one_surface = (near - far).simd_le(near * ONE_SURFACE);
        let seen = one_surface.select(f32x16::splat(simd, 1.0), f32x16::splat(simd, SILHOUETTE));
        (w.simd_ge(far) & w.simd_le(near)).select(seen, f32x16::splat(simd, HIDDEN))
    }
}

/// Selects, from the 2×2 cells from `start` on (`width` cells a row), the cells that the points lie in.
#[inline(always)]
fn select_cell<S: Simd>(
    simd: S,
    values: &[f32],
    start: usize,
    width: usize,
    is_left: mask32x16<S>,
    is_top: mask32x16<S>,
) -> f32x16<S> {
    let last = values.len() - 1;
    let mut cells = [f32x16::splat(simd, 0.0); 4];
    for (cell, at) in cells.iter_mut().zip([start, start + 1, start + width, start + width + 1]) {
        *cell = f32x16::splat(simd, values[at.min(last)]);
    }
    let [a, b, c, d] = cells;
    is_left.select(is_top.select(a, c), is_top.select(b, d))
}
