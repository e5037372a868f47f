//! Super sampling refined by a network, on a device: inputs and state. `../super_sampler.rs` has the same on the CPU.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Use, constants};
use gs3_neural::{BoundEngine, Weights};
use gs3_raster::GpuGBuffer;
use gs3_reconstruct::NEAREST_DEPTH;
use gs3_reconstruct::gpu::{
    BoundInterpolator, BoundMotion, GpuImage, GpuInterpolator, GpuMotion, GpuNeighbor, GpuSuperSampler,
    NeighborView,
};
use gs3_scene::{Camera, Size};

use super::network::{GpuNetwork, missing};
use super::{PARTS, THREADS, mean_source, planes};
use crate::error::PipelineError;
use crate::learned::UNCERTAIN;

/// Sides of the workgroups with an invocation a pixel or a sample.
const WORKGROUP: [u32; 2] = [64, 4];

/// Inputs of the network: the entries of [`Kernels`].
fn features_source() -> String {
    let numbers = constants(&[("UNCERTAIN", UNCERTAIN), ("NEAREST_DEPTH", NEAREST_DEPTH)]);
    let sizes = constants(&[("WORKGROUP_X", WORKGROUP[0]), ("WORKGROUP_Y", WORKGROUP[1])]);
    numbers + &sizes + &mean_source() + include_str!("super_sampler.wgsl")
}

/// `Features` of `super_sampler.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct FeaturesUniform {
    size: [u32; 2],
    lr: [u32; 2],
    jitter: [f32; 2],
    focal: [f32; 2],
    center: [f32; 2],
    _pad: [f32; 2],
}

/// The network with all memory that it reads and keeps. Frames alternate between two places, so everything is bound
/// twice.
pub struct GpuLearnedSuperSampler {
    gpu: Gpu,
    size: Size,
    lr: Size,
    scale: u32,
    network: GpuNetwork,
    kernels: Kernels,
    motion: GpuMotion,
    uniform: Buffer,
    sums: Buffer,
    /// The last refined frame, reprojected to the current camera.
    previous: GpuImage,
    /// Hidden states of the frames in both places.
    hidden: [Buffer; 2],
    bound: [Option<BoundLearned>; 2],
}

/// Entry points of `super_sampler.wgsl`.
struct Kernels {
    planes: Kernel,
    sum_depths: Kernel,
    geometry: Kernel,
    previous_innovations: Kernel,
    shares: Kernel,
    drifts: Kernel,
}

impl Kernels {
    fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let module = gpu.module("super_sampler features", &[&features_source()])?;
        let kernel = |entry: &str| module.kernel(gpu, entry, &[]);
        Ok(Self {
            planes: kernel("planes")?,
            sum_depths: kernel("sum_depths")?,
            geometry: kernel("geometry_of")?,
            previous_innovations: kernel("previous_innovations")?,
            shares: kernel("shares")?,
            drifts: kernel("drifts")?,
        })
    }
}

struct BoundLearned {
    planes: Bound,
    sum_depths: Bound,
    geometry: Bound,
    previous_innovations: Bound,
    shares: Bound,
    drifts: Bound,
    engine: BoundEngine,
    /// Work on the previous frame, bound once there is one.
    before: Option<(BoundInterpolator, BoundMotion)>,
}

/// A refined frame and the G-buffer that it was made from.
pub struct Refined<'a> {
    pub gbuffer: &'a GpuGBuffer,
    pub image: &'a GpuImage,
}

impl GpuLearnedSuperSampler {
    /// The network of `weights` for frames of `size`, a multiple of `scale`.
    pub fn new(gpu: &Gpu, weights: &Arc<Weights>, size: Size, scale: u32) -> Result<Self, PipelineError> {
        let lr = size.map(|side| side / scale);
        let planes = [
            "drift",
            "previous_innovation",
            "share",
            "color",
            "gradients",
            "compressed",
            "geometry",
            "jitter",
            "motion",
            "validity",
        ];
        let network = GpuNetwork::new(gpu, weights, lr, ["history", "previous"], &planes)?;
        Ok(Self {
            hidden: [network.buffer(gpu, "hidden")?, network.buffer(gpu, "hidden")?],
            gpu: gpu.clone(),
            size,
            lr,
            scale,
            network,
            kernels: Kernels::new(gpu)?,
            motion: GpuMotion::new(gpu, lr)?,
            uniform: gpu.buffer("features", Use::Uniform, size_of::<FeaturesUniform>() as u64)?,
            sums: gpu.buffer("sums", Use::Storage, u64::from(PARTS) * 8)?,
            previous: GpuImage::new(gpu, size)?,
            bound: [None, None],
        })
    }

    /// Records the refinement of `analytic`, the analytic frame of `view`, into place `current`. `last` is the view
    /// of the previous frame, in the other place, if there is one.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        (sampler, interpolator): (&GpuSuperSampler, &GpuInterpolator),
        analytic: &GpuImage,
        places: [Refined<'_>; 2],
        current: usize,
        view: &NeighborView,
        last: Option<&NeighborView>,
    ) -> Result<(), PipelineError> {
        let [now, other] = [&places[current], &places[1 - current]];
        if self.bound[current].is_none() {
            self.bound[current] = Some(self.bind(sampler, analytic, current, now)?);
        }
        if last.is_some() && self.bound[current].as_ref().is_some_and(|bound| bound.before.is_none()) {
            let before = self.bind_before(interpolator, analytic, now, other)?;
            self.bound[current].iter_mut().for_each(|bound| bound.before = Some(before.clone()));
        }
        let Some(bound) = &self.bound[current] else {
            return Err(PipelineError::Internal { expected: "the network's kernels" });
        };
        let lr_camera = view.camera.low_resolution(self.scale);
        recorder.write(&self.uniform.slice(), &[self.uniform_of(&lr_camera, view.jitter)])?;
        match (last, &bound.before) {
            (Some(last), Some((warp, motion))) => {
                // Any moment will do: only the warped previous frame is used, not a blend.
                interpolator.record(recorder, warp, [last, view], 0.5, &view.camera)?;
                recorder.stage("super_sample.features");
                let before = last.camera.low_resolution(self.scale);
                // States lie on the LR grid itself, independent of the samples' places within pixels.
                self.motion.record(recorder, motion, [(&lr_camera, [0.0; 2]), (&before, [0.0; 2])])?;
                recorder.dispatch(&bound.previous_innovations, over(self.lr));
                recorder.dispatch(&bound.shares, over(self.size));
            }
            _ => {
                recorder.stage("super_sample.features");
                for name in ["share", "previous_innovation", "motion", "validity"] {
                    recorder.clear(&self.network.input(name)?.slice());
                }
                recorder.clear(&self.hidden[1 - current].slice());
                // The previous frame's share is 0, but the network still reads the image.
                recorder.copy(&analytic.pixels().slice(), &self.previous.pixels().slice());
            }
        }
        recorder.stage("super_sample.features");
        recorder.dispatch(&bound.planes, over(self.lr));
        recorder.dispatch(&bound.drifts, over(self.size));
        recorder.dispatch(&bound.sum_depths, [PARTS, 1, 1]);
        recorder.dispatch(&bound.geometry, [self.lr.width.div_ceil(THREADS), self.lr.height, 1]);
        recorder.stage("super_sample.network");
        bound.engine.record(recorder);
        Ok(())
    }

    fn uniform_of(&self, lr_camera: &Camera, jitter: [f32; 2]) -> FeaturesUniform {
        let intrinsics = lr_camera.intrinsics();
        let [fx, fy, cx, cy] = [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy].map(|v| v as f32);
        let (size, lr) = (self.size.to_array(), self.lr.to_array());
        FeaturesUniform { size, lr, jitter, focal: [fx, fy], center: [cx, cy], _pad: [0.0; 2] }
    }

    fn bind(
        &self,
        sampler: &GpuSuperSampler,
        analytic: &GpuImage,
        current: usize,
        now: &Refined<'_>,
    ) -> Result<BoundLearned, PipelineError> {
        let gpu = &self.gpu;
        let gbuffer = planes(now.gbuffer)?;
        let innovation = sampler.innovation().ok_or_else(|| missing("innovation"))?;
        let mut all = self.network.slices();
        all.extend([
            ("features", self.uniform.slice()),
            ("color_alpha", gbuffer.color_alpha.slice()),
            ("dx_median", gbuffer.dx_median.slice()),
            ("dy_expected", gbuffer.dy_expected.slice()),
            ("normal", now.gbuffer.normal().unwrap_or(gbuffer.color_alpha).slice()),
            ("sums", self.sums.slice()),
            ("innovation", innovation.slice()),
            ("history", analytic.pixels().slice()),
            ("previous", self.previous.pixels().slice()),
        ]);
        let Kernels { planes, sum_depths, geometry, previous_innovations, shares, drifts } = &self.kernels;
        let mut inputs = self.network.slices();
        inputs.push(("history", analytic.pixels().slice()));
        inputs.push(("innovation", innovation.slice()));
        inputs.push(("previous", self.previous.pixels().slice()));
        inputs.push(("hidden", self.hidden[1 - current].slice()));
        let outputs = [("color", now.image.pixels().slice()), ("hidden", self.hidden[current].slice())];
        Ok(BoundLearned {
            planes: planes.bind(gpu, &all)?,
            sum_depths: sum_depths.bind(gpu, &all)?,
            geometry: geometry.bind(gpu, &all)?,
            previous_innovations: previous_innovations.bind(gpu, &all)?,
            shares: shares.bind(gpu, &all)?,
            drifts: drifts.bind(gpu, &all)?,
            engine: self.network.engine.bind(gpu, &inputs, &outputs)?,
            before: None,
        })
    }

    fn bind_before(
        &self,
        interpolator: &GpuInterpolator,
        analytic: &GpuImage,
        now: &Refined<'_>,
        other: &Refined<'_>,
    ) -> Result<(BoundInterpolator, BoundMotion), PipelineError> {
        let [now_planes, other_planes] = [planes(now.gbuffer)?, planes(other.gbuffer)?];
        let before = GpuNeighbor { image: other.image, planes: other_planes };
        let after = GpuNeighbor { image: analytic, planes: now_planes };
        let warp = interpolator.bind_before(&before, &after, &self.previous, self.network.input("share")?)?;
        let (flow, validity) = (self.network.input("motion")?, self.network.input("validity")?);
        let motion = self.motion.bind(now_planes.dx_median, other_planes.dx_median, flow, validity)?;
        Ok((warp, motion))
    }
}

/// Workgroups that cover a grid.
const fn over(size: Size) -> [u32; 3] {
    [size.width.div_ceil(WORKGROUP[0]), size.height.div_ceil(WORKGROUP[1]), 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shader_is_valid_and_its_struct_lies_as_here() {
        gs3_compute::assert_layout!(
            &[&features_source()],
            Features,
            FeaturesUniform { size, lr, jitter, focal, center, _pad }
        );
    }
}
