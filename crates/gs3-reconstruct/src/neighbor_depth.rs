//! What a neighbour of an interpolated frame sees at which depth.

use fearless_simd::{Simd, f32x16, i32x16, prelude::*, u8x64};
use gs3_scene::{GBuffer, Geometry};
use rayon::prelude::*;

use crate::reprojection::inverse_depth;

/// Relative difference of inverse depths up to which they belong to one surface.
pub(crate) const SAME_SURFACE: f32 = 0.02;

/// Weight of a neighbour whose depths change between the samples around a point, so that the point may be hidden or mixed
/// with another surface (empirical).
const SILHOUETTE: f32 = 0.3;

/// Weight of a neighbour that sees something else: it decides between two that do not show the point, and is nothing
/// beside one that does.
pub(crate) const HIDDEN: f32 = 1e-5;

const LANES: usize = 16;

/// Cells before that of the first lane which [`NeighborDepth::visibility`] loads along: positions need not increase along a row.
const BACK: f32 = 4.0;

/// Inverse median depths of an LR grid whose samples lie `jitter` off the pixel centres.
#[derive(Debug, Default)]
pub(crate) struct NeighborDepth {
    pub width: usize,
    pub height: usize,
    pub jitter: [f32; 2],
    /// `[height, width]`, ≥ 0.
    pub inverse: Vec<f32>,
    /// Smallest inverse depth visible in cell `(i, j)`, between samples `(i, j)` and `(i + 1, j + 1)`: `[height, width]`,
    /// and a vector more, so that one can be loaded from any place.
    far: Vec<f32>,
    /// The largest, likewise.
    near: Vec<f32>,
}

impl NeighborDepth {
    /// Takes over the depths of `geometry`, which belongs to `gbuffer`.
    pub fn set(&mut self, gbuffer: &GBuffer, geometry: &Geometry) {
        let (width, height) = (gbuffer.width(), gbuffer.height());
        (self.width, self.height, self.jitter) = (width, height, gbuffer.jitter);
        let size = width * height;
        self.inverse.resize(size, 0.0);
        let depths = geometry.depth_median.data();
        let inverse = self.inverse.par_iter_mut().zip(depths).with_min_len(1 << 14);
        inverse.for_each(|(w, &z)| *w = inverse_depth(z));
        self.far.resize(size + LANES, 0.0);
        self.near.resize(size + LANES, 0.0);
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

    /// How well points at HR positions `(u, v)`, pixel centres at whole numbers, and inverse depths `w` are seen: 1,
    /// [`SILHOUETTE`] or [`HIDDEN`]. Outside, the depths at the border decide.
    #[inline(always)]
    pub fn visibility<S: Simd>(&self, simd: S, [u, v, w]: [f32x16<S>; 3], scale: f32) -> f32x16<S> {
        let splat = |v: f32| f32x16::splat(simd, v);
        let cell = |x: f32x16<S>, jitter: f32, len: usize| {
            let place = x.mul_add(splat(1.0 / scale), splat(0.5 / scale - 0.5 - jitter));
            // In this order, NaN becomes 0.
            place.max(splat(0.0)).min(splat((len - 1) as f32)).floor()
        };
        let (i, j) = (cell(u, self.jitter[0], self.width), cell(v, self.jitter[1], self.height));
        let (row, column) = (j[0], (i[0] - BACK).max(0.0));
        let ahead = i - splat(column);
        let is_near = ahead.simd_ge(splat(0.0)) & ahead.simd_lt(splat(LANES as f32)) & j.simd_eq(splat(row));
        let start = row as usize * self.width + column as usize;
        let (far, near) = match (self.far.get(start..start + LANES), self.near.get(start..start + LANES)) {
            (Some(far), Some(near)) if is_near.all_true() => {
                // Sixteen pixels of a row mostly lie in a few cells of one row: a load, and bytes put in place.
                let lanes: i32x16<S> = ahead.to_int();
                let bytes = lanes * i32x16::splat(simd, 0x0404_0404) + i32x16::splat(simd, 0x0302_0100);
                let bytes: u8x64<S> = bytes.bitcast();
                (
                    f32x16::from_slice(simd, far).swizzle_dyn(bytes),
                    f32x16::from_slice(simd, near).swizzle_dyn(bytes),
                )
            }
            _ => {
                let (i, j) = (i.to_array(), j.to_array());
                let cells: [usize; LANES] =
                    std::array::from_fn(|k| j[k] as usize * self.width + i[k] as usize);
                (
                    f32x16::load_array(simd, cells.map(|cell| self.far[cell])),
                    f32x16::load_array(simd, cells.map(|cell| self.near[cell])),
                )
            }
        };
        let one_surface = (near - far).simd_le(near * splat(4.0 * SAME_SURFACE));
        let seen = one_surface.select(splat(1.0), splat(SILHOUETTE));
        (w.simd_ge(far) & w.simd_le(near)).select(seen, splat(HIDDEN))
    }
}
