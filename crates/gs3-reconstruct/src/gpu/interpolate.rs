//! An in-between frame of two reconstructed frames, without learning, on a GPU.

use std::fmt;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Use};
use gs3_scene::{Camera, Size};

use super::error::GpuReconstructError;
use super::frame::rows;
use super::image::{GpuImage, GpuPlanes};
use super::plan::InterpolatePlan;
use super::shaders;
use crate::cpu::warp::offset;
use crate::error::{ReconstructError, check_frame_size, check_jitter, check_scale, check_size};
use crate::reprojection::Reprojection;

/// `Neighbor` of `in_between.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct NeighborUniform {
    to_middle: [[f32; 4]; 3],
    from_middle: [[f32; 4]; 3],
    jitter: [f32; 2],
    _pad: [f32; 2],
}

/// `InBetween` of `in_between.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct InBetweenUniform {
    size: [u32; 2],
    lr: [u32; 2],
    scale: u32,
    offset: u32,
    t: f32,
    _pad: u32,
    neighbors: [NeighborUniform; 2],
}

/// A reconstructed frame in device memory, next to the in-between frame.
#[derive(Clone, Copy, Debug)]
pub struct GpuNeighbor<'a> {
    /// The HR frame.
    pub image: &'a GpuImage,
    /// The LR frame that the image was reconstructed from.
    pub planes: GpuPlanes<'a>,
}

/// The view of a neighbour.
#[derive(Clone, Copy, Debug)]
pub struct NeighborView {
    /// The HR camera.
    pub camera: Camera,
    /// Offset of the LR samples from the pixel centres, LR pixels.
    pub jitter: [f32; 2],
}

/// Makes in-between frames of one size from two neighbours in device memory, by the rules of [`crate::Interpolator`].
/// Nothing is allocated after construction and binding.
///
/// Holes of the middle depth more than 64 LR pixels from any sample become infinitely far. The CPU fills holes up to
/// the border of the picture.
pub struct GpuInterpolator {
    gpu: Gpu,
    scale: u32,
    plan: InterpolatePlan,
    buffers: Vec<(&'static str, Buffer)>,
    scatter_depth: Kernel,
    fill: Kernel,
    blend: Kernel,
    separate: Kernel,
    separate_both: Kernel,
}

impl fmt::Debug for GpuInterpolator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuInterpolator").field("scale", &self.scale).finish_non_exhaustive()
    }
}

/// The outputs made from two neighbours.
#[derive(Clone, Copy)]
enum Make<'a> {
    Blend,
    /// The first neighbour, with its visibility.
    First(&'a Buffer),
    /// Both neighbours, and the share of the second.
    Both(&'a GpuImage, &'a Buffer),
}

/// Interpolation of two images into a third, or warping of the first or both.
#[derive(Clone, Debug)]
pub struct BoundInterpolator {
    /// Size of the bound images.
    size: Size,
    uniform: Buffer,
    scatter_depth: Bound,
    fill: Bound,
    make: Bound,
    /// Names of the stages.
    stages: [&'static str; 2],
}

impl GpuInterpolator {
    /// An interpolator for frames of `size`, `scale` (1 to [`crate::MAX_SCALE`]) times the size of their G-buffers.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `scale` is not supported, or the device has too little memory for the size.
    pub fn new(gpu: &Gpu, scale: u32, size: Size) -> Result<Self, GpuReconstructError> {
        check_scale(scale)?;
        check_frame_size(size)?;
        let plan = InterpolatePlan::new(&gpu.capabilities().limits, size, scale)?;
        let make = |(name, bytes): (&'static str, u64)| Ok((name, gpu.buffer(name, Use::Storage, bytes)?));
        let buffers = plan.buffers().into_iter().map(make).collect::<Result<Vec<_>, GpuError>>()?;
        let kernel =
            |label: &str, source: String, entry: &str| gpu.module(label, &[&source])?.kernel(gpu, entry, &[]);
        let warp = gpu.module("warp", &[&shaders::warp()])?;
        Ok(Self {
            gpu: gpu.clone(),
            scale,
            plan,
            buffers,
            scatter_depth: kernel("neighbor_depth", shaders::neighbor_depth(), "scatter_depth")?,
            fill: kernel("middle_depth", shaders::middle_depth(), "fill")?,
            blend: warp.kernel(gpu, "blend", &[])?,
            separate: warp.kernel(gpu, "separate", &[])?,
            separate_both: warp.kernel(gpu, "separate_both", &[])?,
        })
    }

    /// Binds the interpolation of `before` and `after` into `out`.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if an image has another size, or the device refuses.
    pub fn bind(
        &self,
        before: &GpuNeighbor<'_>,
        after: &GpuNeighbor<'_>,
        out: &GpuImage,
    ) -> Result<BoundInterpolator, GpuReconstructError> {
        self.bind_to(before, after, out, Make::Blend)
    }

    /// Binds the warp of `before` alone to a pose between it and `after`, into `out`. The visibility is written to
    /// `visibility`, an f32 a pixel, `[0, 1]` ([`crate::Warped::visibility`]).
    ///
    /// # Errors
    /// [`GpuReconstructError`] if an image has another size, or the device refuses.
    pub fn bind_before(
        &self,
        before: &GpuNeighbor<'_>,
        after: &GpuNeighbor<'_>,
        out: &GpuImage,
        visibility: &Buffer,
    ) -> Result<BoundInterpolator, GpuReconstructError> {
        self.bind_to(before, after, out, Make::First(visibility))
    }

    /// Binds the warp of `before` and `after` to a pose between them, without blending, into `out`. The second
    /// neighbour's share of the blend is written to `share`, an f32 a pixel, `[0, 1]` ([`crate::Warped`]).
    ///
    /// # Errors
    /// [`GpuReconstructError`] if an image has another size, or the device refuses.
    pub fn bind_both(
        &self,
        before: &GpuNeighbor<'_>,
        after: &GpuNeighbor<'_>,
        out: [&GpuImage; 2],
        share: &Buffer,
    ) -> Result<BoundInterpolator, GpuReconstructError> {
        self.bind_to(before, after, out[0], Make::Both(out[1], share))
    }

    /// The inverse depths of the last recorded in-between frame at its LR pixel centres, an f32 a sample. Holes are
    /// filled; 0 where there is no surface.
    #[must_use]
    pub fn inverse_depth(&self) -> Option<&Buffer> {
        self.buffers.iter().find(|(name, _)| *name == "middle").map(|(_, buffer)| buffer)
    }

    fn bind_to(
        &self,
        before: &GpuNeighbor<'_>,
        after: &GpuNeighbor<'_>,
        out: &GpuImage,
        make: Make<'_>,
    ) -> Result<BoundInterpolator, GpuReconstructError> {
        let second = if let Make::Both(second, _) = make { second } else { out };
        let (neighbor, made) = ("neighbour image", "image of the in-between frame");
        for (what, image) in [(neighbor, before.image), (neighbor, after.image), (made, out), (made, second)]
        {
            check_size(what, self.plan.size, image.size())?;
        }
        for planes in [&before.planes, &after.planes] {
            planes.check(self.plan.lr)?;
        }
        let uniform = self.gpu.buffer("in_between", Use::Uniform, size_of::<InBetweenUniform>() as u64)?;
        let mut all: Vec<_> = self.buffers.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
        all.push(("in_between", uniform.slice()));
        all.push(("before_median", before.planes.dx_median.slice()));
        all.push(("after_median", after.planes.dx_median.slice()));
        all.push(("before", before.image.pixels().slice()));
        all.push(("after", after.image.pixels().slice()));
        all.push(("result", out.pixels().slice()));
        let between = ["interpolate.depth", "interpolate.warp"];
        let (make, stages) = match make {
            Make::Blend => (&self.blend, between),
            Make::First(visibility) => {
                all.push(("visibility", visibility.slice()));
                (&self.separate, ["super_sample.depth", "super_sample.warp"])
            }
            Make::Both(second, share) => {
                all.push(("second_result", second.pixels().slice()));
                all.push(("share", share.slice()));
                (&self.separate_both, between)
            }
        };
        let (scatter_depth, fill) =
            (self.scatter_depth.bind(&self.gpu, &all)?, self.fill.bind(&self.gpu, &all)?);
        let make = make.bind(&self.gpu, &all)?;
        Ok(BoundInterpolator { size: self.plan.size, uniform, scatter_depth, fill, make, stages })
    }

    /// Records the interpolation of the image of `camera` at time `t` ∈ `[0, 1]` between `before` (0) and `after`
    /// (1), the views of the bound images. Each binding may be recorded at most once in a submission.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if a size or jitter does not fit, `t` is outside `[0, 1]`, or the device is lost.
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        bound: &BoundInterpolator,
        [before, after]: [&NeighborView; 2],
        t: f32,
        camera: &Camera,
    ) -> Result<(), GpuReconstructError> {
        if !(0.0..=1.0).contains(&t) {
            return Err(ReconstructError::Time { actual: t }.into());
        }
        let size = self.plan.size;
        check_size("images bound", size, bound.size)?;
        for view in [before, after] {
            check_size("neighbour camera", size, view.camera.size())?;
            check_jitter(view.jitter)?;
        }
        check_size("camera", size, camera.size())?;
        let neighbor = |view: &NeighborView| NeighborUniform {
            to_middle: rows(&Reprojection::new(&view.camera, camera)),
            from_middle: rows(&Reprojection::new(camera, &view.camera)),
            jitter: view.jitter,
            _pad: [0.0; 2],
        };
        let uniform = InBetweenUniform {
            size: size.to_array(),
            lr: self.plan.lr.to_array(),
            scale: self.scale,
            offset: offset(self.scale as usize) as u32,
            t,
            _pad: 0,
            neighbors: [neighbor(before), neighbor(after)],
        };
        recorder.write(&bound.uniform.slice(), &[uniform])?;
        recorder.stage(bound.stages[0]);
        if let Some((_, splatted)) = self.buffers.iter().find(|(name, _)| *name == "splatted") {
            recorder.clear(&splatted.slice());
        }
        recorder.dispatch(&bound.scatter_depth, self.plan.over_neighbors());
        recorder.dispatch(&bound.fill, self.plan.over_samples);
        recorder.stage(bound.stages[1]);
        recorder.dispatch(&bound.make, self.plan.over_pixels);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("in_between.wgsl");
        assert_layout!(&[source], Neighbor, NeighborUniform { to_middle, from_middle, jitter, _pad });
        assert_layout!(
            &[source],
            InBetween,
            InBetweenUniform { size, lr, scale, offset, t, _pad, neighbors }
        );
    }
}
