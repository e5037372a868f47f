//! How a frame is made, stage after stage.

use gs3_raster::{Outputs, RasterSettings};
use gs3_reconstruct::{Kernel, Neighbor, resample};
use gs3_scene::camera_path::pose_between;
use gs3_scene::{Camera, Margin};

use super::{Frame, FramePipeline};
use crate::error::PipelineError;
#[cfg(feature = "gpu")]
use crate::gpu::{GpuRequest, Take};
use crate::lattice::DepthLattice;
use crate::settings::{Mode, PipelineSettings};
use crate::stages::Stage;

impl FramePipeline {
    /// Makes the current frame and those before it.
    pub(super) fn make(&mut self, camera: &Camera, between: &[Camera]) -> Result<(), PipelineError> {
        match self.settings.mode {
            Mode::Native => self.rasterize_native(camera),
            Mode::Bicubic => {
                self.rasterize(camera, Outputs::Color)?;
                self.enlarge(camera)
            }
            #[cfg(feature = "gpu")]
            Mode::SuperSample | Mode::Full if self.is_on_device(camera) => {
                self.render_on_device(camera, between, Take::Shown)
            }
            Mode::SuperSample => {
                self.rasterize(camera, Outputs::GBuffer)?;
                self.super_sample(camera)
            }
            Mode::Full => {
                self.rasterize(camera, Outputs::GBuffer)?;
                self.super_sample(camera)?;
                self.interpolate(camera, between)
            }
        }
    }

    /// All of the frame at once, on the device; `take` of it comes back.
    #[cfg(feature = "gpu")]
    pub(super) fn render_on_device(
        &mut self,
        camera: &Camera,
        between: &[Camera],
        take: Take,
    ) -> Result<(), PipelineError> {
        let raster = self.raster_settings(Outputs::GBuffer);
        let (Some(device), Some(rasterizer)) = (&mut self.device, self.rasterizer.gpu_mut()) else {
            return Ok(());
        };
        let moments: Vec<(f64, Camera)> = match (self.invalid, &self.previous.camera) {
            (None, Some(previous)) => cameras_between(&self.settings, previous, camera, between).collect(),
            _ => Vec::new(),
        };
        let request = GpuRequest { camera, raster: &raster, between: &moments };
        let Frame { image, lattice, .. } = &mut self.current;
        let out = (take == Take::Shown).then_some((image, &mut self.between[..]));
        let rendered = device.render(rasterizer, &request, out)?;
        (*lattice, self.times, self.between_made) = (rendered.lattice, rendered.times, moments.len());
        Ok(())
    }

    pub(super) fn raster_settings(&self, outputs: Outputs) -> RasterSettings {
        let PipelineSettings { dilation, background, .. } = self.settings;
        RasterSettings {
            outputs,
            dilation: dilation.at_scale(self.settings.raster_scale()),
            jitter: self.offset,
            margin: self.margin,
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
        let around = &mut self.around;
        self.times.time(Stage::Rasterize, || {
            if settings.margin == Margin::NONE {
                return rasterizer.rasterize(&lr_camera, &settings, gbuffer);
            }
            rasterizer.rasterize(&lr_camera, &settings, around)?;
            around.crop(gbuffer);
            Ok(())
        })?;
        self.current.lattice = DepthLattice::of(&self.current.gbuffer);
        Ok(())
    }

    fn enlarge(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        image.resize(camera.width() as usize, camera.height() as usize);
        let scale = self.settings.scale;
        Ok(self.times.time(Stage::SuperSample, || resample(gbuffer, scale, Kernel::Bicubic, image))?)
    }

    fn super_sample(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        let Frame { gbuffer, image, .. } = &mut self.current;
        let (super_sampler, previous) = (&mut self.super_sampler, &self.previous);
        let (learned, analytic) = (&mut self.learned_super_sampler, &mut self.analytic);
        let around = if self.margin == Margin::NONE { &*gbuffer } else { &self.around };
        self.times.time(Stage::SuperSample, || {
            let Some(learned) = learned else {
                return Ok(super_sampler.super_sample_within(camera, gbuffer, around, image)?);
            };
            super_sampler.super_sample_within(camera, gbuffer, around, analytic)?;
            let previous = match &previous.camera {
                Some(camera) if self.invalid.is_none() => {
                    Some(Neighbor { camera, image: &previous.image, gbuffer: &previous.gbuffer })
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
            let moments = cameras_between(&self.settings, previous, camera, between);
            for ((t, at), out) in moments.zip(images) {
                match learned {
                    Some(learned) => {
                        learned.interpolate(interpolator, before, after, t as f32, &at, out)?;
                    }
                    None => interpolator.interpolate(before, after, t as f32, &at, out)?,
                }
                self.between_made += 1;
            }
            Ok(())
        })
    }
}

/// Moments of the frames between two rendered ones, and their cameras: those of `between` where it has any, else
/// poses between the two.
fn cameras_between<'a>(
    settings: &PipelineSettings,
    previous: &'a Camera,
    camera: &'a Camera,
    between: &'a [Camera],
) -> impl Iterator<Item = (f64, Camera)> + use<'a> {
    settings
        .moments()
        .enumerate()
        .map(move |(k, t)| (t, between.get(k).copied().unwrap_or_else(|| pose_between(previous, camera, t))))
}
