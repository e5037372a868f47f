//! The frame, read top to bottom.

use std::sync::Arc;

use glam::DVec2;
use gs3_raster::{Outputs, RasterError, RasterSettings, Rasterizer};
use gs3_reconstruct::{
    Interpolator, Kernel, Neighbor, ReconstructError, ResetReason, SuperSampler, resample,
};
use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, GBuffer, Image, Jitter, Scene};

use crate::settings::{Mode, PipelineSettings};
use crate::stages::{Stage, StageTimes};

/// Why a frame could not be made. No frame is presented then; the history is as before.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PipelineError {
    /// The rasterizer refuses the settings.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The reconstruction refuses its inputs.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
}

/// What a rendered frame gives to show, in order.
#[derive(Clone, Copy, Debug)]
pub struct Presented<'a> {
    /// The frame half-way from the previous one ([`Mode::Full`], from the second frame on). After a camera cut or
    /// another reset nothing lies between, and the previous frame stays on for that moment.
    pub between: Option<&'a Image>,
    /// The frame at the camera asked for.
    pub current: &'a Image,
}

impl<'a> Presented<'a> {
    /// The frames in the order in which they are shown.
    pub fn iter(&self) -> impl Iterator<Item = &'a Image> + use<'a> {
        self.between.into_iter().chain([self.current])
    }
}

/// A high-resolution frame and what it was made from.
#[derive(Debug, Default)]
struct Frame {
    camera: Option<Camera>,
    gbuffer: GBuffer,
    image: Image,
}

/// Renders one scene along a sequence of cameras. All memory is kept between frames.
///
/// Work is spread over the current rayon thread pool; frames do not depend on its size.
pub struct FramePipeline {
    settings: PipelineSettings,
    jitter: Jitter,
    rasterizer: Rasterizer,
    super_sampler: SuperSampler,
    interpolator: Interpolator,
    /// Why the next frame starts without history, if it does.
    invalid: Option<ResetReason>,
    /// Frames since the history began; selects the jitter.
    age: u64,
    previous: Frame,
    current: Frame,
    between: Image,
    times: StageTimes,
}

impl FramePipeline {
    /// A pipeline for `scene`.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if the scale is not supported.
    pub fn new(scene: Arc<Scene>, settings: PipelineSettings) -> Result<Self, PipelineError> {
        let scale = settings.raster_scale();
        // First, because both check the scale and everything else builds on it.
        let (super_sampler, interpolator) = (SuperSampler::new(scale)?, Interpolator::new(scale)?);
        Ok(Self {
            settings,
            jitter: settings.jitter(),
            rasterizer: Rasterizer::new(scene, settings.culling),
            super_sampler,
            interpolator,
            invalid: Some(ResetReason::FirstFrame),
            age: 0,
            previous: Frame::default(),
            current: Frame::default(),
            between: Image::default(),
            times: StageTimes::default(),
        })
    }

    /// Renders the frame of `camera`; the frame between it and the previous one at `middle`, the true pose at that
    /// moment where the caller knows it, else half-way between the two cameras.
    ///
    /// The fourth channel of the images is alpha in [`Mode::Native`] and not specified otherwise.
    ///
    /// # Errors
    /// [`PipelineError`] if a setting is out of range.
    pub fn render(
        &mut self,
        camera: &Camera,
        middle: Option<&Camera>,
    ) -> Result<Presented<'_>, PipelineError> {
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
                self.interpolate(camera, middle)?;
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
    pub fn set_scene(&mut self, scene: Arc<Scene>) {
        self.rasterizer = Rasterizer::new(scene, self.settings.culling);
        self.reset(ResetReason::SceneChange);
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
        Ok(self.times.time(Stage::Rasterize, || rasterizer.rasterize_image(camera, &settings, image))?)
    }

    fn rasterize(&mut self, camera: &Camera, outputs: Outputs) -> Result<(), PipelineError> {
        let settings = self.raster_settings(outputs);
        let lr_camera = camera.low_resolution(self.settings.scale);
        let (rasterizer, gbuffer) = (&mut self.rasterizer, &mut self.current.gbuffer);
        Ok(self.times.time(Stage::Rasterize, || rasterizer.rasterize(&lr_camera, &settings, gbuffer))?)
    }

    fn enlarge(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        image.resize(camera.width() as usize, camera.height() as usize);
        let scale = self.settings.scale;
        Ok(self.times.time(Stage::SuperSample, || resample(gbuffer, scale, Kernel::Bicubic, image))?)
    }

    fn super_sample(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        let super_sampler = &mut self.super_sampler;
        Ok(self.times.time(Stage::SuperSample, || super_sampler.super_sample(camera, gbuffer, image))?)
    }

    /// The frame between the previous and the current one, if something lies between them.
    fn interpolate(&mut self, camera: &Camera, middle: Option<&Camera>) -> Result<(), PipelineError> {
        let (None, Some(previous)) = (self.invalid, &self.previous.camera) else { return Ok(()) };
        let middle = middle.copied().unwrap_or_else(|| pose_between(previous, camera, 0.5));
        let before =
            Neighbor { camera: previous, image: &self.previous.image, gbuffer: &self.previous.gbuffer };
        let after = Neighbor { camera, image: &self.current.image, gbuffer: &self.current.gbuffer };
        let (interpolator, out) = (&mut self.interpolator, &mut self.between);
        Ok(self
            .times
            .time(Stage::Interpolate, || interpolator.interpolate(before, after, 0.5, &middle, out))?)
    }

    fn present(&self) -> Presented<'_> {
        let between = match self.settings.mode {
            Mode::Native | Mode::Bicubic | Mode::SuperSample => None,
            Mode::Full if self.times.get(Stage::Interpolate).is_some() => Some(&self.between),
            Mode::Full => self.held_frame(),
        };
        Presented { between, current: &self.current.image }
    }

    /// The previous frame, if there is one of the same size.
    fn held_frame(&self) -> Option<&Image> {
        let size = |frame: &Frame| frame.camera.map(|c| (c.width(), c.height()));
        (size(&self.previous).is_some() && size(&self.previous) == size(&self.current))
            .then_some(&self.previous.image)
    }
}

/// Whether so little of the previous frame is still in view that its history is worth nothing: of a 5×5 lattice of its
/// pixels, placed at their depths, fewer than a third lie within the new image. (Empirical; a brisk pan of 3° a frame
/// keeps nine tenths.)
fn is_cut(previous: &Camera, camera: &Camera, gbuffer: &GBuffer) -> bool {
    /// Lattice points per axis.
    const LATTICE: usize = 5;
    let depth_at = |fx: f64, fy: f64| {
        let depth = &gbuffer.geometry.as_ref()?.depth_median;
        let (x, y) = ((fx * depth.width() as f64) as usize, (fy * depth.height() as f64) as usize);
        Some(f64::from(*depth.row(0, y).get(x)?)).filter(|z| *z > 0.0)
    };
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    let fraction = |k: usize| (k as f64 + 0.5) / LATTICE as f64;
    let in_view = |k: &usize| {
        let (fx, fy) = (fraction(k % LATTICE), fraction(k / LATTICE));
        // Where nothing was hit, only the direction counts: a depth far beyond any motion between frames.
        let z = depth_at(fx, fy).unwrap_or(1e6 * (1.0 + previous.position().distance(camera.position())));
        let (pixel, z) = camera.project(previous.unproject(DVec2::new(fx, fy) * size, z));
        z > 0.0 && pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all()
    };
    3 * (0..LATTICE * LATTICE).filter(in_view).count() < LATTICE * LATTICE
}
