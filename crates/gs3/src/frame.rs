//! The frame, read top to bottom.

use std::sync::Arc;

use glam::DVec2;
use gs3_raster::{Outputs, RasterError, RasterSettings};
use gs3_reconstruct::{
    Interpolator, Kernel, Neighbor, ReconstructError, ResetReason, SuperSampler, resample,
};
use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, GBuffer, Image, Jitter, Scene};

use crate::learned::{LearnedInterpolator, LearnedSuperSampler, NetworkError, Networks};
use crate::rasterizer::AnyRasterizer;
use crate::settings::{MAX_GENERATE, Mode, PipelineSettings};
use crate::stages::{Stage, StageTimes};

/// Why a frame could not be made. No frame is presented then; the history is as before.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The rasterizer refuses the settings.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The GPU rasterizer refuses the settings, or its device has no room or fails.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] gs3_raster::GpuRasterError),
    /// The reconstruction refuses its inputs.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// A network cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// Too many or too few frames are to be made between two rendered ones.
    #[error("generate: expected 1 to {MAX_GENERATE} frames between rendered ones, found {actual}")]
    Generate {
        /// Frames asked for.
        actual: u32,
    },
    /// Cameras between the previous frame and this one are not those of the frames between.
    #[error("cameras between two frames: expected none or {expected}, found {actual}")]
    Between {
        /// Frames between.
        expected: usize,
        /// Cameras given.
        actual: usize,
    },
}

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
    /// The image before a network refined it; empty where none does.
    analytic: Image,
}

/// Renders one scene along a sequence of cameras. All memory is kept between frames.
///
/// Work is spread over the current rayon thread pool; frames do not depend on its size.
pub struct FramePipeline {
    settings: PipelineSettings,
    jitter: Jitter,
    rasterizer: AnyRasterizer,
    super_sampler: SuperSampler,
    interpolator: Interpolator,
    learned_super_sampler: Option<LearnedSuperSampler>,
    learned_interpolator: Option<LearnedInterpolator>,
    /// Why the next frame starts without history, if it does.
    invalid: Option<ResetReason>,
    /// Frames since the history began; selects the jitter.
    age: u64,
    previous: Frame,
    current: Frame,
    between: Vec<Image>,
    times: StageTimes,
}

impl FramePipeline {
    /// A pipeline for `scene` without learning.
    ///
    /// # Errors
    /// [`PipelineError`] if the scale or the number of frames between is not supported.
    pub fn new(scene: Arc<Scene>, settings: PipelineSettings) -> Result<Self, PipelineError> {
        Self::with_networks(scene, settings, &Networks::default())
    }

    /// A pipeline for `scene` whose frames `networks` refine.
    ///
    /// # Errors
    /// [`PipelineError`] if the scale or the number of frames between is not supported, or weights do not fit the scale.
    pub fn with_networks(
        scene: Arc<Scene>,
        settings: PipelineSettings,
        networks: &Networks,
    ) -> Result<Self, PipelineError> {
        if !(1..=MAX_GENERATE).contains(&settings.generate) {
            return Err(PipelineError::Generate { actual: settings.generate });
        }
        let scale = settings.raster_scale();
        // First, because both check the scale and everything else builds on it.
        let (super_sampler, interpolator) = (SuperSampler::new(scale)?, Interpolator::new(scale)?);
        let Networks { super_sample, interpolate } = networks.clone();
        let super_sample = super_sample.filter(|_| settings.mode.has_history());
        let interpolate = interpolate.filter(|_| settings.mode == Mode::Full);
        Ok(Self {
            settings,
            jitter: settings.jitter(),
            rasterizer: AnyRasterizer::cpu(scene, settings.culling),
            super_sampler,
            interpolator,
            learned_super_sampler: super_sample.map(|w| LearnedSuperSampler::new(w, scale)).transpose()?,
            learned_interpolator: interpolate.map(|w| LearnedInterpolator::new(w, scale)).transpose()?,
            invalid: Some(ResetReason::FirstFrame),
            age: 0,
            previous: Frame::default(),
            current: Frame::default(),
            between: vec![Image::default(); settings.displayed_per_rendered() - 1],
            times: StageTimes::default(),
        })
    }

    /// Renders the frame of `camera`, and the frames between it and the previous one at the cameras `between`: the true
    /// poses at [`PipelineSettings::moments`] where the caller knows them; where it gives none, poses between the two.
    ///
    /// The fourth channel of the images is alpha in [`Mode::Native`] and not specified otherwise.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is out of range, or `between` has cameras for another number of frames.
    pub fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Presented<'_>, PipelineError> {
        if self.settings.mode == Mode::Full && ![0, self.between.len()].contains(&between.len()) {
            let (expected, actual) = (self.between.len(), between.len());
            return Err(PipelineError::Between { expected, actual });
        }
        self.times = StageTimes::default();
        self.invalidate_for(camera);
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
        match self.settings.mode {
            Mode::Native => self.rasterize_native(camera)?,
            Mode::Bicubic => {
                self.rasterize(camera, Outputs::Color)?;
                self.enlarge(camera)?;
            }
            Mode::SuperSample => {
                self.rasterize(camera, Outputs::GBuffer)?;
                self.super_sample(camera)?;
            }
            Mode::Full => {
                self.rasterize(camera, Outputs::GBuffer)?;
                self.super_sample(camera)?;
                self.interpolate(camera, between)?;
            }
        }
        self.current.camera = Some(*camera);
        self.invalid = None;
        self.age += 1;
        Ok(self.present())
    }

    /// Forgets the frames before: the next one starts anew.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// Shows another scene from the next frame on.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the GPU that rasterizes; the old one stays.
    pub fn set_scene(&mut self, scene: Arc<Scene>) -> Result<(), PipelineError> {
        self.rasterizer = self.rasterizer.with_scene(scene, self.settings.culling)?;
        self.reset(ResetReason::SceneChange);
        Ok(())
    }

    /// Rasterizes on `gpu` from the next frame on. What follows reads the frame back and stays on the CPU.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device; the CPU goes on rasterizing.
    #[cfg(feature = "gpu")]
    pub fn rasterize_on(&mut self, gpu: &gs3_compute::Gpu) -> Result<(), PipelineError> {
        let scene = Arc::clone(self.rasterizer.scene());
        self.rasterizer = AnyRasterizer::gpu(gpu, scene, self.settings.culling)?;
        Ok(())
    }

    /// The scene shown.
    #[must_use]
    pub const fn scene(&self) -> &Arc<Scene> {
        self.rasterizer.scene()
    }

    /// Number of frames after which the sampling offsets repeat, which is also how many frames the history holds.
    #[must_use]
    pub fn jitter_period(&self) -> usize {
        self.jitter.period()
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

    /// The low-resolution G-buffer of the last frame; empty in [`Mode::Native`], colour only in [`Mode::Bicubic`].
    #[must_use]
    pub const fn gbuffer(&self) -> &GBuffer {
        &self.current.gbuffer
    }

    /// Decides whether the history holds for `camera`, and passes a reason why not on to who keeps history.
    fn invalidate_for(&mut self, camera: &Camera) {
        let size = |c: &Camera| (c.width(), c.height());
        if self.invalid.is_none() {
            self.invalid = match &self.current.camera {
                None => Some(ResetReason::FirstFrame),
                Some(last) if size(last) != size(camera) => Some(ResetReason::SizeOrTierChange),
                Some(last) if is_cut(last, camera, &self.current.gbuffer) => Some(ResetReason::CameraCut),
                Some(_) => None,
            };
        }
        if let Some(reason) = self.invalid {
            self.super_sampler.reset(reason);
            self.learned_super_sampler.iter_mut().for_each(LearnedSuperSampler::reset);
            self.learned_interpolator.iter_mut().for_each(LearnedInterpolator::reset);
            self.age = 0;
        }
    }

    fn raster_settings(&self, outputs: Outputs) -> RasterSettings {
        let PipelineSettings { dilation, background, .. } = self.settings;
        RasterSettings {
            outputs,
            dilation: dilation.at_scale(self.settings.raster_scale()),
            jitter: self.jitter.offset(self.age),
            background,
        }
    }

    fn rasterize_native(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let settings = self.raster_settings(Outputs::Color);
        let (rasterizer, image) = (&mut self.rasterizer, &mut self.current.image);
        self.times.time(Stage::Rasterize, || rasterizer.rasterize_image(camera, &settings, image))
    }

    fn rasterize(&mut self, camera: &Camera, outputs: Outputs) -> Result<(), PipelineError> {
        let settings = self.raster_settings(outputs);
        let lr_camera = camera.low_resolution(self.settings.scale);
        let (rasterizer, gbuffer) = (&mut self.rasterizer, &mut self.current.gbuffer);
        self.times.time(Stage::Rasterize, || rasterizer.rasterize(&lr_camera, &settings, gbuffer))
    }

    fn enlarge(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        image.resize(camera.width() as usize, camera.height() as usize);
        let scale = self.settings.scale;
        Ok(self.times.time(Stage::SuperSample, || resample(gbuffer, scale, Kernel::Bicubic, image))?)
    }

    fn super_sample(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, analytic, .. } = &mut self.current;
        let (super_sampler, previous) = (&mut self.super_sampler, &self.previous);
        let learned = &mut self.learned_super_sampler;
        self.times.time(Stage::SuperSample, || {
            let Some(learned) = learned else {
                return Ok(super_sampler.super_sample(camera, gbuffer, image)?);
            };
            super_sampler.super_sample(camera, gbuffer, analytic)?;
            let previous = match &previous.camera {
                Some(camera) if self.invalid.is_none() => {
                    Some(Neighbor { camera, image: &previous.analytic, gbuffer: &previous.gbuffer })
                }
                _ => None,
            };
            let now = Neighbor { camera, image: analytic, gbuffer };
            Ok(learned.refine(now, super_sampler.innovation(), previous, image)?)
        })
    }

    /// The frames between the previous and the current one, if something lies between them.
    fn interpolate(&mut self, camera: &Camera, between: &[Camera]) -> Result<(), PipelineError> {
        let (None, Some(previous)) = (self.invalid, &self.previous.camera) else { return Ok(()) };
        let before =
            Neighbor { camera: previous, image: &self.previous.image, gbuffer: &self.previous.gbuffer };
        let after = Neighbor { camera, image: &self.current.image, gbuffer: &self.current.gbuffer };
        let (interpolator, learned) = (&mut self.interpolator, &mut self.learned_interpolator);
        let images = &mut self.between;
        self.times.time(Stage::Interpolate, || {
            for ((k, t), out) in self.settings.moments().enumerate().zip(images) {
                let at = between.get(k).copied().unwrap_or_else(|| pose_between(previous, camera, t));
                match learned {
                    Some(learned) => {
                        learned.interpolate(interpolator, before, after, t as f32, &at, out)?;
                    }
                    None => interpolator.interpolate(before, after, t as f32, &at, out)?,
                }
            }
            Ok(())
        })
    }

    fn present(&self) -> Presented<'_> {
        let mut between = [None; MAX_GENERATE as usize];
        let is_made = self.times.get(Stage::Interpolate).is_some();
        let held = self.held_frame();
        for (place, made) in between.iter_mut().zip(&self.between) {
            *place = if is_made { Some(made) } else { held };
        }
        Presented { between, current: &self.current.image }
    }

    /// The previous frame, if there is one of the same size.
    fn held_frame(&self) -> Option<&Image> {
        let size = |frame: &Frame| frame.camera.map(|c| (c.width(), c.height()));
        (size(&self.previous).is_some() && size(&self.previous) == size(&self.current))
            .then_some(&self.previous.image)
    }
}

/// Whether so little of the previous frame still shows that its history is worth nothing: of a 5×5 lattice of its
/// pixels, placed at their depths, fewer than a third lie within the new image and are seen from about the same side.
/// (Empirical; a brisk pan of 3° a frame keeps nine tenths, and no orbit turns by 30° from frame to frame.)
fn is_cut(previous: &Camera, camera: &Camera, gbuffer: &GBuffer) -> bool {
    /// Lattice points per axis.
    const LATTICE: usize = 5;
    /// Cosine of 30°: seen from farther around, a surface shows another side, as after a jump across an orbit, where
    /// every point stays in view.
    const SAME_SIDE: f64 = 0.866;
    let depth_at = |fx: f64, fy: f64| {
        let depth = &gbuffer.geometry.as_ref()?.depth_median;
        let (x, y) = ((fx * depth.width() as f64) as usize, (fy * depth.height() as f64) as usize);
        Some(f64::from(*depth.row(0, y).get(x)?)).filter(|z| *z > 0.0)
    };
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    let fraction = |k: usize| (k as f64 + 0.5) / LATTICE as f64;
    let still_shows = |k: &usize| {
        let (fx, fy) = (fraction(k % LATTICE), fraction(k / LATTICE));
        // Where nothing was hit, only the direction counts: a depth far beyond any motion between frames.
        let z = depth_at(fx, fy).unwrap_or(1e6 * (1.0 + previous.position().distance(camera.position())));
        let point = previous.unproject(DVec2::new(fx, fy) * size, z);
        let (pixel, z) = camera.project(point);
        let [from, to] = [previous, camera].map(|c| (point - c.position()).normalize_or_zero());
        let in_view = z > 0.0 && pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
        in_view && from.dot(to) > SAME_SIDE
    };
    3 * (0..LATTICE * LATTICE).filter(still_shows).count() < LATTICE * LATTICE
}
