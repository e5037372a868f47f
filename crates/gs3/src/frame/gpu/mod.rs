//! The frame on a device, read top to bottom. One submission makes the whole frame, and only the results to show are
//! read back. `cpu.rs` has the same stages on the CPU.

mod memory;
mod places;

use std::collections::VecDeque;
use std::sync::Arc;

use gs3_compute::{Gpu, StageTime, Submission, Timings};
use gs3_neural::MatrixUnit;
use gs3_raster::{BLOCKS_STAGE, GpuRasterizer, ScenePrecision};
use gs3_reconstruct::gpu::GpuImage;
use gs3_reconstruct::{BlockBudget, DepthLattice, ResetReason};
use gs3_scene::{Camera, GBuffer, Scene, Size, block_grid};
use web_time::Instant;

use self::memory::FrameMemory;
use self::places::Told;
use super::cpu::CpuStages;
use super::inputs::{FrameInputs, Frames, Made, ReadBack};
use super::plan::FramePlan;
use crate::error::PipelineError;
use crate::refine::ShareController;
use crate::settings::Mode;
use crate::stages::{Stage, StageTimes};

/// A frame in device memory. [`GpuImage::pixels`] are four halves a pixel: red, green, blue, and one that is not part
/// of the picture. [`GpuImage::copy_to_texture`] copies the pixels to a texture, to be drawn.
///
/// `in_between` is valid until the next frame is rendered, and `current` until the frame after the next. Commands
/// submitted later to the same queue find the images finished.
#[derive(Clone, Copy, Debug)]
pub struct GpuPresented<'a> {
    /// The in-between frames of the last frame and this one, in order; none after a cut.
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
    /// Times of the last frame's stages by the device's clock.
    stage_times: Vec<StageTime>,
    controller: ShareController,
    /// Mean inverse depth of the surfaces of the newest frame that has told its depths; 0 if none of this view has.
    mean_inverse_depth: f32,
    /// Frames that nobody has waited for, the oldest first.
    late: VecDeque<LateFrame>,
    /// Whether such a frame overflowed since the last [`Self::wait`].
    has_overflowed: bool,
    /// The stages on the CPU, created by the first frame that the device only rasterizes.
    stages_here: Option<CpuStages>,
}

/// A frame that nobody has waited for.
struct LateFrame {
    submission: Submission,
    /// The side of the memory that it was made on.
    side: usize,
    /// Whether it shows another view or scene than the frame before; a keyframe does not.
    is_other_view: bool,
}

/// What frames that nobody waited for tell once they are done.
#[derive(Clone, Copy, Debug, Default)]
pub struct Settled {
    /// The depths of the newest of them, unless a frame of another view came after it.
    pub lattice: Option<DepthLattice>,
    /// Whether one of them is incomplete. The buffers have grown.
    pub is_incomplete: bool,
}

impl GpuMachine {
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device, or the device computes wrong matrix products.
    pub fn new(gpu: &Gpu, plan: &FramePlan, scene: Arc<Scene>) -> Result<Self, PipelineError> {
        let networks = &plan.networks;
        // A device with wrong matrix products would show a wrong picture without an error.
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
            controller: ShareController::default(),
            mean_inverse_depth: 0.0,
            late: VecDeque::new(),
            has_overflowed: false,
            stages_here: None,
        })
    }

    /// Makes `frames.current` and the in-between frames before it. `read_back` says what is copied into `frames`;
    /// images that are not copied are empty there.
    pub async fn make(
        &mut self,
        inputs: &FrameInputs,
        frames: &mut Frames,
        read_back: ReadBack,
    ) -> Result<Made, PipelineError> {
        if !self.makes_all_of(&inputs.camera) {
            let stages = match &mut self.stages_here {
                Some(stages) => stages,
                none => none.insert(CpuStages::new(&self.plan, inputs.scale)?),
            };
            let mut made = stages.make(inputs, &mut *self.rasterizer, frames).await?;
            // A native frame's time is the device's, as a whole frame's is. Reading back is left out.
            if let (Mode::Native, Some(time)) = (self.plan.settings.mode, self.rasterizer.last_time()) {
                made.times = StageTimes::default();
                made.times.add(Stage::Rasterize, time);
            }
            return Ok(made);
        }
        let budget = self.plan.block_budget(inputs, self.controller.share());
        let blocks = if self.makes_blocks() { most_blocks(budget, inputs.camera.size()) } else { 0 };
        let has_blocks = blocks > 0;
        let Self { gpu, plan, rasterizer, memory, .. } = self;
        let mut timings = self.timings.as_mut().filter(|_| read_back != ReadBack::Late);
        let memory = FrameMemory::fitting(memory, gpu, plan, &inputs.camera, &rasterizer.counters())?;
        if read_back != ReadBack::Images {
            frames.current.image.resize(0, 0);
            frames.in_between.iter_mut().for_each(|image| image.resize(0, 0));
        }
        let started = Instant::now();
        let (submission, lattice, chosen) = loop {
            let mut recorder = gpu.recorder(timings.as_deref_mut());

            // Gaussians to the low-resolution G-buffer.
            memory.rasterize(&mut recorder, inputs, plan, has_blocks, rasterizer)?;

            // G-buffer and history to the frame, which a network may refine.
            memory.super_sample(&mut recorder, inputs, blocks)?;

            // Exact pixels where the reconstruction cannot be trusted.
            if has_blocks {
                memory.refine(&mut recorder, budget, rasterizer)?;
            }

            // The previous frame and this one to the in-between frames.
            memory.interpolate(&mut recorder, inputs)?;

            memory.record_read_back(&mut recorder, inputs, read_back, has_blocks, &rasterizer.counters());
            let submission = recorder.submit()?;
            if read_back == ReadBack::Late {
                // `settle` has the rest, while the next frame is made.
                break (submission, DepthLattice::default(), 0);
            }
            // After an overflow the frame is rendered again: its splats fit into the grown buffers.
            let received = memory.receive(gpu, &submission, rasterizer, inputs, read_back, frames);
            if let Some(Told { lattice, chosen }) = received.await? {
                break (submission, lattice, chosen);
            }
        };
        let is_other_view = inputs.reset.is_some_and(|reason| reason != ResetReason::Keyframe);
        if read_back != ReadBack::Late {
            self.mean_inverse_depth = lattice.mean_inverse_depth();
        } else if is_other_view {
            self.mean_inverse_depth = 0.0;
        }
        memory.commit(inputs, self.mean_inverse_depth);
        let mut times = StageTimes::default();
        match &timings {
            Some(timings) => {
                self.stage_times = timings.read_async(gpu, &submission).await?;
                self.stage_times
                    .iter()
                    .for_each(|StageTime { stage, time }| times.add(stage_of(stage), *time));
            }
            // Without a clock the time of a single stage is unknown, so the whole frame counts as rasterization.
            None if read_back != ReadBack::Late => times.add(Stage::Rasterize, started.elapsed()),
            None => {
                let side = memory.newest();
                self.late.push_back(LateFrame { submission, side, is_other_view });
            }
        }
        let refined = if has_blocks { memory.share_of(chosen) } else { 0.0 };
        self.controller.learn_frame(plan.refine, &times, refined);
        Ok(Made { lattice, in_between: inputs.moments.len(), refined, times })
    }

    /// Whether frames can have exact blocks: the pixels of a network are the network's.
    pub const fn makes_blocks(&self) -> bool {
        self.plan.networks.super_sample.is_none() && self.rasterizer.makes_blocks()
    }

    /// Whether the device makes the whole frame of `camera`. If not, the device rasterizes and the CPU does the rest.
    /// This is so in modes without history, and with networks at a size that is not a multiple of the scale.
    pub fn makes_all_of(&self, camera: &Camera) -> bool {
        let FramePlan { settings, networks, scale, .. } = &self.plan;
        let scale = scale.at(camera.size());
        let is_whole = camera.size().to_array().iter().all(|side| side.is_multiple_of(scale));
        let has_networks = networks.super_sample.is_some() || networks.interpolate.is_some();
        settings.mode.has_history() && (is_whole || !has_networks)
    }

    /// The last frame on the device; none before the device has made its first frame.
    pub fn presented(&self) -> Option<GpuPresented<'_>> {
        self.memory.as_ref().map(FrameMemory::presented)
    }

    /// Waits for the frames that nobody has waited for, before a frame of `camera` is made with `read_back`: for all of them
    /// before a frame that is waited for, else for all but the last, so that the device has work meanwhile.
    pub async fn settle(&mut self, camera: &Camera, read_back: ReadBack) -> Result<Settled, PipelineError> {
        let goes_on = self.memory.as_ref().is_some_and(|memory| memory.size() == camera.size());
        self.settle_to(usize::from(goes_on && read_back == ReadBack::Late)).await
    }

    /// Waits for the oldest frames that nobody has waited for, until `left` are left.
    async fn settle_to(&mut self, left: usize) -> Result<Settled, PipelineError> {
        let mut settled = Settled::default();
        while self.late.len() > left {
            let (Some(frame), Some(memory)) = (self.late.pop_front(), &self.memory) else { break };
            let LateFrame { submission, side, .. } = frame;
            let received = memory.receive_late(&self.gpu, &submission, side, &mut self.rasterizer).await;
            // A frame that nothing is known of does not count as complete.
            let is_complete = matches!(received, Ok(Some(_)));
            self.has_overflowed |= !is_complete;
            settled.is_incomplete |= !is_complete;
            settled.lattice = received?.map(|told| told.lattice);
        }
        if self.late.iter().any(|frame| frame.is_other_view) {
            settled.lattice = None;
        }
        if let Some(lattice) = settled.lattice {
            self.mean_inverse_depth = lattice.mean_inverse_depth();
        }
        Ok(settled)
    }

    /// Waits for all frames. Returns what they tell, and whether every frame since the last call is complete.
    pub async fn wait(&mut self) -> Result<(Settled, bool), PipelineError> {
        let settled = self.settle_to(0).await?;
        Ok((settled, !std::mem::take(&mut self.has_overflowed)))
    }

    /// Times of the last frame's stages by the device's clock, in the order in which the stages began.
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
        // They tell of the other scene.
        self.late.clear();
        Ok(())
    }

    /// The stages on the CPU, once the device has only rasterized a frame.
    pub const fn stages_here(&self) -> Option<&CpuStages> {
        self.stages_here.as_ref()
    }

    /// Takes the choice of exact pixels of `plan`.
    pub const fn set_refine(&mut self, plan: &FramePlan) {
        (self.plan.refine, self.plan.settings.refine) = (plan.refine, plan.settings.refine);
        if let Some(stages) = &mut self.stages_here {
            stages.set_refine(plan.refine);
        }
    }

    /// Reads the LR G-buffer of the last frame into `out`, if only the device has it.
    pub async fn read_gbuffer(&self, camera: &Camera, out: &mut GBuffer) -> Result<(), PipelineError> {
        match &self.memory {
            Some(memory) if self.makes_all_of(camera) => memory.read_gbuffer(&self.gpu, out).await,
            _ => Ok(()),
        }
    }
}

/// Number of blocks of a picture of `size` that `budget` allows.
fn most_blocks(budget: BlockBudget, size: Size) -> u32 {
    let [columns, rows] = block_grid(size);
    budget.blocks_of(columns * rows) as u32
}

fn rasterizer(gpu: &Gpu, plan: &FramePlan, scene: Arc<Scene>) -> Result<GpuRasterizer, PipelineError> {
    Ok(GpuRasterizer::new(gpu, scene, plan.settings.culling, ScenePrecision::default())?)
}

/// The stage of the frame that a stage of the device belongs to. The first part of the device stage's name is the
/// frame stage. The rasterizer names its own stages only, because it does not know the frame's stages.
fn stage_of(name: &str) -> Stage {
    if name == BLOCKS_STAGE {
        return Stage::Refine;
    }
    let named = |stage: &Stage| name.split('.').next() == Some(stage.name());
    Stage::ALL.into_iter().find(named).unwrap_or(Stage::Rasterize)
}
