//! A session: a scene, the machine that renders it, and frames of any camera. Interactive programs are built on it.

mod gbuffer;
mod reference;

use std::fmt;
use std::sync::Arc;

#[cfg(feature = "gpu")]
use gs3_compute::{GpuError, OptionalFeatures};
use gs3_reconstruct::ResetReason;
use gs3_scene::{Camera, Scene};

use crate::error::PipelineError;
use crate::frame::{FramePipeline, Presented};
use crate::learned::Networks;
use crate::machine::{Backend, Machine};
use crate::now::now;
use crate::refine::Refine;
use crate::settings::{Mode, PipelineSettings};
use reference::Reference;

/// How a session renders.
#[derive(Clone, Debug)]
pub struct SessionSettings {
    /// How frames are made.
    pub pipeline: PipelineSettings,
    /// The networks that refine frames.
    pub networks: Networks,
    /// The machine that renders.
    pub backend: Backend,
    /// The GPU, as an index into [`gs3_compute::adapters`]; none means the fastest GPU. Not read with
    /// [`Backend::Cpu`].
    #[cfg(feature = "gpu")]
    pub adapter: Option<usize>,
    /// What a GPU is opened with beyond what every GPU has.
    #[cfg(feature = "gpu")]
    pub features: OptionalFeatures,
}

impl Default for SessionSettings {
    /// Super-sampled frames without networks, on [`Backend::Auto`].
    fn default() -> Self {
        Self {
            pipeline: PipelineSettings { mode: Mode::SuperSample, ..PipelineSettings::default() },
            networks: Networks::default(),
            backend: Backend::default(),
            #[cfg(feature = "gpu")]
            adapter: None,
            #[cfg(feature = "gpu")]
            features: OptionalFeatures::All,
        }
    }
}

/// Renders a scene on the machine that was asked for, or on a machine that was found.
///
/// Besides the frames of [`SessionSettings::pipeline`], a session makes reference frames ([`Self::reference`]) of the
/// same scene on the same machine. Native reference frames replace the frame of a resting camera. Bicubic reference
/// frames are for comparison. Reference frames do not change the history.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use gs3::scene::demo;
/// use gs3::{Backend, Mode, Session, SessionSettings};
///
/// let settings = SessionSettings { backend: Backend::Cpu, ..SessionSettings::default() };
/// let mut session = Session::new(demo::scene()?, settings)?;
/// let camera = demo::path().resized(160, 88)?.cameras()[0];
/// let frame = session.render(&camera)?.current.clone();
/// let native = session.reference(Mode::Native, &camera)?;
/// assert_eq!((frame.width(), frame.height()), (native.width(), native.height()));
/// # Ok(())
/// # }
/// ```
pub struct Session {
    settings: SessionSettings,
    machine: Machine,
    pipeline: FramePipeline,
    /// The pipelines of reference frames, one per mode, created at the first request.
    references: Vec<Reference>,
    notices: Vec<String>,
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session")
            .field("settings", &self.settings)
            .field("backend", &self.backend())
            .field("pipeline", &self.pipeline)
            .finish_non_exhaustive()
    }
}

impl Session {
    /// A session that shows `scene`.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported, if a GPU that was asked for cannot be opened, or if the scene
    /// does not fit into its memory; in a browser [`Self::open`] is for GPUs.
    pub fn new(scene: impl Into<Arc<Scene>>, settings: SessionSettings) -> Result<Self, PipelineError> {
        now(Self::open(scene, settings))
    }

    /// A session that shows `scene`, as [`Self::new`] makes it, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub async fn open(
        scene: impl Into<Arc<Scene>>,
        settings: SessionSettings,
    ) -> Result<Self, PipelineError> {
        let pipeline = FramePipeline::with_networks(scene, settings.pipeline, &settings.networks)?;
        #[cfg(feature = "gpu")]
        let (machine, failure) =
            Machine::open_async(settings.backend, settings.adapter, settings.features).await?;
        #[cfg(not(feature = "gpu"))]
        let (machine, failure) = (Machine::open(settings.backend)?, None::<PipelineError>);
        Self::start(settings, machine, pipeline, failure.iter().map(tell_take_over).collect())
    }

    /// A session that shows `scene` on a `machine` that is open. The choice of a machine in `settings` is not read.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported, or if the scene does not fit into the memory of a GPU that was asked
    /// for.
    pub fn on(
        machine: Machine,
        scene: impl Into<Arc<Scene>>,
        settings: SessionSettings,
    ) -> Result<Self, PipelineError> {
        let pipeline = FramePipeline::with_networks(scene, settings.pipeline, &settings.networks)?;
        Self::start(settings, machine, pipeline, Vec::new())
    }

    /// Another session on the same machine, of another scene or with other settings: sessions share an open GPU.
    ///
    /// # Errors
    /// As [`Self::on`].
    pub fn beside(
        &self,
        scene: impl Into<Arc<Scene>>,
        pipeline: PipelineSettings,
        networks: &Networks,
    ) -> Result<Self, PipelineError> {
        let settings = SessionSettings { pipeline, networks: networks.clone(), ..self.settings.clone() };
        Self::on(self.machine.clone(), scene, settings)
    }

    /// The session with `pipeline` on `machine`. If a GPU that was found (not asked for) fails, the CPU takes over.
    #[cfg_attr(not(feature = "gpu"), expect(unused_mut, reason = "no GPU takes the pipeline"))]
    fn start(
        settings: SessionSettings,
        machine: Machine,
        pipeline: FramePipeline,
        notices: Vec<String>,
    ) -> Result<Self, PipelineError> {
        let mut session = Self { settings, machine, pipeline, references: Vec::new(), notices };
        #[cfg(feature = "gpu")]
        if let Some(gpu) = session.machine.gpu()
            && let Err(error) = session.pipeline.render_on(gpu)
        {
            session.take_over(error)?;
        }
        Ok(session)
    }

    /// Continues on the CPU after `error` of a GPU that was found and not asked for, and adds a notice. Frames start
    /// without history.
    ///
    /// # Errors
    /// `error`, if the machine is not such a GPU or the CPU would fail in the same way.
    fn take_over(&mut self, error: PipelineError) -> Result<(), PipelineError> {
        #[cfg(feature = "gpu")]
        if matches!(self.machine, Machine::FoundGpu(_)) && is_of_device(&error) {
            self.machine = Machine::Cpu;
            self.notices.push(tell_take_over(&error));
            self.pipeline.render_on_cpu()?;
            // Reference pipelines are created again at the next request.
            self.references.clear();
            return Ok(());
        }
        Err(error)
    }

    /// Continues on the CPU, without history: for a session beside another one whose GPU failed.
    ///
    /// # Errors
    /// None beyond the errors of [`Self::new`] with the same settings.
    #[cfg(feature = "gpu")]
    pub fn render_on_cpu(&mut self) -> Result<(), PipelineError> {
        if self.backend() == Backend::Gpu {
            self.machine = Machine::Cpu;
            self.references.clear();
            self.pipeline.render_on_cpu()?;
        }
        Ok(())
    }

    /// Renders the frame of `camera`, as [`FramePipeline::render`] does. If a GPU fails that was found and not asked
    /// for, the CPU renders this frame and all later ones, and [`Self::take_notices`] reports the change.
    ///
    /// # Errors
    /// [`PipelineError`] if a GPU that was asked for fails; in a browser [`Self::render_async`] is for GPUs.
    pub fn render(&mut self, camera: &Camera) -> Result<Presented<'_>, PipelineError> {
        self.render_with_poses(camera, &[])
    }

    /// Renders as [`Self::render`] does. In a browser the future does not block; natively the future waits within its first
    /// poll ([`FramePipeline::render_async`]).
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn render_async(&mut self, camera: &Camera) -> Result<Presented<'_>, PipelineError> {
        self.render_with_poses_async(camera, &[]).await
    }

    /// Renders as [`Self::render`] does, with the true cameras of the in-between frames
    /// ([`FramePipeline::render_with_poses`]).
    ///
    /// # Errors
    /// As [`Self::render`]. Also if `poses` have another number than the in-between frames, or another size.
    pub fn render_with_poses(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<Presented<'_>, PipelineError> {
        now(self.render_with_poses_async(camera, poses))
    }

    /// Renders as [`Self::render_with_poses`] does, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::render_with_poses`].
    pub async fn render_with_poses_async(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<Presented<'_>, PipelineError> {
        if let Err(error) = self.pipeline.render_with_poses_async(camera, poses).await.map(|_| ()) {
            self.take_over(error)?;
            self.pipeline.render_with_poses_async(camera, poses).await?;
        }
        Ok(self.pipeline.presented())
    }

    /// Drops the history: the next frame starts anew, for this reason unless an earlier reason is pending.
    pub fn reset(&mut self, reason: ResetReason) {
        self.pipeline.reset(reason);
    }

    /// Drops the history and sets the number of the next frame on its path ([`FramePipeline::set_frame_number`]).
    /// With the number that [`FramePipeline::first_of_warm_up`] returns, later frames have the same bits as in one
    /// run over the whole path.
    pub fn begin_at(&mut self, number: u64) {
        self.reset(ResetReason::CameraCut);
        self.pipeline.set_frame_number(number);
    }

    /// Shows another scene from the next frame on.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit on a GPU that was asked for; the old scene stays.
    pub fn set_scene(&mut self, scene: impl Into<Arc<Scene>>) -> Result<(), PipelineError> {
        let scene = scene.into();
        if let Err(error) = self.pipeline.set_scene(Arc::clone(&scene)) {
            self.take_over(error)?;
            self.pipeline.set_scene(scene)?;
        }
        // Reference pipelines hold the old scene's memory. They are created again at the next request.
        self.references.clear();
        Ok(())
    }

    /// Renders with other settings and networks from the next frame on, on the same machine, without history.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported, or a GPU that was asked for has too little memory. The old
    /// settings and networks stay.
    pub fn set_pipeline(
        &mut self,
        settings: PipelineSettings,
        networks: &Networks,
    ) -> Result<(), PipelineError> {
        let mut pipeline = FramePipeline::with_networks(Arc::clone(self.scene()), settings, networks)?;
        #[cfg(feature = "gpu")]
        if let Some(gpu) = self.machine.gpu()
            && let Err(error) = pipeline.render_on(gpu)
        {
            self.take_over(error)?;
            pipeline.render_on_cpu()?;
        }
        pipeline.reset(ResetReason::SizeOrTierChange);
        self.pipeline = pipeline;
        self.references.clear();
        (self.settings.pipeline, self.settings.networks) = (settings, networks.clone());
        Ok(())
    }

    /// Chooses the pixels that are rasterized exactly from the next frame on. The history stays
    /// ([`FramePipeline::set_refine`]).
    ///
    /// # Errors
    /// [`PipelineError::RefineShare`] if the share is not in `[0, 1]`; the old choice stays.
    pub fn set_refine(&mut self, refine: Refine) -> Result<(), PipelineError> {
        self.pipeline.set_refine(refine)?;
        self.settings.pipeline.refine = refine;
        Ok(())
    }

    /// Chooses how many frames are interpolated before each rendered frame from the next frame on. The history stays
    /// ([`FramePipeline::set_in_between`]).
    ///
    /// # Errors
    /// [`PipelineError::InBetween`] if there are too many; the old choice stays.
    pub const fn set_in_between(&mut self, count: u32) -> Result<(), PipelineError> {
        self.pipeline.set_in_between(count)
    }

    /// The pipeline that makes the frames: figures of the last frame, its G-buffer, its exact blocks.
    #[must_use]
    pub const fn pipeline(&self) -> &FramePipeline {
        &self.pipeline
    }

    /// The scene shown.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        self.pipeline.scene()
    }

    /// How the session renders.
    #[must_use]
    pub const fn settings(&self) -> &SessionSettings {
        &self.settings
    }

    /// The machine that renders now.
    #[must_use]
    pub const fn machine(&self) -> &Machine {
        &self.machine
    }

    /// The kind of the machine that renders now: [`Backend::Cpu`] or [`Backend::Gpu`].
    #[must_use]
    pub const fn backend(&self) -> Backend {
        self.machine.backend()
    }

    /// The name and the interface of the GPU, if a GPU renders.
    #[must_use]
    pub fn adapter(&self) -> Option<String> {
        self.machine.adapter()
    }

    /// Bytes that the GPU has allocated for all its sessions, if a GPU renders and its driver reports them.
    #[must_use]
    pub fn device_bytes(&self) -> Option<u64> {
        self.machine.device_bytes()
    }

    /// Notices for the user since the last call: that the CPU took over, and why.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }
}

/// The notice after `error` of a GPU.
fn tell_take_over(error: &impl fmt::Display) -> String {
    format!("the CPU takes over: {error}")
}

/// Whether `error` is a fault of a device, so that the CPU may succeed.
#[cfg(feature = "gpu")]
const fn is_of_device(error: &PipelineError) -> bool {
    match error {
        // A fault of the caller.
        PipelineError::Gpu(GpuError::WouldBlock) => false,
        error => matches!(error, PipelineError::Gpu(_) | PipelineError::Network(_)),
    }
}

#[cfg(test)]
mod tests {
    use gs3_scene::demo;

    use super::*;

    fn camera(index: usize) -> Camera {
        demo::path().resized(96, 56).unwrap().cameras()[index]
    }

    fn on(backend: Backend) -> Result<Session, PipelineError> {
        Session::new(demo::scene().unwrap(), SessionSettings { backend, ..SessionSettings::default() })
    }

    #[test]
    fn a_session_renders_what_its_pipeline_renders() {
        let mut session = on(Backend::Cpu).unwrap();
        let settings = session.settings().pipeline;
        let mut pipeline = FramePipeline::new(demo::scene().unwrap(), settings).unwrap();
        for k in 0..3 {
            let expected = pipeline.render(&camera(k)).unwrap().current.clone();
            assert_eq!(session.render(&camera(k)).unwrap().current, &expected);
            // References between frames leave the history alone.
            session.reference(Mode::Native, &camera(20 + k)).unwrap();
        }
        let native = PipelineSettings { mode: Mode::Native, ..settings };
        let mut native = FramePipeline::new(demo::scene().unwrap(), native).unwrap();
        let expected = native.render(&camera(5)).unwrap().current.clone();
        assert_eq!(session.reference(Mode::Native, &camera(5)).unwrap(), &expected);
    }

    #[test]
    fn a_session_beside_another_has_frames_of_its_own() {
        let mut session = on(Backend::Cpu).unwrap();
        let settings = PipelineSettings { mode: Mode::Native, ..session.settings().pipeline };
        let mut beside = session.beside(Arc::clone(session.scene()), settings, &Networks::default()).unwrap();
        let native = beside.render(&camera(4)).unwrap().current.clone();
        assert_eq!(session.reference(Mode::Native, &camera(4)).unwrap(), &native);
        assert_eq!(
            (session.settings().pipeline.mode, beside.settings().pipeline),
            (Mode::SuperSample, settings)
        );
        assert!(session.pipeline().last_image().pixels().is_empty());
    }

    #[test]
    fn another_scene_is_shown_by_all_frames() {
        let mut one = gs3_scene::Gaussians::zeroed(1, 0);
        (one.rotations[0][0], one.opacities[0]) = (1.0, 0.9);
        one.means[0][0] = 1e4;
        let far = Scene::new(one, gs3_scene::OpacityMode::Default).unwrap();
        let mut session = on(Backend::Cpu).unwrap();
        let before = session.reference(Mode::Native, &camera(0)).unwrap().clone();
        session.set_scene(far).unwrap();
        assert!(session.last_reference(Mode::Native).is_none());
        assert_eq!(session.scene().gaussians().len(), 1);
        assert_ne!(session.reference(Mode::Native, &camera(0)).unwrap(), &before);
        session.render(&camera(0)).unwrap();
        assert_eq!(session.pipeline().visible_count(), Some(0));
    }

    #[test]
    fn settings_that_are_refused_change_nothing() {
        let mut session = on(Backend::Cpu).unwrap();
        session.render(&camera(0)).unwrap();
        let before = session.settings().pipeline;
        assert!(session.set_refine(Refine::Share(2.0)).is_err());
        let wrong = PipelineSettings { mode: Mode::Full, in_between: 9, ..before };
        assert!(session.set_pipeline(wrong, &Networks::default()).is_err());
        assert_eq!(session.settings().pipeline, before);
        assert_eq!(*session.pipeline().settings(), before);
        session.set_refine(Refine::Off).unwrap();
        session.render(&camera(1)).unwrap();
        assert!(session.pipeline().exact_places().is_empty() && session.pipeline().last_reset().is_none());
        session.set_refine(Refine::Share(0.1)).unwrap();
        session.render(&camera(2)).unwrap();
        let blocks = session.pipeline().exact_places().len() as f32;
        let all = session.pipeline().expected_errors().len() as f32;
        assert_eq!(all, 24.0 * 14.0);
        assert!((blocks / all - 0.1).abs() < 0.01, "{blocks} of {all}");
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn the_cpu_takes_over_from_a_gpu_that_nobody_asked_for_only() {
        for is_found in [true, false] {
            let Ok(mut session) = on(Backend::Gpu) else {
                return crate::compute::skip_without_gpu("no session has one");
            };
            if is_found {
                let Machine::Gpu(gpu) = &session.machine else { panic!("no GPU") };
                session.machine = Machine::FoundGpu(gpu.clone());
            }
            session.render(&camera(0)).unwrap();
            let (Machine::Gpu(gpu) | Machine::FoundGpu(gpu)) = &session.machine else { panic!("no GPU") };
            // Like a driver that resets.
            gpu.destroy();
            let rendered = session.render(&camera(1)).map(|frames| frames.current.clone());
            assert_eq!(rendered.is_ok(), is_found);
            assert_eq!(session.backend(), if is_found { Backend::Cpu } else { Backend::Gpu });
            assert_eq!(session.take_notices().len(), usize::from(is_found));
        }
    }
}
