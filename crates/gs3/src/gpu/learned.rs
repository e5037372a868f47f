//! Super sampling refined by a network, on a device: what it is fed, what it remembers.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Slice, Use, constants};
use gs3_neural::model::graph_of;
use gs3_neural::{BoundEngine, GpuEngine, GpuEngineSettings, ImageFormat, MatrixUnit, Precision, Weights};
use gs3_raster::GpuGBuffer;
use gs3_reconstruct::NEAREST_DEPTH;
use gs3_reconstruct::gpu::{
    BoundInterpolator, BoundMotion, GpuImage, GpuInterpolator, GpuMotion, GpuNeighbor, GpuSuperSampler,
    NeighborView,
};
use gs3_scene::Camera;

use super::sized::planes;
use crate::error::PipelineError;
use crate::learned::{NetworkError, UNCERTAIN};

/// `PARTS` of `mean.wgsl`.
pub const PARTS: u32 = 64;

/// `Features` of `features.wgsl`.
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

/// The network with all that it reads and keeps. Frames are made in two places in turn, so everything is bound twice.
pub struct Learned {
    gpu: Gpu,
    size: [u32; 2],
    lr: [u32; 2],
    scale: u32,
    engine: GpuEngine,
    kernels: Kernels,
    motion: GpuMotion,
    uniform: Buffer,
    /// Inputs but images, by the names that the network has for them.
    inputs: Vec<(&'static str, Buffer)>,
    sums: Buffer,
    /// The last refined frame at the present camera.
    previous: GpuImage,
    /// Hidden states of both places.
    hidden: [Buffer; 2],
    bound: [Option<BoundLearned>; 2],
}

/// Entry points of `features.wgsl`.
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
        let numbers = constants(&[("UNCERTAIN", UNCERTAIN), ("NEAREST_DEPTH", NEAREST_DEPTH)]);
        let module = gpu.module("features", &[&numbers, MEAN_WGSL, FEATURES_WGSL])?;
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
    /// What needs the frame before, bound when there is one.
    before: Option<(BoundInterpolator, BoundMotion)>,
}

/// A place of frames: its G-buffer and the refined frame.
pub struct Place<'a> {
    pub gbuffer: &'a GpuGBuffer,
    pub refined: &'a GpuImage,
}

impl Learned {
    /// The network of `weights` for frames of `size`, a multiple of `scale`.
    pub fn new(gpu: &Gpu, weights: &Arc<Weights>, size: [u32; 2], scale: u32) -> Result<Self, PipelineError> {
        let lr = size.map(|side| side / scale);
        let graph = graph_of(&weights.header).map_err(NetworkError::from)?;
        let settings = GpuEngineSettings {
            precision: Precision::of(gpu),
            matrices: MatrixUnit::of(gpu.capabilities()),
            inputs: &[
                ("history", ImageFormat::HalfPixels),
                ("previous", ImageFormat::HalfPixels),
                ("hidden", ImageFormat::Blocks),
            ],
            outputs: Some(&[("color", ImageFormat::HalfPixels), ("hidden", ImageFormat::Blocks)]),
        };
        let engine = GpuEngine::new(gpu, &graph, weights, [lr[1] as usize, lr[0] as usize], &settings)?;
        let bytes = |name: &str| engine.inputs().iter().find(|i| i.name == name).map_or(4, |i| i.bytes);
        let made = [
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
        let make = |name| Ok((name, gpu.buffer(name, Use::Storage, bytes(name))?));
        let inputs = made.into_iter().map(make).collect::<Result<Vec<_>, GpuError>>()?;
        let hidden = || gpu.buffer("hidden", Use::Storage, bytes("hidden"));
        Ok(Self {
            hidden: [hidden()?, hidden()?],
            gpu: gpu.clone(),
            size,
            lr,
            scale,
            engine,
            kernels: Kernels::new(gpu)?,
            motion: GpuMotion::new(gpu, lr)?,
            uniform: gpu.buffer("features", Use::Uniform, size_of::<FeaturesUniform>() as u64)?,
            inputs,
            sums: gpu.buffer("sums", Use::Storage, u64::from(PARTS) * 8)?,
            previous: GpuImage::new(gpu, size)?,
            bound: [None, None],
        })
    }

    fn input(&self, name: &str) -> Result<&Buffer, GpuError> {
        let found = self.inputs.iter().find(|(n, _)| *n == name).map(|(_, buffer)| buffer);
        found.ok_or_else(|| missing(name))
    }

    /// Records the refinement of `analytic`, made without learning for `view`, into place `current`. `last` is the
    /// view of the other place, the frame before, where there is one.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        (sampler, interpolator): (&GpuSuperSampler, &GpuInterpolator),
        analytic: &GpuImage,
        places: [Place<'_>; 2],
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
        let Some(bound) = &self.bound[current] else { return Ok(()) };
        let lr_camera = view.camera.low_resolution(self.scale);
        recorder.write(&self.uniform.slice(), &[self.uniform_of(&lr_camera, view.jitter)])?;
        match (last, &bound.before) {
            (Some(last), Some((warp, motion))) => {
                // Any moment will do: what is wanted is the frame before, not a blend.
                interpolator.record(recorder, warp, [last, view], 0.5, &view.camera)?;
                recorder.stage("super_sample.features");
                let before = last.camera.low_resolution(self.scale);
                // States live on the LR grid itself, wherever within its pixels the samples lie.
                self.motion.record(recorder, motion, [(&lr_camera, [0.0; 2]), (&before, [0.0; 2])])?;
                recorder.dispatch(&bound.previous_innovations, over(self.lr));
                recorder.dispatch(&bound.shares, over(self.size));
            }
            _ => {
                recorder.stage("super_sample.features");
                for name in ["share", "previous_innovation", "motion", "validity"] {
                    recorder.clear(&self.input(name)?.slice());
                }
                recorder.clear(&self.hidden[1 - current].slice());
                // Its share is 0, but the network looks at it.
                recorder.copy(&analytic.pixels().slice(), &self.previous.pixels().slice());
            }
        }
        recorder.stage("super_sample.features");
        recorder.dispatch(&bound.planes, over(self.lr));
        recorder.dispatch(&bound.drifts, over(self.size));
        recorder.dispatch(&bound.sum_depths, [PARTS, 1, 1]);
        recorder.dispatch(&bound.geometry, [self.lr[0].div_ceil(256), self.lr[1], 1]);
        recorder.stage("super_sample.network");
        bound.engine.record(recorder);
        Ok(())
    }

    fn uniform_of(&self, lr_camera: &Camera, jitter: [f32; 2]) -> FeaturesUniform {
        let intrinsics = lr_camera.intrinsics();
        let [fx, fy, cx, cy] = [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy].map(|v| v as f32);
        let (size, lr) = (self.size, self.lr);
        FeaturesUniform { size, lr, jitter, focal: [fx, fy], center: [cx, cy], _pad: [0.0; 2] }
    }

    fn bind(
        &self,
        sampler: &GpuSuperSampler,
        analytic: &GpuImage,
        current: usize,
        now: &Place<'_>,
    ) -> Result<BoundLearned, PipelineError> {
        let gpu = &self.gpu;
        let gbuffer = planes(now.gbuffer)?;
        let innovation = sampler.innovation().ok_or_else(|| missing("innovation"))?;
        let mut all: Vec<(&str, Slice<'_>)> =
            self.inputs.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
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
        let mut inputs: Vec<(&str, Slice<'_>)> =
            self.inputs.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
        inputs.push(("history", analytic.pixels().slice()));
        inputs.push(("innovation", innovation.slice()));
        inputs.push(("previous", self.previous.pixels().slice()));
        inputs.push(("hidden", self.hidden[1 - current].slice()));
        let outputs = [("color", now.refined.pixels().slice()), ("hidden", self.hidden[current].slice())];
        Ok(BoundLearned {
            planes: planes.bind(gpu, &all)?,
            sum_depths: sum_depths.bind(gpu, &all)?,
            geometry: geometry.bind(gpu, &all)?,
            previous_innovations: previous_innovations.bind(gpu, &all)?,
            shares: shares.bind(gpu, &all)?,
            drifts: drifts.bind(gpu, &all)?,
            engine: self.engine.bind(gpu, &inputs, &outputs)?,
            before: None,
        })
    }

    fn bind_before(
        &self,
        interpolator: &GpuInterpolator,
        analytic: &GpuImage,
        now: &Place<'_>,
        other: &Place<'_>,
    ) -> Result<(BoundInterpolator, BoundMotion), PipelineError> {
        let [now_planes, other_planes] = [planes(now.gbuffer)?, planes(other.gbuffer)?];
        let before = GpuNeighbor { image: other.refined, planes: other_planes };
        let after = GpuNeighbor { image: analytic, planes: now_planes };
        let warp = interpolator.bind_before(&before, &after, &self.previous, self.input("share")?)?;
        let (flow, validity) = (self.input("motion")?, self.input("validity")?);
        let motion = self.motion.bind(now_planes.dx_median, other_planes.dx_median, flow, validity)?;
        Ok((warp, motion))
    }
}

/// The network wants an input that is not there.
pub fn missing(name: &str) -> GpuError {
    GpuError::Bindings {
        kernel: "the network".to_owned(),
        expected: name.to_owned(),
        actual: "no such input".to_owned(),
    }
}

/// Workgroups of 64×4 over a grid.
fn over(size: [u32; 2]) -> [u32; 3] {
    [size[0].div_ceil(64), size[1].div_ceil(4), 1]
}

/// The mean depth, which both networks are told depths by.
pub const MEAN_WGSL: &str = include_str!("mean.wgsl");

const FEATURES_WGSL: &str = include_str!("features.wgsl");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shader_is_valid_and_its_struct_lies_as_here() {
        let numbers = constants(&[("UNCERTAIN", UNCERTAIN), ("NEAREST_DEPTH", NEAREST_DEPTH)]);
        let source = [&numbers[..], MEAN_WGSL, FEATURES_WGSL];
        gs3_compute::assert_layout!(
            &source,
            Features,
            FeaturesUniform { size, lr, jitter, focal, center, _pad }
        );
    }
}
