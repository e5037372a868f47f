//! Frame interpolation refined by a network, on a device: inputs and state. `../interpolator.rs` has the same on the
//! CPU.

use std::collections::HashMap;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, Kernel, Recorder, Use};
use gs3_neural::{BoundEngine, Weights};
use gs3_reconstruct::gpu::{
    BoundInterpolator, BoundMotion, GpuImage, GpuInterpolator, GpuMotion, GpuNeighbor, NeighborView,
};
use gs3_scene::{Camera, Size};

use super::network::{GpuNetwork, missing};
use super::{PARTS, THREADS, mean_source};
use crate::error::PipelineError;

/// Inputs of the network: entries `sum_depths` and `geometry_of`.
fn features_source() -> String {
    mean_source() + include_str!("interpolator.wgsl")
}

/// `Features` of `interpolator.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct FeaturesUniform {
    lr: [u32; 2],
    t: f32,
    _pad: u32,
}

/// An in-between frame: the index of the side that it lies before, and its index among the in-between frames.
type At = (usize, usize);

/// The network with all memory that it reads and keeps. A frame that is submitted again must read the same inputs
/// again. So in-between frames are stored with the side they lie before, and read the in-between frames of the other
/// side.
pub struct GpuLearnedInterpolator {
    gpu: Gpu,
    lr: Size,
    scale: u32,
    network: GpuNetwork,
    sum_depths: Kernel,
    geometry: Kernel,
    /// Both neighbours, warped to the pose of the in-between frame.
    warped: [GpuImage; 2],
    sums: Buffer,
    /// By side, and index of the in-between frame.
    slots: [Vec<Slot>; 2],
    /// By in-between frame, and the in-between frame before it.
    bound: HashMap<(At, At), BoundInBetween>,
}

/// An in-between frame.
struct Slot {
    hidden: Buffer,
    /// The frame's depths, in a G-buffer's layout.
    median: Buffer,
    uniform: Buffer,
    motion: GpuMotion,
    /// The frame's camera, if the frame belongs to the last rendered frame.
    camera: Option<Camera>,
}

struct BoundInBetween {
    warp: BoundInterpolator,
    sum_depths: Bound,
    geometry: Bound,
    motion: BoundMotion,
    engine: BoundEngine,
}

/// The inputs of an in-between frame, and its output.
pub struct InBetween<'a> {
    pub interpolator: &'a GpuInterpolator,
    pub neighbors: [GpuNeighbor<'a>; 2],
    pub views: [&'a NeighborView; 2],
    pub t: f32,
    pub camera: &'a Camera,
    pub out: &'a GpuImage,
}

impl GpuLearnedInterpolator {
    /// The network of `weights` for up to `count` in-between frames of `size`, a multiple of `scale`.
    pub fn new(
        gpu: &Gpu,
        weights: &Arc<Weights>,
        size: Size,
        scale: u32,
        count: usize,
    ) -> Result<Self, PipelineError> {
        let lr = size.map(|side| side / scale);
        let planes = ["share", "geometry", "motion", "validity"];
        let network = GpuNetwork::new(gpu, weights, lr, ["before", "after"], &planes)?;
        let slot = |_| {
            Ok(Slot {
                hidden: network.buffer(gpu, "hidden")?,
                median: gpu.buffer("median", Use::Storage, lr.pixels() * 16)?,
                uniform: gpu.buffer("features", Use::Uniform, size_of::<FeaturesUniform>() as u64)?,
                motion: GpuMotion::new(gpu, lr)?,
                camera: None,
            })
        };
        let module = gpu.module("interpolator features", &[&features_source()])?;
        let slots = || (0..count).map(slot).collect::<Result<Vec<_>, PipelineError>>();
        Ok(Self {
            slots: [slots()?, slots()?],
            gpu: gpu.clone(),
            lr,
            scale,
            network,
            sum_depths: module.kernel(gpu, "sum_depths", &[])?,
            geometry: module.kernel(gpu, "geometry_of", &[])?,
            warped: [GpuImage::new(gpu, size)?, GpuImage::new(gpu, size)?],
            sums: gpu.buffer("sums", Use::Storage, u64::from(PARTS) * 8)?,
            bound: HashMap::new(),
        })
    }

    /// Begins a rendered frame on side `current`, with no in-between frames yet.
    pub fn begin(&mut self, current: usize) {
        self.slots[current].iter_mut().for_each(|slot| slot.camera = None);
    }

    /// Records the `k`-th in-between frame of the last frame and the one on side `current`. The hidden state comes
    /// from the in-between frame before, if there is one.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        current: usize,
        k: usize,
        frame: &InBetween<'_>,
    ) -> Result<(), PipelineError> {
        let at = (current, k);
        let last = |side: usize| self.slots[side].iter().rposition(|slot| slot.camera.is_some());
        // If there was no in-between frame before, any state will do: it is cleared.
        let before = if k > 0 { (current, k - 1) } else { (1 - current, last(1 - current).unwrap_or(0)) };
        if !self.bound.contains_key(&(at, before)) {
            let bound = self.bind(at, before, frame)?;
            self.bound.insert((at, before), bound);
        }
        let Some(bound) = self.bound.get(&(at, before)) else {
            return Err(PipelineError::Internal { expected: "the network's kernels" });
        };
        let InBetween { interpolator, views, t, camera, .. } = *frame;
        let (slot, previous) = (&self.slots[at.0][at.1], &self.slots[before.0][before.1]);
        recorder.write(&slot.uniform.slice(), &[FeaturesUniform { lr: self.lr.to_array(), t, _pad: 0 }])?;
        interpolator.record(recorder, &bound.warp, views, t, camera)?;
        recorder.stage("interpolate.features");
        recorder.dispatch(&bound.sum_depths, [PARTS, 1, 1]);
        recorder.dispatch(&bound.geometry, [self.lr.width.div_ceil(THREADS), self.lr.height, 1]);
        match &previous.camera {
            Some(last) => {
                let [now, last] = [camera, last].map(|camera| camera.low_resolution(self.scale));
                // States lie on the LR grid itself, without jitter.
                slot.motion.record(recorder, &bound.motion, [(&now, [0.0; 2]), (&last, [0.0; 2])])?;
            }
            None => {
                recorder.clear(&self.network.input("motion")?.slice());
                recorder.clear(&self.network.input("validity")?.slice());
                recorder.clear(&previous.hidden.slice());
            }
        }
        recorder.stage("interpolate.network");
        bound.engine.record(recorder);
        self.slots[current][k].camera = Some(*camera);
        Ok(())
    }

    fn bind(&self, at: At, before: At, frame: &InBetween<'_>) -> Result<BoundInBetween, PipelineError> {
        let gpu = &self.gpu;
        let (slot, previous) = (&self.slots[at.0][at.1], &self.slots[before.0][before.1]);
        let [share, geometry, flow, validity] = [
            self.network.input("share")?,
            self.network.input("geometry")?,
            self.network.input("motion")?,
            self.network.input("validity")?,
        ];
        let middle = frame.interpolator.inverse_depth().ok_or_else(|| missing("middle"))?;
        let features = [
            ("features", slot.uniform.slice()),
            ("middle", middle.slice()),
            ("geometry", geometry.slice()),
            ("median", slot.median.slice()),
            ("sums", self.sums.slice()),
        ];
        let mut inputs = self.network.slices();
        inputs.push(("before", self.warped[0].pixels().slice()));
        inputs.push(("after", self.warped[1].pixels().slice()));
        inputs.push(("hidden", previous.hidden.slice()));
        let outputs = [("color", frame.out.pixels().slice()), ("hidden", slot.hidden.slice())];
        let [first, second] = &frame.neighbors;
        Ok(BoundInBetween {
            warp: frame.interpolator.bind_both(first, second, self.warped.each_ref(), share)?,
            sum_depths: self.sum_depths.bind(gpu, &features)?,
            geometry: self.geometry.bind(gpu, &features)?,
            motion: slot.motion.bind(&slot.median, &previous.median, flow, validity)?,
            engine: self.network.engine.bind(gpu, &inputs, &outputs)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shader_is_valid_and_its_struct_lies_as_here() {
        gs3_compute::assert_layout!(&[&features_source()], Features, FeaturesUniform { lr, t, _pad });
    }
}
