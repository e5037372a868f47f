//! An in-between frame of two reconstructed frames, at its true pose, without learning.
//!
//! Depth forward, colour backward. (1) The depths of both neighbours are splatted to the middle pose on the LR grid;
//! the nearest depth wins. (2) Holes take the farthest depth beside them. (3) Every HR pixel gathers its colour from
//! both HR neighbours. (4) Patches beside silhouettes take the surface at which the neighbours agree. (5) The colours are
//! blended by visibility, time and uncertainty. [`Interpolator::warp`] leaves the blend to the caller, and
//! [`Interpolator::reproject`] warps one neighbour only.

use fearless_simd::{Level, dispatch};
use gs3_scene::{Camera, GBuffer, Image, Planes};
use rayon::prelude::*;

use crate::cpu::blend::{Blend, shares};
use crate::cpu::block_gradients::BlockGradients;
use crate::cpu::gather::Gather;
use crate::cpu::middle_depth::{MiddleDepth, Passage};
use crate::cpu::neighbor_depth::NeighborDepth;
use crate::cpu::patch_errors::PatchErrors;
use crate::cpu::separate::Part;
use crate::cpu::warp::{Warp, band_top, bands};
use crate::error::{ReconstructError, check_gbuffer, check_scale, check_size};
use crate::reprojection::Reprojection;

/// A reconstructed frame next to the in-between frame.
#[derive(Clone, Copy, Debug)]
pub struct Neighbor<'a> {
    /// The camera of `image`.
    pub camera: &'a Camera,
    /// The HR frame: RGB and uncertainty, as [`crate::SuperSampler::super_sample`] writes them. The neighbour with
    /// the smaller uncertainty counts more. If uncertainties are unknown, both neighbours should have the same value.
    pub image: &'a Image,
    /// The LR frame that `image` was reconstructed from, with geometry.
    pub gbuffer: &'a GBuffer,
    /// Derivatives of `image` in its exact blocks, of the size of `image`; none if there are none, or if they are unknown.
    pub gradients: Option<&'a BlockGradients>,
}

/// Both neighbours, warped to the pose of the in-between frame.
///
/// Where a neighbour does not show a pixel's surface, the warped pixel is whatever the neighbour has at that place
/// (beyond its edges, the border pixel). The visibility is then next to nothing.
#[derive(Clone, Debug, Default)]
pub struct Warped {
    /// The frame before. All four channels are interpolated in the same way (from 6×6 pixels, with overshoot; from
    /// 5×5 pixels and gradients where there are [`Neighbor::gradients`]).
    pub before: Image,
    /// The frame after, in the same way.
    pub after: Image,
    /// Weight of `after` in the blend of [`Interpolator::interpolate`], `[0, 1]`; HR.
    pub share: Planes<1>,
    /// How well the frame before and the frame after see each pixel's surface, `[0, 1]`; HR. It is 1 for a visible
    /// surface, about 0.3 beside silhouettes, and about 1e-5 or less where the surface is hidden or outside. Patches that
    /// approach another surface have values in between.
    pub visibility: Planes<2>,
    /// Inverse depths of the in-between frame at its pixel centres, holes filled; 0 where there is no surface; LR.
    /// Other surfaces that patches beside silhouettes take are not among them.
    pub inverse_depth: Planes<1>,
}

/// A frame warped to another camera; see [`Warped`].
#[derive(Clone, Debug, Default)]
pub struct Reprojected {
    /// The frame. All four channels are interpolated in the same way (from 6×6 pixels, with overshoot).
    pub image: Image,
    /// How well the frame sees each pixel's surface, `[0, 1]`; HR.
    pub visibility: Planes<1>,
}

/// Interpolates frames between two neighbours.
#[derive(Debug)]
pub struct Interpolator {
    scale: u32,
    level: Level,
    gather: Gather,
    middle: MiddleDepth,
    neighbors: [NeighborDepth; 2],
    errors: PatchErrors,
    has_errors: bool,
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
            level: gs3_simd::level(),
            gather: Gather::new(),
            middle: MiddleDepth::default(),
            neighbors: [NeighborDepth::default(), NeighborDepth::default()],
            errors: PatchErrors::default(),
            has_errors: true,
        })
    }

    /// Whether the next frames have [`Self::expected_errors`]: yes at first. Without them a frame is made a little faster, and the
    /// errors are 0.
    pub const fn set_has_errors(&mut self, has_errors: bool) {
        self.has_errors = has_errors;
    }

    /// The squared errors to expect of the last frame of [`Self::interpolate`] into `out`, which is resized: one per block of
    /// 4×4 pixels, `[rows, columns]` of [`gs3_scene::block_grid`]; none before the first frame. An error is a sum over the block's
    /// pixels and over RGB. The errors follow from the difference of the neighbours. Pixels that only one neighbour shows have
    /// no difference and count nothing.
    pub fn expected_errors(&self, out: &mut Vec<f32>) {
        self.errors.of_blocks(out);
    }

    /// Interpolates the image of `camera` at time `t` ∈ `[0, 1]` between `before` (0) and `after` (1) into `out`,
    /// which is resized. The fourth channel is the blend of the neighbours' uncertainties.
    ///
    /// # Errors
    /// [`ReconstructError`] if sizes do not match `camera`, geometry is missing, or `t` is outside `[0, 1]`.
    pub fn interpolate(
        &mut self,
        before: Neighbor<'_>,
        after: Neighbor<'_>,
        t: f32,
        camera: &Camera,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        self.interpolate_moving(before, after, None, t, camera, out)
    }

    /// As [`Self::interpolate`], with moving objects. `displacements` are the displacements of the LR samples of both
    /// neighbours from `before` to `after`, in world units, `[LR height, LR width]`.
    pub(crate) fn interpolate_moving(
        &mut self,
        before: Neighbor<'_>,
        after: Neighbor<'_>,
        displacements: Option<[&[[f32; 3]]; 2]>,
        t: f32,
        camera: &Camera,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        let level = self.level;
        let passage = displacements.map(|displacements| Passage { displacements, t });
        let mut errors = std::mem::take(&mut self.errors);
        let has_errors = self.has_errors;
        let blend = Blend { warp: self.prepare([before, after], t, camera, passage)?, t, has_errors };
        let [width, height] = camera.size().to_usize();
        out.resize(width, height);
        let scale = blend.warp.scale;
        let errors_of_bands = errors.bands(scale, camera.size());
        bands(scale, width, out.pixels_mut()).zip(errors_of_bands).enumerate().for_each(
            |(band, (rows, errors))| {
                dispatch!(level, simd => blend.blend(simd, band_top(scale, band), rows, errors));
            },
        );
        self.errors = errors;
        Ok(())
    }

    /// Warps `before` (time 0) and `after` (1) to the pose of `camera` at time `t` ∈ `[0, 1]` into `out`, without
    /// blending. The memory of `out` is reused.
    ///
    /// # Errors
    /// As of [`Self::interpolate`].
    pub fn warp(
        &mut self,
        before: Neighbor<'_>,
        after: Neighbor<'_>,
        t: f32,
        camera: &Camera,
        out: &mut Warped,
    ) -> Result<(), ReconstructError> {
        let level = self.level;
        let warp = self.prepare([before, after], t, camera, None)?;
        let [width, height] = camera.size().to_usize();
        out.inverse_depth.resize(warp.middle.width, warp.middle.height);
        out.inverse_depth.data_mut().copy_from_slice(&warp.middle.inverse);
        for image in [&mut out.before, &mut out.after] {
            image.resize(width, height);
        }
        out.share.resize(width, height);
        out.visibility.resize(width, height);
        let (visibility_before, visibility_after) = out.visibility.data_mut().split_at_mut(width * height);
        let scale = warp.scale;
        let images =
            bands(scale, width, out.before.pixels_mut()).zip(bands(scale, width, out.after.pixels_mut()));
        let visibility = bands(scale, width, visibility_before).zip(bands(scale, width, visibility_after));
        let all = images.zip(visibility).zip(bands(scale, width, out.share.data_mut())).enumerate();
        all.for_each(|(band, ((images, seen), share))| {
            let parts = [
                Part { image: &mut *images.0, visibility: &mut *seen.0 },
                Part { image: &mut *images.1, visibility: &mut *seen.1 },
            ];
            dispatch!(level, simd => warp.separate(simd, band_top(scale, band), parts));
            dispatch!(level, simd => shares(simd, [seen.0, seen.1], [images.0, images.1], t, share));
        });
        Ok(())
    }

    /// Warps the frame `before` to the camera of `now`, with the depths of both frames, into `out`. The memory of
    /// `out` is reused. The image of `now` is not read.
    ///
    /// # Errors
    /// As of [`Self::interpolate`].
    pub fn reproject(
        &mut self,
        before: Neighbor<'_>,
        now: Neighbor<'_>,
        out: &mut Reprojected,
    ) -> Result<(), ReconstructError> {
        let level = self.level;
        // Nothing here depends on the time.
        let warp = self.prepare([before, now], 0.5, now.camera, None)?.of_first();
        let [width, height] = now.camera.size().to_usize();
        out.image.resize(width, height);
        out.visibility.resize(width, height);
        let scale = warp.scale;
        let visibility = bands(scale, width, out.visibility.data_mut());
        let rows = bands(scale, width, out.image.pixels_mut()).zip(visibility).enumerate();
        rows.for_each(|(band, (image, visibility))| {
            let part = [Part { image, visibility }];
            dispatch!(level, simd => warp.separate(simd, band_top(scale, band), part));
        });
        Ok(())
    }

    /// Checks the inputs and finds the depths of the in-between frame.
    fn prepare<'a>(
        &'a mut self,
        neighbors: [Neighbor<'a>; 2],
        t: f32,
        camera: &Camera,
        passage: Option<Passage<'_>>,
    ) -> Result<Warp<'a, 2>, ReconstructError> {
        let size = camera.size();
        if !(0.0..=1.0).contains(&t) {
            return Err(ReconstructError::Time { actual: t });
        }
        for neighbor in &neighbors {
            check_size("neighbour camera", size, neighbor.camera.size())?;
            check_size("neighbour image", size, neighbor.image.size())?;
            check_gbuffer(neighbor.gbuffer, self.scale, size)?;
            if let Some(gradients) = neighbor.gradients {
                check_size("neighbour gradients", size, gradients.size())?;
            }
        }
        for (depth, neighbor) in self.neighbors.iter_mut().zip(&neighbors) {
            let Some(geometry) = &neighbor.gbuffer.geometry else {
                return Err(ReconstructError::Missing { what: "depth" });
            };
            depth.set(neighbor.gbuffer, geometry);
        }
        let cameras = neighbors.map(|n| n.camera);
        self.middle.set(self.level, &self.neighbors, cameras, camera, self.scale, passage);
        Ok(Warp {
            scale: self.scale as usize,
            gather: &self.gather,
            middle: &self.middle,
            depths: self.neighbors.each_ref(),
            images: neighbors.map(|n| n.image),
            gradients: neighbors.map(|n| n.gradients),
            reprojections: neighbors.map(|n| Reprojection::new(camera, n.camera)),
            shares: Passage::to_neighbors(t),
        })
    }
}
