//! The pipeline: what a frame is asked for, what it goes on from, and what it gives. [`make`] has its stages.

mod make;

use std::fmt;
use std::sync::Arc;

use gs3_raster::Outputs;
use gs3_reconstruct::{Interpolator, ResetReason, SuperSampler};
use gs3_scene::{Camera, GBuffer, Image, Margin, Scene};

use crate::cut::is_cut;
use crate::error::PipelineError;
#[cfg(feature = "gpu")]
use crate::gpu::{Device, GpuPresented, Take};
use crate::jitter::AdaptiveJitter;
use crate::lattice::DepthLattice;
use crate::learned::{LearnedInterpolator, LearnedSuperSampler, Networks};
use crate::overscan::margin_ahead;
use crate::rasterizer::AnyRasterizer;
use crate::settings::{MAX_GENERATE, Mode, PipelineSettings, Sampling};
use crate::stages::StageTimes;

/// What a rendered frame gives to show, in order.
#[derive(Clone, Copy, Debug)]
pub struct Presented<'a> {
    /// The frames between the previous one and this one, in order ([`Mode::Full`], from the second frame on). After a
    /// camera cut or another reset nothing lies between, and the previous frame stays on for these moments.
    pub between: [Option<&'a Image>; MAX_GENERATE as usize],
    /// The frame at the camera asked for.
    pub current: &'a Image,
}

impl<'a> Presented<'a> {
    /// The frames in the order in which they are shown.
    pub fn iter(&self) -> impl Iterator<Item = &'a Image> + use<'a> {
        self.between.into_iter().flatten().chain([self.current])
    }
}

/// A high-resolution frame and what it was made from.
#[derive(Debug, Default)]
struct Frame {
    camera: Option<Camera>,
    gbuffer: GBuffer,
    image: Image,
    /// Depths that tell whether the next camera is a cut, and where its frame is to be sampled.
    lattice: DepthLattice,
}

/// Renders one scene along a sequence of cameras. All memory is kept between frames.
///
/// Work is spread over the current rayon thread pool; frames do not depend on its size.
pub struct FramePipeline {
    settings: PipelineSettings,
    jitter: AdaptiveJitter,
    /// Of the frame being made, in LR pixels.
    offset: [f32; 2],
    /// Whether frames have margins, and that of the frame being made.
    overscan: bool,
    margin: Margin,
    /// The LR frame with its margin, where it has one.
    around: GBuffer,
    rasterizer: AnyRasterizer,
    super_sampler: SuperSampler,
    interpolator: Interpolator,
    learned_super_sampler: Option<LearnedSuperSampler>,
    learned_interpolator: Option<LearnedInterpolator>,
    /// Makes whole frames where they are made on a GPU.
    #[cfg(feature = "gpu")]
    device: Option<Device>,
    /// Those that run on a GPU.
    #[cfg(feature = "gpu")]
    networks: Networks,
    /// Why the next frame starts without history, if it does.
    invalid: Option<ResetReason>,
    /// Why the last frame did.
    last_reset: Option<ResetReason>,
    previous: Frame,
    current: Frame,
    /// The current image before a network refined it; empty where none does.
    analytic: Image,
    between: Vec<Image>,
    /// How many of them lie before the last frame.
    between_made: usize,
    times: StageTimes,
}

impl fmt::Debug for FramePipeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FramePipeline")
            .field("settings", &self.settings)
            .field("gaussians", &self.scene().gaussians().len())
            .field("invalid", &self.invalid)
            .finish_non_exhaustive()
    }
}

impl FramePipeline {
    /// A pipeline for `scene` without learning.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported.
    pub fn new(scene: impl Into<Arc<Scene>>, settings: PipelineSettings) -> Result<Self, PipelineError> {
        Self::with_networks(scene, settings, &Networks::default())
    }

    /// A pipeline for `scene` whose frames `networks` refine.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is not supported, or weights do not fit the scale.
    pub fn with_networks(
        scene: impl Into<Arc<Scene>>,
        settings: PipelineSettings,
        networks: &Networks,
    ) -> Result<Self, PipelineError> {
        if settings.mode == Mode::Full && !(1..=MAX_GENERATE).contains(&settings.generate) {
            return Err(PipelineError::Generate { actual: settings.generate });
        }
        let scale = settings.raster_scale();
        let sampling = if settings.mode == Mode::Native { Sampling::Centered } else { settings.sampling };
        // First, because both check the scale and everything else builds on it.
        let interpolator = Interpolator::new(scale)?;
        let Networks { super_sample, interpolate, arithmetic } = networks.clone();
        let super_sample = super_sample.filter(|_| settings.mode.has_history());
        let super_sampler = SuperSampler::new(scale, settings.kriging_below(super_sample.as_deref()))?;
        let interpolate = interpolate.filter(|_| settings.mode == Mode::Full);
        #[cfg(feature = "gpu")]
        let networks =
            Networks { super_sample: super_sample.clone(), interpolate: interpolate.clone(), arithmetic };
        let pipeline = Self {
            settings,
            jitter: AdaptiveJitter::new(scale, sampling),
            offset: [0.0; 2],
            overscan: settings.overscan_below(super_sample.as_deref()),
            margin: Margin::NONE,
            around: GBuffer::default(),
            rasterizer: AnyRasterizer::cpu(scene.into(), settings.culling),
            super_sampler,
            interpolator,
            learned_super_sampler: super_sample
                .map(|w| LearnedSuperSampler::new(w, scale, arithmetic))
                .transpose()?,
            learned_interpolator: interpolate
                .map(|w| LearnedInterpolator::new(w, scale, arithmetic))
                .transpose()?,
            #[cfg(feature = "gpu")]
            device: None,
            #[cfg(feature = "gpu")]
            networks,
            invalid: Some(ResetReason::FirstFrame),
            last_reset: None,
            previous: Frame::default(),
            analytic: Image::default(),
            current: Frame::default(),
            between: vec![Image::default(); settings.displayed_per_rendered() - 1],
            between_made: 0,
            times: StageTimes::default(),
        };
        pipeline.raster_settings(Outputs::GBuffer).check()?;
        Ok(pipeline)
    }

    /// Renders the frame of `camera`, and the frames between it and the previous one at the cameras `between`: the true
    /// poses at [`PipelineSettings::moments`] where the caller knows them; where it gives none, poses between the
    /// two. Modes without frames between do not read them.
    ///
    /// The fourth channel of the images is alpha in [`Mode::Native`] and not specified otherwise.
    ///
    /// # Errors
    /// [`PipelineError`] if `between` has cameras for another number of frames or of another size, or a device fails.
    pub fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Presented<'_>, PipelineError> {
        self.advance(camera, between, |pipeline| pipeline.make(camera, between))?;
        Ok(self.presented())
    }

    /// Renders as [`Self::render`] does, on the device, and leaves there what is to be shown: for programs that show it
    /// from there (on a device of their own, [`Gpu::of`](gs3_compute::Gpu::of)). Some hundred bytes come back, no
    /// images:
    /// [`Self::presented`] and [`Self::last_image`] are empty until the next [`Self::render`].
    ///
    /// # Errors
    /// [`PipelineError::NotOnDevice`] where [`Self::is_on_device`] says no, else as [`Self::render`].
    #[cfg(feature = "gpu")]
    pub fn render_to_device(
        &mut self,
        camera: &Camera,
        between: &[Camera],
    ) -> Result<GpuPresented<'_>, PipelineError> {
        if !self.is_on_device(camera) {
            return Err(PipelineError::NotOnDevice);
        }
        self.advance(camera, between, |pipeline| {
            pipeline.current.image.resize(0, 0);
            pipeline.between.iter_mut().for_each(|image| image.resize(0, 0));
            pipeline.render_on_device(camera, between, Take::Facts)
        })?;
        self.device.as_ref().and_then(|device| device.frames.presented()).ok_or(PipelineError::NotOnDevice)
    }

    /// Goes on to the frame of `camera`, which `make` makes.
    fn advance(
        &mut self,
        camera: &Camera,
        between: &[Camera],
        make: impl FnOnce(&mut Self) -> Result<(), PipelineError>,
    ) -> Result<(), PipelineError> {
        self.check_between(camera, between)?;
        self.times = StageTimes::default();
        self.between_made = 0;
        self.invalidate_for(camera);
        self.offset = self.jitter.next(camera, &self.current.lattice);
        self.margin = self.next_margin(camera);
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
        if let Err(error) = make(self) {
            // What was made of this frame is no frame to go on from.
            std::mem::swap(&mut self.previous, &mut self.current);
            self.current.camera = None;
            self.reset(ResetReason::Failure);
            return Err(error);
        }
        self.current.camera = Some(*camera);
        self.last_reset = self.invalid.take();
        Ok(())
    }

    fn check_between(&self, camera: &Camera, between: &[Camera]) -> Result<(), PipelineError> {
        if self.settings.mode != Mode::Full {
            return Ok(());
        }
        if ![0, self.between.len()].contains(&between.len()) {
            let (expected, actual) = (self.between.len(), between.len());
            return Err(PipelineError::Between { expected, actual });
        }
        let expected = (camera.width(), camera.height());
        let other = between.iter().map(|c| (c.width(), c.height())).find(|size| *size != expected);
        other.map_or(Ok(()), |actual| Err(PipelineError::BetweenSize { expected, actual }))
    }

    /// Forgets the frames before: the next one starts anew, for this reason unless another came first.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid.get_or_insert(reason);
    }

    /// Why the last frame began without history, if it did: it is less sharp than the ones to come, and what
    /// [`Presented::between`] has before it is the frame before, held.
    #[must_use]
    pub const fn last_reset(&self) -> Option<ResetReason> {
        self.last_reset
    }

    /// Shows another scene from the next frame on.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the GPU that rasterizes; the old one stays.
    pub fn set_scene(&mut self, scene: impl Into<Arc<Scene>>) -> Result<(), PipelineError> {
        self.rasterizer = self.rasterizer.with_scene(scene.into(), self.settings.culling)?;
        self.reset(ResetReason::SceneChange);
        Ok(())
    }

    /// Renders on `gpu` from the next frame on, without history. In modes with history whole frames are made there
    /// and only images come back ([`Self::is_on_device`]); in the other modes it rasterizes, and the rest stays on
    /// the CPU.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device, or it was opened for products of matrices and gets
    /// them wrong; everything stays as it was.
    #[cfg(feature = "gpu")]
    pub fn render_on(&mut self, gpu: &gs3_compute::Gpu) -> Result<(), PipelineError> {
        let scene = Arc::clone(self.rasterizer.scene());
        let rasterizer = AnyRasterizer::gpu(gpu, scene, self.settings.culling)?;
        let device = || Device::new(gpu, &self.settings, &self.networks);
        let device = self.settings.mode.has_history().then(device).transpose()?;
        (self.rasterizer, self.device) = (rasterizer, device);
        self.reset(ResetReason::BackendChange);
        Ok(())
    }

    /// Renders on the CPU from the next frame on, without history: after [`Self::render_on`], where its device fails.
    #[cfg(feature = "gpu")]
    pub fn render_on_cpu(&mut self) {
        self.rasterizer = AnyRasterizer::cpu(Arc::clone(self.rasterizer.scene()), self.settings.culling);
        self.device = None;
        self.reset(ResetReason::BackendChange);
    }

    /// Whether all of the frame of `camera` is made on a GPU. Where there are networks and the size is no multiple of
    /// the scale, a GPU rasterizes and the rest stays on the CPU.
    #[must_use]
    pub fn is_on_device(&self, camera: &Camera) -> bool {
        #[cfg(feature = "gpu")]
        let is_on_device =
            self.device.as_ref().is_some_and(|device| device.frames.takes([camera.width(), camera.height()]));
        #[cfg(not(feature = "gpu"))]
        let is_on_device = {
            _ = camera;
            false
        };
        is_on_device
    }

    /// The scene shown.
    #[must_use]
    pub const fn scene(&self) -> &Arc<Scene> {
        self.rasterizer.scene()
    }

    /// Number of frames after which a resting camera repeats its sampling offsets, which is also how many frames the
    /// history holds.
    #[must_use]
    pub fn jitter_period(&self) -> usize {
        self.jitter.period()
    }

    /// What the last frame gave to show; an empty image before the first one.
    #[must_use]
    pub fn presented(&self) -> Presented<'_> {
        let mut between = [None; MAX_GENERATE as usize];
        let held = self.held_frame();
        for (k, (place, made)) in between.iter_mut().zip(&self.between).enumerate() {
            *place = if k < self.between_made { Some(made) } else { held };
        }
        Presented { between, current: &self.current.image }
    }

    /// The last frame rendered; empty before the first one.
    #[must_use]
    pub const fn last_image(&self) -> &Image {
        &self.current.image
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &PipelineSettings {
        &self.settings
    }

    /// How long the stages of the last frame took.
    #[must_use]
    pub const fn times(&self) -> StageTimes {
        self.times
    }

    /// Number of Gaussians that the last frame shows; none where a GPU keeps the count.
    #[must_use]
    pub fn visible_count(&self) -> Option<usize> {
        self.rasterizer.visible_count()
    }

    /// The low-resolution G-buffer of the last frame; empty in [`Mode::Native`], colour only in [`Mode::Bicubic`].
    /// Where whole frames are made on a GPU it is that of the last [`Self::fetch_gbuffer`].
    #[must_use]
    pub const fn gbuffer(&self) -> &GBuffer {
        &self.current.gbuffer
    }

    /// Brings the low-resolution G-buffer of the last frame here, if it is on a GPU.
    ///
    /// # Errors
    /// [`PipelineError`] if the device fails.
    pub fn fetch_gbuffer(&mut self) -> Result<(), PipelineError> {
        #[cfg(feature = "gpu")]
        if let (Some(device), Some(camera)) = (&self.device, &self.current.camera)
            && self.is_on_device(camera)
        {
            device.frames.read_gbuffer(&mut self.current.gbuffer)?;
        }
        Ok(())
    }

    /// Decides whether the history holds for `camera`, and passes a reason why not on to whatever keeps history.
    fn invalidate_for(&mut self, camera: &Camera) {
        let size = |c: &Camera| (c.width(), c.height());
        if self.invalid.is_none() {
            self.invalid = match &self.current.camera {
                None => Some(ResetReason::FirstFrame),
                Some(last) if size(last) != size(camera) => Some(ResetReason::SizeOrTierChange),
                Some(last) if is_cut(last, camera, &self.current.lattice) => Some(ResetReason::CameraCut),
                Some(_) => None,
            };
        }
        if let Some(reason) = self.invalid {
            self.super_sampler.reset(reason);
            self.learned_super_sampler.iter_mut().for_each(LearnedSuperSampler::reset);
            self.learned_interpolator.iter_mut().for_each(LearnedInterpolator::reset);
            #[cfg(feature = "gpu")]
            self.device.iter_mut().for_each(|device| device.reset(reason));
            self.jitter.reset();
        }
    }

    /// What the frame of `camera` is rasterized with beyond its edges. After a cut nothing tells where the camera goes.
    fn next_margin(&self, camera: &Camera) -> Margin {
        match &self.current.camera {
            Some(last) if self.overscan && self.invalid.is_none() => {
                margin_ahead(last, camera, &self.current.lattice, self.settings.scale)
            }
            _ => Margin::NONE,
        }
    }

    /// The previous frame, if there is one of the same size.
    fn held_frame(&self) -> Option<&Image> {
        let size = |frame: &Frame| frame.camera.map(|c| (c.width(), c.height()));
        (size(&self.previous).is_some() && size(&self.previous) == size(&self.current))
            .then_some(&self.previous.image)
    }
}
