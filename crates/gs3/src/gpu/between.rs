//! Frames between refined by a network, on a device: what it is fed, what it remembers.

use std::collections::HashMap;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Recorder, Slice, Use};
use gs3_neural::model::graph_of;
use gs3_neural::{BoundEngine, GpuEngine, GpuEngineSettings, ImageFormat, MatrixUnit, Precision, Weights};
use gs3_reconstruct::gpu::{
    BoundInterpolator, BoundMotion, GpuImage, GpuInterpolator, GpuMotion, GpuNeighbor, NeighborView,
};
use gs3_scene::Camera;

use super::learned::{MEAN_WGSL, PARTS, missing};
use crate::error::PipelineError;
use crate::learned::NetworkError;

const BETWEEN_WGSL: &str = include_str!("between.wgsl");

/// `Features` of `between.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct FeaturesUniform {
    lr: [u32; 2],
    t: f32,
    _pad: u32,
}

/// Which frame between: before which of the two sides, and in which place there.
type At = (usize, usize);

/// The network with all that it reads and keeps. A frame that is submitted again reads what it read before: frames
/// between are remembered beside the side they lie before, and read those of the other side.
pub struct LearnedBetween {
    gpu: Gpu,
    lr: [u32; 2],
    scale: u32,
    engine: GpuEngine,
    sum_depths: Kernel,
    geometry: Kernel,
    /// Both neighbours at the pose between.
    warped: [GpuImage; 2],
    /// Inputs but images and state, by the names that the network has for them.
    inputs: Vec<(&'static str, Buffer)>,
    sums: Buffer,
    /// By side, and place between.
    slots: [Vec<Slot>; 2],
    /// By frame, and the one before it.
    bound: HashMap<(At, At), BoundBetween>,
}

/// A frame between.
struct Slot {
    hidden: Buffer,
    /// Its depths, as a G-buffer has them.
    median: Buffer,
    uniform: Buffer,
    motion: GpuMotion,
    /// What saw it, if it belongs to the last frame.
    camera: Option<Camera>,
}

struct BoundBetween {
    warp: BoundInterpolator,
    sum_depths: Bound,
    geometry: Bound,
    motion: BoundMotion,
    engine: BoundEngine,
}

/// What a frame between is made from, and where.
pub struct Between<'a> {
    pub interpolator: &'a GpuInterpolator,
    pub neighbors: [GpuNeighbor<'a>; 2],
    pub views: [&'a NeighborView; 2],
    pub t: f32,
    pub camera: &'a Camera,
    pub out: &'a GpuImage,
}

impl LearnedBetween {
    /// The network of `weights` for up to `count` frames between frames of `size`, a multiple of `scale`.
    pub fn new(
        gpu: &Gpu,
        weights: &Arc<Weights>,
        size: [u32; 2],
        scale: u32,
        count: usize,
    ) -> Result<Self, PipelineError> {
        let lr = size.map(|side| side / scale);
        let graph = graph_of(&weights.header).map_err(NetworkError::from)?;
        let settings = GpuEngineSettings {
            precision: Precision::of(gpu),
            matrices: MatrixUnit::of(gpu.capabilities()),
            inputs: &[
                ("before", ImageFormat::HalfPixels),
                ("after", ImageFormat::HalfPixels),
                ("hidden", ImageFormat::Blocks),
            ],
            outputs: Some(&[("color", ImageFormat::HalfPixels), ("hidden", ImageFormat::Blocks)]),
        };
        let engine = GpuEngine::new(gpu, &graph, weights, [lr[1] as usize, lr[0] as usize], &settings)?;
        let bytes = |name: &str| engine.inputs().iter().find(|i| i.name == name).map_or(4, |i| i.bytes);
        let make = |name| Ok((name, gpu.buffer(name, Use::Storage, bytes(name))?));
        let inputs = ["share", "geometry", "motion", "validity"]
            .into_iter()
            .map(make)
            .collect::<Result<_, GpuError>>()?;
        let slot = |_| {
            Ok(Slot {
                hidden: gpu.buffer("hidden", Use::Storage, bytes("hidden"))?,
                median: gpu.buffer("median", Use::Storage, u64::from(lr[0]) * u64::from(lr[1]) * 16)?,
                uniform: gpu.buffer("features", Use::Uniform, size_of::<FeaturesUniform>() as u64)?,
                motion: GpuMotion::new(gpu, lr)?,
                camera: None,
            })
        };
        let module = gpu.module("between", &[MEAN_WGSL, BETWEEN_WGSL])?;
        let slots = || (0..count).map(slot).collect::<Result<Vec<_>, PipelineError>>();
        Ok(Self {
            slots: [slots()?, slots()?],
            gpu: gpu.clone(),
            lr,
            scale,
            engine,
            sum_depths: module.kernel(gpu, "sum_depths", &[])?,
            geometry: module.kernel(gpu, "geometry_of", &[])?,
            warped: [GpuImage::new(gpu, size)?, GpuImage::new(gpu, size)?],
            inputs,
            sums: gpu.buffer("sums", Use::Storage, u64::from(PARTS) * 8)?,
            bound: HashMap::new(),
        })
    }

    /// Begins a frame of side `current`: it has no frames between yet.
    pub fn begin(&mut self, current: usize) {
        self.slots[current].iter_mut().for_each(|slot| slot.camera = None);
    }

    /// Records the `k`-th frame between the last frame and that of side `current`. Its hidden state comes from the
    /// one before it, where there is one.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        current: usize,
        k: usize,
        between: &Between<'_>,
    ) -> Result<(), PipelineError> {
        let at = (current, k);
        let last = |side: usize| self.slots[side].iter().rposition(|slot| slot.camera.is_some());
        // Where there was none, any state will do: it is cleared.
        let before = if k > 0 { (current, k - 1) } else { (1 - current, last(1 - current).unwrap_or(0)) };
        if !self.bound.contains_key(&(at, before)) {
            let bound = self.bind(at, before, between)?;
            self.bound.insert((at, before), bound);
        }
        let Some(bound) = self.bound.get(&(at, before)) else { return Ok(()) };
        let Between { interpolator, views, t, camera, .. } = *between;
        let (slot, previous) = (&self.slots[at.0][at.1], &self.slots[before.0][before.1]);
        recorder.write(&slot.uniform.slice(), &[FeaturesUniform { lr: self.lr, t, _pad: 0 }])?;
        interpolator.record(recorder, &bound.warp, views, t, camera)?;
        recorder.stage("interpolate.features");
        recorder.dispatch(&bound.sum_depths, [PARTS, 1, 1]);
        recorder.dispatch(&bound.geometry, [self.lr[0].div_ceil(256), self.lr[1], 1]);
        match &previous.camera {
            Some(last) => {
                let [now, last] = [camera, last].map(|camera| camera.low_resolution(self.scale));
                // States live on the LR grid itself.
                slot.motion.record(recorder, &bound.motion, [(&now, [0.0; 2]), (&last, [0.0; 2])])?;
            }
            None => {
                recorder.clear(&self.input("motion")?.slice());
                recorder.clear(&self.input("validity")?.slice());
                recorder.clear(&previous.hidden.slice());
            }
        }
        recorder.stage("interpolate.network");
        bound.engine.record(recorder);
        self.slots[current][k].camera = Some(*camera);
        Ok(())
    }

    fn input(&self, name: &str) -> Result<&Buffer, GpuError> {
        let found = self.inputs.iter().find(|(n, _)| *n == name).map(|(_, buffer)| buffer);
        found.ok_or_else(|| missing(name))
    }

    fn bind(&self, at: At, before: At, between: &Between<'_>) -> Result<BoundBetween, PipelineError> {
        let gpu = &self.gpu;
        let (slot, previous) = (&self.slots[at.0][at.1], &self.slots[before.0][before.1]);
        let [share, geometry, flow, validity] =
            [self.input("share")?, self.input("geometry")?, self.input("motion")?, self.input("validity")?];
        let middle = between.interpolator.inverse_depth().ok_or_else(|| missing("middle"))?;
        let features = [
            ("features", slot.uniform.slice()),
            ("middle", middle.slice()),
            ("geometry", geometry.slice()),
            ("median", slot.median.slice()),
            ("sums", self.sums.slice()),
        ];
        let mut inputs: Vec<(&str, Slice<'_>)> =
            self.inputs.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
        inputs.push(("before", self.warped[0].pixels().slice()));
        inputs.push(("after", self.warped[1].pixels().slice()));
        inputs.push(("hidden", previous.hidden.slice()));
        let outputs = [("color", between.out.pixels().slice()), ("hidden", slot.hidden.slice())];
        let [first, second] = &between.neighbors;
        Ok(BoundBetween {
            warp: between.interpolator.bind_both(first, second, self.warped.each_ref(), share)?,
            sum_depths: self.sum_depths.bind(gpu, &features)?,
            geometry: self.geometry.bind(gpu, &features)?,
            motion: slot.motion.bind(&slot.median, &previous.median, flow, validity)?,
            engine: self.engine.bind(gpu, &inputs, &outputs)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shader_is_valid_and_its_struct_lies_as_here() {
        gs3_compute::assert_layout!(&[MEAN_WGSL, BETWEEN_WGSL], Features, FeaturesUniform { lr, t, _pad });
    }
}
