//! The pipeline: its requests, its state between frames, and its results. The stages are in `cpu.rs` and
//! `gpu/mod.rs`, in the same order.

mod choices;
mod cpu;
mod gbuffer;
#[cfg(feature = "gpu")]
mod gpu;
mod inputs;
#[cfg(feature = "gpu")]
mod on_device;
mod plan;

use std::fmt;
use std::sync::Arc;

use gs3_reconstruct::{FrameSequence, FrameStart, ResetReason};
use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, Image, Margin, Scene, Size};

use self::cpu::{CpuMachine, CpuStages};
#[cfg(feature = "gpu")]
use self::gpu::GpuMachine;
#[cfg(feature = "gpu")]
pub use self::gpu::GpuPresented;
use self::inputs::{FrameInputs, Frames, Made, Moment, ReadBack};
use self::plan::FramePlan;
use crate::error::PipelineError;
use crate::learned::Networks;
use crate::now::now;
use crate::refine::Refine;
use crate::settings::{MAX_IN_BETWEEN, Mode, PipelineSettings};
use crate::stages::StageTimes;

/// The images that a rendered frame adds to the display, in order.
#[derive(Clone, Copy, Debug)]
pub struct Presented<'a> {
    /// The in-between frames of the previous frame and this one, in order ([`Mode::Full`], from the second frame on).
    /// After a camera cut or another reset there are none, and the previous frame is shown at these moments.
    pub in_between: [Option<&'a Image>; MAX_IN_BETWEEN as usize],
    /// The frame at the camera asked for.
    pub current: &'a Image,
}

impl<'a> Presented<'a> {
    /// The frames in the order in which they are shown.
    pub fn iter(&self) -> impl Iterator<Item = &'a Image> + use<'a> {
        self.in_between.into_iter().flatten().chain([self.current])
    }
}

/// What starts anew at a keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Keyframe {
    /// The choice of sampling offsets. The history stays: old LR frames leave it on their own.
    Sampling,
    /// Everything: the whole frame is exact, and the history starts with it.
    All,
}

/// The machine that makes the frames.
enum Machine {
    Cpu(Box<CpuMachine>),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuMachine>),
}

/// Renders one scene along a sequence of cameras. All memory is kept between frames.
///
/// Work is spread over the current rayon thread pool; frames do not depend on its size.
pub struct FramePipeline {
    plan: FramePlan,
    machine: Machine,
    /// Detects cuts, and chooses jitter and margins.
    sequence: FrameSequence,
    frames: Frames,
    /// Number of the next frame on its path.
    frame_number: u64,
    /// Number of in-between frames that were asked for before the current frame, and number of those made.
    asked_in_between: usize,
    in_between: usize,
    /// The scale of the last frame.
    scale: u32,
    /// Share of the current frame's pixels that are exact blocks, `[0, 1]`.
    refined: f32,
    times: StageTimes,
    /// Why the last frame has no history; none if it has one.
    last_reset: Option<ResetReason>,
}

impl fmt::Debug for FramePipeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FramePipeline")
            .field("settings", self.settings())
            .field("gaussians", &self.scene().gaussians().len())
            .field("last_reset", &self.last_reset)
            .finish_non_exhaustive()
    }
}

impl FramePipeline {
    /// A pipeline for `scene` without networks.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported.
    pub fn new(scene: impl Into<Arc<Scene>>, settings: PipelineSettings) -> Result<Self, PipelineError> {
        Self::with_networks(scene, settings, &Networks::default())
    }

    /// A pipeline for `scene` with frames refined by `networks`.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported, or weights do not fit the scale.
    pub fn with_networks(
        scene: impl Into<Arc<Scene>>,
        settings: PipelineSettings,
        networks: &Networks,
    ) -> Result<Self, PipelineError> {
        let plan = FramePlan::new(settings, networks)?;
        let machine = Machine::Cpu(Box::new(CpuMachine::new(&plan, scene.into())?));
        plan.check_raster()?;
        let in_between = vec![Image::default(); plan.most_in_between() as usize];
        let scale = plan.scale.at(Size::default());
        Ok(Self {
            machine,
            sequence: FrameSequence::new(scale, plan.sampling, plan.widest_margin),
            scale,
            plan,
            frames: Frames { in_between, ..Frames::default() },
            frame_number: 0,
            asked_in_between: 0,
            in_between: 0,
            refined: 0.0,
            times: StageTimes::default(),
            last_reset: None,
        })
    }

    /// Renders the frame of `camera`, and in [`Mode::Full`] frames at poses between the previous camera and this one.
    ///
    /// The fourth channel of the images is alpha in [`Mode::Native`] and not specified otherwise.
    ///
    /// # Errors
    /// [`PipelineError`] if a device fails.
    pub fn render(&mut self, camera: &Camera) -> Result<Presented<'_>, PipelineError> {
        self.render_with_poses(camera, &[])
    }

    /// Renders as [`Self::render`] does. In a browser whose GPU makes the frame the future does not block; natively the future
    /// waits within its first poll. A future that is dropped before its end leaves a frame unfinished: call
    /// [`Self::reset`] then.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn render_async(&mut self, camera: &Camera) -> Result<Presented<'_>, PipelineError> {
        self.render_with_poses_async(camera, &[]).await
    }

    /// Renders as [`Self::render`] does, with the true cameras at [`PipelineSettings::moments`] between the previous
    /// frame and this one. `poses` are all of these cameras in order, or none. Modes without in-between frames do not
    /// read `poses`.
    ///
    /// # Errors
    /// [`PipelineError`] if the number of `poses` is not the number of in-between frames, if a pose has another size
    /// than `camera`, or if a device fails.
    pub fn render_with_poses(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<Presented<'_>, PipelineError> {
        now(self.render_with_poses_async(camera, poses))
    }

    /// Renders as [`Self::render_with_poses`] does, without blocking a browser ([`Self::render_async`]).
    ///
    /// # Errors
    /// As [`Self::render_with_poses`].
    pub async fn render_with_poses_async(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<Presented<'_>, PipelineError> {
        self.make_frame(camera, poses, ReadBack::Images).await?;
        Ok(self.presented())
    }

    /// Makes the whole frame. `read_back` says what a frame made by a GPU copies back to the CPU.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "there is no GPU to read back from"))]
    async fn make_frame(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
        read_back: ReadBack,
    ) -> Result<(), PipelineError> {
        self.check_poses(camera, poses)?;
        #[cfg(feature = "gpu")]
        self.settle(camera, read_back).await?;
        let inputs = self.begin(camera, poses);
        let made = match &mut self.machine {
            Machine::Cpu(cpu) => cpu.make(&inputs, &mut self.frames).await,
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.make(&inputs, &mut self.frames, read_back).await,
        };
        self.finish(&inputs, made)
    }

    /// Decides everything about the frame of `camera` that its stages do not decide: its history, its jitter, its
    /// margin, and its in-between frames.
    fn begin(&mut self, camera: &Camera, poses: &[Camera]) -> FrameInputs {
        let scale = self.scale_of(camera);
        self.sequence.set_scale(scale);
        let keyframe = self.keyframe_at(self.frame_number);
        if keyframe.is_some() {
            self.sequence.restart_sampling();
        }
        let FrameStart { mut reset, jitter, mut margin, previous } = self.sequence.begin(camera);
        if keyframe == Some(Keyframe::All) {
            // The keyframe is the first frame of a part of the path, so no earlier frame may influence its margin.
            (reset, margin) = (reset.or(Some(ResetReason::Keyframe)), Margin::NONE);
        }
        let moment = |previous: &Camera, k: usize, t: f64| {
            let pose = poses.get(k).copied().unwrap_or_else(|| pose_between(previous, camera, t));
            Moment { t: t as f32, camera: pose }
        };
        let moments = self.plan.moments().enumerate();
        let moments = match &previous {
            Some(previous) => moments.map(|(k, t)| moment(previous, k, t)).collect(),
            None => Vec::new(),
        };
        self.frames.advance();
        FrameInputs { camera: *camera, scale, reset, jitter, margin, moments }
    }

    /// A refused request changes nothing.
    fn check_poses(&self, camera: &Camera, poses: &[Camera]) -> Result<(), PipelineError> {
        if self.plan.settings.mode != Mode::Full {
            return Ok(());
        }
        let expected = self.plan.in_between as usize;
        if ![0, expected].contains(&poses.len()) {
            return Err(PipelineError::Between { expected, actual: poses.len() });
        }
        match poses.iter().map(Camera::size).find(|size| *size != camera.size()) {
            None => Ok(()),
            Some(actual) => Err(PipelineError::BetweenSize { expected: camera.size(), actual }),
        }
    }

    /// On success, makes the frame the last one. On failure, keeps showing the last frame and starts anew after it.
    fn finish(
        &mut self,
        inputs: &FrameInputs,
        made: Result<Made, PipelineError>,
    ) -> Result<(), PipelineError> {
        match made {
            Ok(Made { lattice, in_between, refined, times }) => {
                self.frame_number += 1;
                self.sequence.commit(&inputs.camera, inputs.reset, inputs.jitter, lattice);
                self.frames.current.camera = Some(inputs.camera);
                self.asked_in_between = self.plan.in_between as usize;
                (self.scale, self.in_between, self.refined) = (inputs.scale, in_between, refined);
                (self.times, self.last_reset) = (times, inputs.reset);
                Ok(())
            }
            Err(error) => {
                self.frames.retreat();
                (self.in_between, self.times) = (0, StageTimes::default());
                self.sequence.fail(inputs.reset);
                Err(error)
            }
        }
    }

    /// Where to start on a path so that frame `number`, its in-between frames and all later frames have the same bits
    /// as in a run from frame 0 in which all frames are waited for: at most `keyframes` + S² frames earlier, where S
    /// is 6 with [`Scale::Auto`](crate::Scale::Auto) and without networks. Call
    /// [`Self::set_frame_number`] with the result. Then render the frames up to `number` without showing them.
    ///
    /// Two settings never give the same bits again. (1) [`Refine::FrameTime`] has no keyframes. Then, as with
    /// [`PipelineSettings::keyframes`] 0, the warm-up is the frames that the history holds, at most S² + 1. (2) A
    /// network without exact keyframes has a state older than the history. Then the warm-up starts at the keyframe
    /// before that history, at most `keyframes` + S² frames earlier.
    #[must_use]
    pub fn first_of_warm_up(&self, number: u64) -> u64 {
        let mode = self.plan.settings.mode;
        if mode == Mode::Native {
            return number;
        }
        let shows_before = u64::from(self.plan.settings.displayed_per_rendered() > 1);
        // At most the last S² frames are remembered, at any jitter. The history of the frame before `number` must not hold
        // the first frame of the warm-up, which has no margin.
        let reach =
            if mode.has_history() { u64::from(self.plan.scale.largest()).pow(2) + shows_before } else { 0 };
        let interval = u64::from(self.plan.settings.keyframes);
        let latest = match self.keyframe_at(0) {
            // In-between frames need the frame before `number`.
            Some(Keyframe::All) => number.saturating_sub(shows_before),
            Some(Keyframe::Sampling) => number.saturating_sub(reach),
            None => return number.saturating_sub(reach),
        };
        latest / interval * interval
    }

    /// What starts anew at frame `number`; none if the frame is no keyframe.
    fn keyframe_at(&self, number: u64) -> Option<Keyframe> {
        let settings = &self.plan.settings;
        let interval = u64::from(settings.keyframes);
        if settings.mode == Mode::Native || interval == 0 || !number.is_multiple_of(interval) {
            return None;
        }
        match self.plan.refine {
            Refine::FrameTime(_) => None,
            refine if refine.is_on() && refine.starts_exact() && self.always_makes_blocks() => {
                Some(Keyframe::All)
            }
            _ => Some(Keyframe::Sampling),
        }
    }

    /// Whether all frames have exact blocks, of whatever size: a GPU with an interpolation network only rasterizes some sizes.
    const fn always_makes_blocks(&self) -> bool {
        match &self.machine {
            Machine::Cpu(_) => true,
            #[cfg(feature = "gpu")]
            Machine::Gpu(machine) => machine.makes_blocks() && self.plan.networks.interpolate.is_none(),
        }
    }

    /// Whether frames of `camera` can have exact pixels ([`PipelineSettings::refine`]). Frames of a GPU have none where a
    /// network makes the picture, where the GPU only rasterizes ([`Self::is_on_device`]), and with
    /// [`Culling::Aabb3Sigma`](crate::Culling::Aabb3Sigma) and [`Culling::Adr`](crate::Culling::Adr).
    #[must_use]
    pub fn makes_exact_pixels(&self, camera: &Camera) -> bool {
        match &self.machine {
            Machine::Cpu(_) => {
                _ = camera;
                self.plan.settings.mode.has_history()
            }
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.makes_all_of(camera) && gpu.makes_blocks(),
        }
    }

    /// Share of the last frame's pixels that were rasterized exactly besides the low-resolution grid, `[0, 1]`
    /// ([`PipelineSettings::refine`]); 0 after `submit_to_device`, which does not read the number.
    #[must_use]
    pub const fn refined_share(&self) -> f32 {
        self.refined
    }

    /// Columns and rows of the blocks of 4×4 pixels that are exact in the last frame besides the low-resolution grid.
    /// Block `[c, r]` starts at pixel `[4c, 4r]`. Empty if a GPU made the frame.
    #[must_use]
    pub fn exact_places(&self) -> &[[u16; 2]] {
        self.stages().map_or(&[], CpuStages::exact_places)
    }

    /// The squared errors that were expected of the last frame before its exact blocks, one per block of 4×4 pixels,
    /// `[rows, columns]` of [`gs3_scene::block_grid`]. Each is a sum over the block's pixels and over RGB. Empty in
    /// modes without history, and if a GPU made the frame.
    #[must_use]
    pub fn expected_errors(&self) -> &[f32] {
        self.stages().map_or(&[], CpuStages::expected_errors)
    }

    fn stages(&self) -> Option<&CpuStages> {
        match &self.machine {
            Machine::Cpu(cpu) => Some(cpu.stages()),
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.stages_here(),
        }
    }

    /// Why the last frame started without history; none if it had one. There are then no in-between frames, except at
    /// [`ResetReason::Keyframe`]: the previous frame is shown instead.
    #[must_use]
    pub const fn last_reset(&self) -> Option<ResetReason> {
        self.last_reset
    }

    /// Shows another scene from the next frame on.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the GPU that rasterizes; the old scene stays.
    pub fn set_scene(&mut self, scene: impl Into<Arc<Scene>>) -> Result<(), PipelineError> {
        match &mut self.machine {
            Machine::Cpu(cpu) => cpu.rasterizer = cpu::rasterizer(&self.plan, scene.into()),
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.set_scene(scene.into())?,
        }
        self.reset(ResetReason::SceneChange);
        Ok(())
    }

    /// Whether a GPU makes the whole frame of `camera`. With networks and a size that is not a multiple of the scale,
    /// the GPU rasterizes and the CPU does the rest.
    #[must_use]
    pub fn is_on_device(&self, camera: &Camera) -> bool {
        match &self.machine {
            Machine::Cpu(_) => {
                _ = camera;
                false
            }
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.makes_all_of(camera),
        }
    }

    /// The scene shown.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        match &self.machine {
            Machine::Cpu(cpu) => cpu.rasterizer.scene(),
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.scene(),
        }
    }

    /// The scale of the frame of `camera`, HR over LR size on each axis: 1 in [`Mode::Native`]. With networks and
    /// [`Scale::Auto`](crate::Scale::Auto) the scale is the networks'.
    #[must_use]
    pub const fn scale_of(&self, camera: &Camera) -> u32 {
        self.plan.scale.at(camera.size())
    }

    /// The scale of the last frame ([`Self::scale_of`]). Before the first frame the scale is that of small frames.
    #[must_use]
    pub const fn scale(&self) -> u32 {
        self.scale
    }

    /// Number of frames after which a resting camera repeats its sampling offsets. The history holds at most
    /// as many frames.
    #[must_use]
    pub fn jitter_period(&self) -> usize {
        self.sequence.period()
    }

    /// The images of the last frame; an empty image before the first frame.
    #[must_use]
    pub fn presented(&self) -> Presented<'_> {
        let mut in_between = [None; MAX_IN_BETWEEN as usize];
        let held = self.held_frame();
        let made = self.frames.in_between.iter().take(self.asked_in_between);
        for (k, (place, made)) in in_between.iter_mut().zip(made).enumerate() {
            *place = if k < self.in_between { Some(made) } else { held };
        }
        Presented { in_between, current: &self.frames.current.image }
    }

    /// The last frame rendered; empty before the first one.
    #[must_use]
    pub const fn last_image(&self) -> &Image {
        &self.frames.current.image
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &PipelineSettings {
        &self.plan.settings
    }

    /// How long the stages of the last frame took. If a GPU made the frame, times are by the device's clock and
    /// exclude reading back. On a GPU without a clock, the whole frame and reading back count as rasterization.
    #[must_use]
    pub const fn times(&self) -> StageTimes {
        self.times
    }

    /// Number of Gaussians that the last frame shows; none if the count is on a GPU.
    #[must_use]
    pub fn visible_count(&self) -> Option<usize> {
        match &self.machine {
            Machine::Cpu(cpu) => Some(cpu.rasterizer.visible_count()),
            #[cfg(feature = "gpu")]
            Machine::Gpu(_) => None,
        }
    }

    /// The previous frame, if there is one of the same size.
    fn held_frame(&self) -> Option<&Image> {
        let Frames { previous, current, .. } = &self.frames;
        (previous.size().is_some() && previous.size() == current.size()).then_some(&previous.image)
    }
}
