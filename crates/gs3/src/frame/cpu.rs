//! The frame on the CPU, read top to bottom. `gpu/mod.rs` has the same stages on a device.

use std::sync::Arc;

use gs3_raster::{Outputs, Rasterizer};
use gs3_reconstruct::{
    DepthLattice, Interpolator, Neighbor, ResampleKernel, ResetReason, SuperSampler, resample, select_blocks,
    write_blocks,
};
use gs3_scene::{Camera, ExactBlocks, GBuffer, Image, Margin, Scene, Size, block_grid};

use super::inputs::{Frame, FrameInputs, Frames, Made};
use super::plan::FramePlan;
use crate::error::PipelineError;
use crate::learned::{LearnedInterpolator, LearnedSuperSampler};
use crate::rasterizer::RasterizeHere;
use crate::refine::{Refine, ShareController};
use crate::settings::Mode;
use crate::stages::{Stage, StageTimes};

/// Makes frames on the CPU.
pub struct CpuMachine {
    pub rasterizer: Rasterizer,
    stages: CpuStages,
}

/// The rasterizer of `scene` with the settings of `plan`.
pub fn rasterizer(plan: &FramePlan, scene: Arc<Scene>) -> Rasterizer {
    Rasterizer::new(scene, plan.settings.culling).with_list_memory(plan.settings.list_memory)
}

impl CpuMachine {
    /// # Errors
    /// [`PipelineError`] if the scale is not supported, or weights do not fit it.
    pub fn new(plan: &FramePlan, scene: Arc<Scene>) -> Result<Self, PipelineError> {
        let stages = CpuStages::new(plan, plan.scale.at(Size::default()))?;
        Ok(Self { rasterizer: rasterizer(plan, scene), stages })
    }

    /// Makes `frames.current` and the in-between frames before it.
    pub async fn make(&mut self, inputs: &FrameInputs, frames: &mut Frames) -> Result<Made, PipelineError> {
        self.stages.make(inputs, &mut self.rasterizer, frames).await
    }

    /// Makes the expected depths and the normals of `gbuffer`, the LR frame of `camera`, if it has neither.
    pub fn add_normals(&mut self, camera: &Camera, gbuffer: &mut GBuffer) -> Result<(), PipelineError> {
        let jitter = gbuffer.jitter;
        let Some(geometry) = &mut gbuffer.geometry else { return Ok(()) };
        if geometry.normal.size() == geometry.depth_median.size() {
            return Ok(());
        }
        let CpuStages { plan, padded, scale, .. } = &mut self.stages;
        let scale = *scale;
        let inputs = FrameInputs {
            camera: *camera,
            scale,
            reset: None,
            jitter,
            margin: Margin::NONE,
            moments: Vec::new(),
        };
        let settings = plan.raster(Outputs::GBuffer, &inputs);
        self.rasterizer.rasterize_low_resolution(camera, scale, &settings, padded)?;
        let Some(made) = &mut padded.geometry else { return Ok(()) };
        std::mem::swap(&mut geometry.depth_expected, &mut made.depth_expected);
        std::mem::swap(&mut geometry.normal, &mut made.normal);
        Ok(())
    }

    pub const fn stages(&self) -> &CpuStages {
        &self.stages
    }

    pub const fn stages_mut(&mut self) -> &mut CpuStages {
        &mut self.stages
    }
}

/// A frame's exact blocks are made in parts of at most this share of all blocks, 1 / [`BLOCK_PARTS`]: at 1920×1080 they take 28 MB
/// instead of 83 MB. Qualities allow up to 30 %, so only frames that are exact as a whole, or by a large share, have several parts. (A frame in slabs of depth is
/// projected anew for each part.)
const BLOCK_PARTS: usize = 3;

/// The stages of a frame in the CPU's memory, with any rasterizer, and everything that the stages remember.
pub struct CpuStages {
    plan: FramePlan,
    /// The scale of the frames that the stages are for.
    scale: u32,
    super_sampler: SuperSampler,
    learned_super_sampler: Option<LearnedSuperSampler>,
    interpolator: Interpolator,
    learned_interpolator: Option<LearnedInterpolator>,
    /// The LR frame with its margin, if it has one.
    padded: GBuffer,
    /// The frame before a network refines it, if there is a network.
    analytic: Image,
    /// Places of the rendered frame's exact blocks.
    places: Vec<[u16; 2]>,
    /// The exact blocks made last: of a part of the rendered frame, or of an in-between frame.
    blocks: ExactBlocks,
    controller: ShareController,
    /// The errors that the exact blocks of an in-between frame are chosen by.
    errors_between: Vec<f32>,
}

impl CpuStages {
    /// # Errors
    /// [`PipelineError`] if the scale is not supported, or weights do not fit it.
    pub fn new(plan: &FramePlan, scale: u32) -> Result<Self, PipelineError> {
        let networks = &plan.networks;
        let arithmetic = networks.arithmetic;
        // The interpolator and the super sampler come first: both check the scale, and everything else depends on the
        // scale.
        let interpolator = Interpolator::new(scale)?;
        let super_sampler = SuperSampler::new(scale, plan.kriging)?;
        let super_sample = networks.super_sample.clone();
        let interpolate = networks.interpolate.clone();
        Ok(Self {
            plan: plan.clone(),
            scale,
            super_sampler,
            learned_super_sampler: super_sample
                .map(|weights| LearnedSuperSampler::new(weights, scale, arithmetic))
                .transpose()?,
            interpolator,
            learned_interpolator: interpolate
                .map(|weights| LearnedInterpolator::new(weights, scale, arithmetic))
                .transpose()?,
            padded: GBuffer::default(),
            analytic: Image::default(),
            places: Vec::new(),
            blocks: ExactBlocks::default(),
            controller: ShareController::default(),
            errors_between: Vec::new(),
        })
    }

    /// Makes `frames.current` and the in-between frames before it.
    pub async fn make(
        &mut self,
        inputs: &FrameInputs,
        rasterizer: &mut impl RasterizeHere,
        frames: &mut Frames,
    ) -> Result<Made, PipelineError> {
        let mut times = StageTimes::default();
        if inputs.scale != self.scale {
            // Frames of another scale have no history. The share of exact pixels that fits the time of a frame stays.
            *self = Self {
                controller: std::mem::take(&mut self.controller),
                ..Self::new(&self.plan, inputs.scale)?
            };
        }
        match self.plan.settings.mode {
            Mode::Native => {
                times.time(Stage::Rasterize, self.rasterize_native(inputs, rasterizer, frames)).await?;
            }
            Mode::Bicubic => {
                let rasterized = self.rasterize(inputs, Outputs::Color, rasterizer, frames);
                times.time(Stage::Rasterize, rasterized).await?;
                times.time(Stage::SuperSample, async { self.enlarge(inputs, frames) }).await?;
            }
            Mode::SuperSample | Mode::Full => {
                self.forget_before(inputs);

                // Gaussians to the low-resolution G-buffer.
                let rasterized = self.rasterize(inputs, self.plan.outputs(), rasterizer, frames);
                times.time(Stage::Rasterize, rasterized).await?;

                // G-buffer and history to the frame, which a network may refine.
                times.time(Stage::SuperSample, async { self.super_sample(inputs, frames) }).await?;

                // Exact pixels where the reconstruction cannot be trusted.
                frames.current.gradients.clear(inputs.camera.size());
                if self.plan.refine.is_on() && rasterizer.makes_blocks() {
                    times.time(Stage::Refine, async { self.refine(inputs, rasterizer, frames) }).await?;
                } else {
                    self.places.clear();
                }

                // The previous frame and this one to the in-between frames.
                if !inputs.moments.is_empty() {
                    times
                        .time(Stage::Interpolate, async { self.interpolate(inputs, rasterizer, frames) })
                        .await?;
                }
                if inputs.reset == Some(ResetReason::Keyframe) {
                    self.learned_interpolator.iter_mut().for_each(LearnedInterpolator::reset);
                }
            }
        }
        let refined = self.refined_share(inputs);
        self.controller.learn_frame(self.plan.refine, &times, refined);
        let lattice = DepthLattice::of(&frames.current.gbuffer);
        Ok(Made { lattice, in_between: inputs.moments.len(), refined, times })
    }

    /// Changes the choice of exact pixels, which [`FramePlan::set_refine`] has checked.
    pub const fn set_refine(&mut self, refine: Refine) {
        self.plan.refine = refine;
    }

    /// Places of the exact blocks of the last frame, in blocks.
    pub fn exact_places(&self) -> &[[u16; 2]] {
        &self.places
    }

    /// The squared errors that were expected of the last frame before its exact blocks. Empty in modes without
    /// history.
    pub fn expected_errors(&self) -> &[f32] {
        if self.plan.settings.mode.has_history() { self.super_sampler.expected_errors() } else { &[] }
    }

    /// Drops everything remembered of earlier frames, if this frame has no history.
    fn forget_before(&mut self, inputs: &FrameInputs) {
        let Some(reason) = inputs.reset else { return };
        self.super_sampler.reset(reason);
        self.learned_super_sampler.iter_mut().for_each(LearnedSuperSampler::reset);
        // A keyframe has in-between frames before it, so the interpolation network keeps its state for them.
        if reason != ResetReason::Keyframe {
            self.learned_interpolator.iter_mut().for_each(LearnedInterpolator::reset);
        }
    }

    async fn rasterize_native(
        &self,
        inputs: &FrameInputs,
        rasterizer: &mut impl RasterizeHere,
        frames: &mut Frames,
    ) -> Result<(), PipelineError> {
        let settings = self.plan.raster(Outputs::Color, inputs);
        rasterizer.rasterize_image(&inputs.camera, &settings, &mut frames.current.image).await
    }

    async fn rasterize(
        &mut self,
        inputs: &FrameInputs,
        outputs: Outputs,
        rasterizer: &mut impl RasterizeHere,
        frames: &mut Frames,
    ) -> Result<(), PipelineError> {
        let settings = self.plan.raster(outputs, inputs);
        let (camera, scale) = (&inputs.camera, self.scale);
        let gbuffer = &mut frames.current.gbuffer;
        if inputs.margin == Margin::NONE {
            return rasterizer.rasterize(camera, scale, &settings, gbuffer).await;
        }
        rasterizer.rasterize(camera, scale, &settings, &mut self.padded).await?;
        self.padded.crop(gbuffer);
        Ok(())
    }

    fn enlarge(&self, inputs: &FrameInputs, frames: &mut Frames) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut frames.current;
        image.resize(inputs.camera.width() as usize, inputs.camera.height() as usize);
        Ok(resample(gbuffer, self.scale, ResampleKernel::Bicubic, image)?)
    }

    fn super_sample(&mut self, inputs: &FrameInputs, frames: &mut Frames) -> Result<(), PipelineError> {
        let camera = &inputs.camera;
        let Frame { gbuffer, image, .. } = &mut frames.current;
        let padded = if inputs.margin == Margin::NONE { &*gbuffer } else { &self.padded };
        let Some(learned) = &mut self.learned_super_sampler else {
            return Ok(self.super_sampler.super_sample_padded(camera, gbuffer, padded, image)?);
        };
        self.super_sampler.super_sample_padded(camera, gbuffer, padded, &mut self.analytic)?;
        let previous = frames.previous.neighbor().filter(|_| inputs.reset.is_none());
        let now = Neighbor { camera, image: &self.analytic, gbuffer, gradients: None };
        Ok(learned.refine(now, self.super_sampler.innovation(), previous, image)?)
    }

    fn refine(
        &mut self,
        inputs: &FrameInputs,
        rasterizer: &mut impl RasterizeHere,
        frames: &mut Frames,
    ) -> Result<(), PipelineError> {
        let Frame { image, gradients, .. } = &mut frames.current;
        let budget = self.plan.block_budget(inputs, self.controller.share());
        let mut places = select_blocks(self.super_sampler.expected_errors(), image.size(), budget);
        let [columns, rows] = block_grid(image.size());
        let at_once = (columns * rows).div_ceil(BLOCK_PARTS);
        if places.len() > at_once {
            // Parts are rows of blocks, so few tiles are in two parts.
            places.sort_unstable_by_key(|[x, y]| [*y, *x]);
        }
        // Only in-between frames read derivatives. The derivatives of a frame that is exact as a whole would take 33 MB at 1920×1080.
        let has_gradients = self.plan.in_between > 0 && inputs.reset.is_none();
        for part in places.chunks(at_once) {
            rasterizer.rasterize_blocks(part, &mut self.blocks)?;
            self.super_sampler.refine(&self.blocks, image);
            if has_gradients {
                gradients.add(&self.blocks);
            }
        }
        self.places = places;
        Ok(())
    }

    /// Share of the last frame's pixels that are exact blocks, `[0, 1]`.
    fn refined_share(&self, inputs: &FrameInputs) -> f32 {
        let [columns, rows] = block_grid(inputs.camera.size());
        self.places.len() as f32 / (columns * rows) as f32
    }

    fn interpolate(
        &mut self,
        inputs: &FrameInputs,
        rasterizer: &mut impl RasterizeHere,
        frames: &mut Frames,
    ) -> Result<(), PipelineError> {
        let Frames { previous, current, in_between } = frames;
        let before = previous.neighbor().ok_or(PipelineError::Internal { expected: "a previous frame" })?;
        let Frame { image, gbuffer, gradients, .. } = &*current;
        let after = Neighbor { camera: &inputs.camera, image, gbuffer, gradients: gradients.some() };
        let interpolator = &mut self.interpolator;
        let budget = self.plan.budget_between().filter(|_| rasterizer.makes_blocks());
        interpolator.set_has_errors(budget.is_some());
        let settings = self.plan.raster_image();
        for (moment, out) in inputs.moments.iter().zip(in_between) {
            let (t, camera) = (moment.t, &moment.camera);
            match &mut self.learned_interpolator {
                Some(learned) => learned.interpolate(interpolator, before, after, t, camera, out)?,
                None => interpolator.interpolate(before, after, t, camera, out)?,
            }
            // Exact pixels where the neighbours disagree.
            if let Some(budget) = budget {
                interpolator.expected_errors(&mut self.errors_between);
                let places = select_blocks(&self.errors_between, camera.size(), budget);
                rasterizer.rasterize_image_blocks(camera, &settings, &places, &mut self.blocks)?;
                write_blocks(&self.blocks, out);
            }
        }
        Ok(())
    }
}
