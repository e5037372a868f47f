//! The frame on a device, read top to bottom: one submission, from which only what is shown comes back. `cpu.rs` has the
//! same stages on the processor.

mod memory;

use std::sync::Arc;
use std::time::Instant;

use gs3_compute::{Gpu, StageTime, Timings};
use gs3_neural::MatrixUnit;
use gs3_raster::{GpuRasterizer, ScenePrecision};
use gs3_reconstruct::DepthLattice;
use gs3_reconstruct::gpu::GpuImage;
use gs3_scene::{Camera, GBuffer, Scene};

use self::memory::FrameMemory;
use super::cpu::CpuStages;
use super::inputs::{FrameInputs, Frames, Made, ReadBack};
use super::plan::FramePlan;
use crate::error::PipelineError;
use crate::stages::{Stage, StageTimes};

/// A frame in device memory. [`GpuImage::pixels`] are four halves a pixel: red, green, blue, and one that is no part of
/// the picture.
///
/// `in_between` is valid until the next frame is rendered, `current` until the one after that. Commands that are submitted
/// to the same queue afterwards find the images finished.
#[derive(Clone, Copy, Debug)]
pub struct GpuPresented<'a> {
    /// The frames between the last one and this one, in order; none after a cut.
    pub in_between: &'a [GpuImage],
    /// The frame.
    pub current: &'a GpuImage,
}

/// Makes frames on a device.
pub struct GpuMachine {
    gpu: Gpu,
    plan: FramePlan,
    rasterizer: Box<GpuRasterizer>,
    memory: Option<FrameMemory>,
    /// The device's clock, if it has one.
    timings: Option<Timings>,
    /// What the stages of the last frame took by that clock.
    stage_times: Vec<StageTime>,
    /// The stages of frames that the device only rasterizes, once there has been one.
    stages_here: Option<CpuStages>,
}

impl GpuMachine {
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device, or it gets products of matrices wrong.
    pub fn new(gpu: &Gpu, plan: &FramePlan, scene: Arc<Scene>) -> Result<Self, PipelineError> {
        let networks = &plan.networks;
        // A device that errs in products of matrices would show a wrong picture without a word.
        if (networks.super_sample.is_some() || networks.interpolate.is_some())
            && let Some(unit) = MatrixUnit::of(gpu.capabilities())
        {
            unit.check(gpu)?;
        }
        let has_clock = gpu.capabilities().timestamps;
        Ok(Self {
            gpu: gpu.clone(),
            plan: plan.clone(),
            rasterizer: Box::new(rasterizer(gpu, plan, scene)?),
            memory: None,
            timings: if has_clock { Some(Timings::new(gpu)?) } else { None },
            stage_times: Vec::new(),
            stages_here: None,
        })
    }

    /// Makes `frames.current`, and the frames between it and `frames.previous`; `read_back` of them comes here, and
    /// images that do not are empty here.
    pub fn make(
        &mut self,
        inputs: &FrameInputs,
        frames: &mut Frames,
        read_back: ReadBack,
    ) -> Result<Made, PipelineError> {
        if !self.makes_all_of(&inputs.camera) {
            let stages = match &mut self.stages_here {
                Some(stages) => stages,
                none => none.insert(CpuStages::new(&self.plan)?),
            };
            return stages.make(inputs, &mut *self.rasterizer, frames);
        }
        let Self { gpu, plan, rasterizer, memory, .. } = self;
        let mut timings = self.timings.as_mut().filter(|_| read_back != ReadBack::Nothing);
        let memory = FrameMemory::fitting(memory, gpu, plan, &inputs.camera, &rasterizer.counters())?;
        if read_back != ReadBack::Images {
            frames.current.image.resize(0, 0);
            frames.in_between.iter_mut().for_each(|image| image.resize(0, 0));
        }
        let started = Instant::now();
        let (submission, lattice) = loop {
            let mut recorder = gpu.recorder(timings.as_deref_mut());

            // Gaussians to the low-resolution G-buffer.
            memory.rasterize(&mut recorder, inputs, plan, rasterizer)?;

            // G-buffer and history to the frame, which a network may refine.
            memory.super_sample(&mut recorder, inputs)?;

            // The previous frame and this one to those between.
            memory.interpolate(&mut recorder, inputs)?;

            memory.record_read_back(&mut recorder, inputs, read_back, &rasterizer.counters());
            let submission = recorder.submit()?;
            if read_back == ReadBack::Nothing {
                break (submission, DepthLattice::default());
            }
            // A frame that lacked room for its splats is made again: there is room now.
            if let Some(lattice) = memory.receive(gpu, &submission, rasterizer, inputs, read_back, frames)? {
                break (submission, lattice);
            }
        };
        memory.commit(inputs);
        let mut times = StageTimes::default();
        match &timings {
            Some(timings) => {
                self.stage_times = timings.read(gpu, &submission)?;
                self.stage_times
                    .iter()
                    .for_each(|StageTime { stage, time }| times.add(stage_of(stage), *time));
            }
            // Without a clock nobody knows which stage took what.
            None if read_back != ReadBack::Nothing => times.add(Stage::Rasterize, started.elapsed()),
            None => {}
        }
        Ok(Made { lattice, in_between: inputs.moments.len(), refined: 0.0, times })
    }

    /// Whether it makes all of the frame of `camera`. Otherwise it rasterizes, and the processor does the rest: in modes
    /// without history, and where networks, which want whole blocks of pixels, find others.
    pub fn makes_all_of(&self, camera: &Camera) -> bool {
        let FramePlan { settings, networks, scale, .. } = &self.plan;
        let is_whole = [camera.width(), camera.height()].iter().all(|side| side.is_multiple_of(*scale));
        let has_networks = networks.super_sample.is_some() || networks.interpolate.is_some();
        settings.mode.has_history() && (is_whole || !has_networks)
    }

    /// The frame made last, on the device; none before the first one made there.
    pub fn presented(&self) -> Option<GpuPresented<'_>> {
        self.memory.as_ref().map(FrameMemory::presented)
    }

    /// Waits for all frames. Whether each since the last answer had room for its splats; what lacked room has it now.
    pub fn wait(&mut self) -> Result<bool, PipelineError> {
        Ok(self.rasterizer.check_capacity()? != gs3_raster::CapacityCheck::Grown)
    }

    /// What the stages of the last frame took by the device's clock, in the order in which they began.
    pub fn stage_times(&self) -> &[StageTime] {
        &self.stage_times
    }

    pub const fn scene(&self) -> &Arc<Scene> {
        self.rasterizer.scene()
    }

    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device; the old one stays.
    pub fn set_scene(&mut self, scene: Arc<Scene>) -> Result<(), PipelineError> {
        *self.rasterizer = rasterizer(&self.gpu, &self.plan, scene)?;
        Ok(())
    }

    /// The stages on the processor, where there has been a frame that the device only rasterizes.
    pub const fn stages_here(&self) -> Option<&CpuStages> {
        self.stages_here.as_ref()
    }

    /// Takes the choice of exact pixels of `plan`, for frames that the processor finishes.
    pub const fn set_refine(&mut self, plan: &FramePlan) {
        (self.plan.refine, self.plan.settings.refine) = (plan.refine, plan.settings.refine);
        if let Some(stages) = &mut self.stages_here {
            stages.set_refine(plan.refine);
        }
    }

    /// Reads the low-resolution G-buffer of the last frame, if it is on the device alone, into `out`.
    pub fn read_gbuffer(&self, camera: &Camera, out: &mut GBuffer) -> Result<(), PipelineError> {
        match &self.memory {
            Some(memory) if self.makes_all_of(camera) => memory.read_gbuffer(&self.gpu, out),
            _ => Ok(()),
        }
    }
}

fn rasterizer(gpu: &Gpu, plan: &FramePlan, scene: Arc<Scene>) -> Result<GpuRasterizer, PipelineError> {
    Ok(GpuRasterizer::new(gpu, scene, plan.settings.culling, ScenePrecision::default())?)
}

/// The stage of the frame that a stage of the device belongs to. The first part of its name says it; the rasterizer,
/// which knows of no frame, names its own stages only.
fn stage_of(name: &str) -> Stage {
    let named = |stage: &Stage| name.split('.').next() == Some(stage.name());
    Stage::ALL.into_iter().find(named).unwrap_or(Stage::Rasterize)
}
