//! Baselines: a spatial upscaler (or gs3's history, or native frames) and an interpolation, in any combination.

use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::{
    DepthLattice, FramePipeline, MAX_IN_BETWEEN, Mode, PipelineError, Presented, ResetReason, Sampling, Stage,
};
use gs3_raster::{KERBL_DILATION, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_reconstruct::{FrameSequence, Interpolator, Kriging, ResampleKernel, SuperSampler};
use gs3_scene::{Camera, GBuffer, Gradients, Image};
use rayon::prelude::*;

use super::formation::reduce;
use super::interpolation::{Frame, interpolate};
use super::learned::{published, trained};
use super::{
    Durations, Formation, Interpolation, Method, MethodError, MethodSettings, MethodSpec, Spatial, pipeline,
};
use crate::network::{PublishedWeights, Rt4ksr, Safmn, Span};
use crate::upscale::{Fsr1, Hermite, Lanczos, RidgeMap, Upscaler};

/// A method put together from parts.
pub(super) struct Baseline {
    spec: MethodSpec,
    spatial: SpatialPart,
    interpolator: Interpolator,
    previous: Frame,
    current: Frame,
    between: Vec<Image>,
    durations: Durations,
}

/// What makes the rendered frames.
enum SpatialPart {
    /// gs3's pipeline, without interpolation.
    Pipeline(Box<FramePipeline>),
    /// gs3's history on gradients of bicubic interpolation.
    Gradientless { source: Box<LrSource>, super_sampler: Box<SuperSampler>, sequence: Box<FrameSequence> },
    /// LR frames and an upscaler.
    Upscaled { source: Box<LrSource>, upscaler: Box<dyn Upscaler> },
}

impl Baseline {
    pub fn new(spec: MethodSpec, settings: &MethodSettings) -> Result<Self, MethodError> {
        let of_pipeline = |mode| pipeline(mode, spec, settings).map(|p| SpatialPart::Pipeline(Box::new(p)));
        let upscaled = |upscaler: Box<dyn Upscaler>| {
            let outputs = match (upscaler.outputs(), spec.interpolation) {
                (Outputs::Color, Interpolation::Warp(_)) => Outputs::Samples,
                (outputs, _) => outputs,
            };
            let source = Box::new(LrSource::new(spec.formation, outputs, settings));
            SpatialPart::Upscaled { source, upscaler }
        };
        let spatial = match spec.spatial {
            Spatial::Native => of_pipeline(Mode::Native)?,
            Spatial::History
            | Spatial::Refined(_)
            | Spatial::Kriging
            | Spatial::Overscan
            | Spatial::Centered
            | Spatial::Learned(_) => of_pipeline(Mode::SuperSample)?,
            Spatial::Gradientless => SpatialPart::Gradientless {
                source: Box::new(LrSource::new(spec.formation, Outputs::Samples, settings)),
                super_sampler: Box::new(SuperSampler::new(settings.scale, Kriging::Off)?),
                sequence: Box::new(FrameSequence::new(settings.scale, Sampling::Jittered, 0)),
            },
            Spatial::Nearest => upscaled(Box::new(ResampleKernel::Nearest)),
            Spatial::Bilinear => upscaled(Box::new(ResampleKernel::Bilinear)),
            Spatial::Bicubic => upscaled(Box::new(ResampleKernel::Bicubic)),
            Spatial::Lanczos => upscaled(Box::<Lanczos>::default()),
            Spatial::Fsr1 => upscaled(Box::<Fsr1>::default()),
            Spatial::Hermite => upscaled(Box::new(Hermite::EstimatedMixed)),
            Spatial::Spline => upscaled(Box::new(Hermite::ExactMixed)),
            Spatial::Ridge => upscaled(Box::new(fit_ridge(spec, settings)?)),
            Spatial::Span => upscaled(Box::new(Span::new(&weights(spec, settings)?)?)),
            Spatial::Safmn => upscaled(Box::new(Safmn::new(&weights(spec, settings)?)?)),
            Spatial::Rt4ksr => upscaled(Box::new(Rt4ksr::new(&weights(spec, settings)?)?)),
            Spatial::Trained(peer) => {
                upscaled(Box::new(trained(spec, peer, settings.scale, settings.weights.as_deref())?))
            }
        };
        Ok(Self {
            spec,
            spatial,
            interpolator: Interpolator::new(settings.scale)?,
            previous: Frame::default(),
            current: Frame::default(),
            between: vec![Image::default(); spec.in_between() as usize],
            durations: Durations::default(),
        })
    }
}

impl Method for Baseline {
    fn reset(&mut self) {
        self.previous.camera = None;
        self.current.camera = None;
        match &mut self.spatial {
            SpatialPart::Pipeline(pipeline) => pipeline.reset(ResetReason::CameraCut),
            SpatialPart::Gradientless { sequence, .. } => sequence.reset(ResetReason::CameraCut),
            SpatialPart::Upscaled { .. } => {}
        }
    }

    fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Presented<'_>, MethodError> {
        let (expected, actual) = (self.between.len(), between.len());
        if ![0, expected].contains(&actual) {
            return Err(PipelineError::Between { expected, actual }.into());
        }
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = Some(*camera);
        self.durations = Durations::default();
        let needs_gbuffer = matches!(self.spec.interpolation, Interpolation::Warp(_));
        match &mut self.spatial {
            SpatialPart::Pipeline(pipeline) => {
                self.current.image.clone_from(pipeline.render(camera)?.current);
                if needs_gbuffer {
                    self.current.gbuffer.clone_from(pipeline.gbuffer());
                }
                self.durations = Stage::ALL.map(|stage| pipeline.times().get(stage));
            }
            SpatialPart::Gradientless { source, super_sampler, sequence } => {
                let Frame { gbuffer, image, .. } = &mut self.current;
                let start = sequence.begin(camera);
                if let Some(reason) = start.reset {
                    super_sampler.reset(reason);
                }
                self.durations[Stage::Rasterize as usize] = source.render(camera, start.jitter, gbuffer)?;
                sequence.commit(camera, start.reset, start.jitter, DepthLattice::of(gbuffer));
                let started = Instant::now();
                difference(gbuffer);
                super_sampler.super_sample(camera, gbuffer, image)?;
                self.durations[Stage::SuperSample as usize] = Some(started.elapsed());
            }
            SpatialPart::Upscaled { source, upscaler } => {
                let Frame { gbuffer, image, .. } = &mut self.current;
                self.durations[Stage::Rasterize as usize] =
                    source.render(camera, upscaler.jitter(), gbuffer)?;
                let started = Instant::now();
                image.resize(camera.width() as usize, camera.height() as usize);
                upscaler.upscale(gbuffer, source.scale, image)?;
                self.durations[Stage::SuperSample as usize] = Some(started.elapsed());
            }
        }
        let mut in_between = [None; MAX_IN_BETWEEN as usize];
        if self.previous.camera.is_some() {
            let places = in_between.iter_mut().zip(&mut self.between);
            for (k, (pose, (shown, out))) in between.iter().zip(places).enumerate() {
                let t = (k + 1) as f32 / (expected + 1) as f32;
                let (before, after) = (&self.previous, &self.current);
                let started = Instant::now();
                let interpolation = self.spec.interpolation;
                let is_made =
                    interpolate(interpolation, &mut self.interpolator, before, after, (t, pose), out)?;
                if is_made {
                    let spent = self.durations[Stage::Interpolate as usize].get_or_insert_default();
                    *spent += started.elapsed();
                }
                *shown = Some(if is_made { &*out } else { &before.image });
            }
        }
        Ok(Presented { in_between, current: &self.current.image })
    }

    fn durations(&self) -> Durations {
        self.durations
    }
}

/// Replaces the gradients of `lr` by central differences of its colours, one-sided at borders as if they went on flat:
/// cubic Hermite interpolation becomes Catmull–Rom.
fn difference(lr: &mut GBuffer) {
    let (width, height) = (lr.width(), lr.height());
    let Some(Gradients { color_dx, color_dy, color_dxy }) = &mut lr.gradients else { return };
    *color_dxy = None;
    let color = &lr.color;
    let across = color_dx.data_mut().par_chunks_exact_mut(width);
    across.zip(color_dy.data_mut().par_chunks_exact_mut(width)).enumerate().for_each(|(i, (dx, dy))| {
        let (c, y) = (i / height, i % height);
        let row = color.row(c, y);
        let (above, below) = (color.row(c, y.saturating_sub(1)), color.row(c, (y + 1).min(height - 1)));
        for x in 0..width {
            dx[x] = 0.5 * (row[(x + 1).min(width - 1)] - row[x.saturating_sub(1)]);
            dy[x] = 0.5 * (below[x] - above[x]);
        }
    });
}

/// Makes LR frames.
pub(super) struct LrSource {
    rasterizer: Rasterizer,
    formation: Formation,
    outputs: Outputs,
    scale: u32,
    background: [f32; 3],
    native: Image,
}

impl LrSource {
    pub fn new(formation: Formation, outputs: Outputs, settings: &MethodSettings) -> Self {
        Self {
            rasterizer: Rasterizer::new(Arc::clone(&settings.scene), settings.culling),
            formation,
            outputs,
            scale: settings.scale,
            background: settings.background,
            native: Image::default(),
        }
    }

    /// Makes the LR frame of the HR `camera`, sampled at `jitter` where it is rasterized; gives the time, where a
    /// renderer would need as long.
    fn render(
        &mut self,
        camera: &Camera,
        jitter: [f32; 2],
        lr: &mut GBuffer,
    ) -> Result<Option<Duration>, MethodError> {
        let dilation = match self.formation {
            Formation::Matched => matched_dilation(self.scale),
            Formation::Kerbl => KERBL_DILATION,
            Formation::Antialiased => {
                self.render_native(camera)?;
                reduce(&self.native, self.scale, lr);
                return Ok(None);
            }
        };
        let settings = RasterSettings {
            dilation,
            jitter,
            background: self.background,
            ..RasterSettings::new(self.outputs)
        };
        let started = Instant::now();
        self.rasterizer.rasterize(&camera.low_resolution(self.scale), &settings, lr)?;
        Ok(Some(started.elapsed()))
    }

    fn render_native(&mut self, camera: &Camera) -> Result<&Image, MethodError> {
        let settings = RasterSettings { background: self.background, ..RasterSettings::new(Outputs::Color) };
        self.rasterizer.rasterize_image(camera, &settings, &mut self.native)?;
        Ok(&self.native)
    }
}

/// Fits the ridge map to the training cameras, with the LR formation that it will see.
fn fit_ridge(spec: MethodSpec, settings: &MethodSettings) -> Result<RidgeMap, MethodError> {
    if settings.training.is_empty() {
        return Err(MethodError::NoTrainingFrames { method: spec });
    }
    let mut source = LrSource::new(spec.formation, Outputs::GBuffer, settings);
    let mut frames = Vec::new();
    for camera in &settings.training {
        let mut lr = GBuffer::default();
        source.render(camera, [0.0; 2], &mut lr)?;
        frames.push((lr, source.render_native(camera)?.clone()));
    }
    let frames: Vec<(&GBuffer, &Image)> = frames.iter().map(|(lr, hr)| (lr, hr)).collect();
    Ok(RidgeMap::fit(&frames, settings.scale)?)
}

/// Loads the weights of a published network.
fn weights(spec: MethodSpec, settings: &MethodSettings) -> Result<PublishedWeights, MethodError> {
    let file = spec.spatial.weight_file().ok_or(MethodError::NoWeights { method: spec })?;
    Ok(PublishedWeights::load(&published(spec, file, settings.weights.as_deref())?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::build;
    use gs3::Culling;
    use gs3_reconstruct::{hermite, resample};
    use gs3_scene::{Planes, demo, orbit};

    #[test]
    fn frames_between_are_those_of_the_pipeline() -> Result<(), Box<dyn std::error::Error>> {
        let scene = Arc::new(demo::scene()?);
        let path = orbit::around(&scene, 60, 96, 64)?;
        let settings = MethodSettings {
            scene,
            scale: 4,
            culling: Culling::AccuTile,
            background: [0.1, 0.2, 0.3],
            training: Vec::new(),
            weights: None,
        };
        for name in ["history+warp", "history+warp2", "history+warp3"] {
            let spec: MethodSpec = name.parse()?;
            let (mut parts, mut whole) = (Baseline::new(spec, &settings)?, build(spec, &settings)?);
            for k in 0..4 {
                let count = if k > 0 { spec.displayed_per_rendered() } else { 0 };
                let time = |part: usize| k as f64 - 1.0 + part as f64 / count as f64;
                let between: Vec<Camera> = (1..count).map(|part| path.at(time(part))).collect();
                let parts = parts.render(&path.cameras()[k], &between)?;
                let whole = whole.render(&path.cameras()[k], &between)?;
                assert_eq!(parts.iter().count(), between.len() + 1, "{name} {k}");
                assert!(parts.iter().eq(whole.iter()), "{name} {k}");
            }
            let refused = parts.render(&path.cameras()[4], &path.cameras()[..4]).err();
            assert!(
                matches!(refused, Some(MethodError::Pipeline(PipelineError::Between { actual: 4, .. }))),
                "{refused:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn hermite_on_central_differences_is_catmull_rom() {
        let (width, height) = (9, 7);
        let mut lr = GBuffer {
            color: Planes::new(width, height),
            alpha: Planes::new(width, height),
            gradients: Some(Gradients {
                color_dx: Planes::new(width, height),
                color_dy: Planes::new(width, height),
                color_dxy: None,
            }),
            ..GBuffer::default()
        };
        for (i, value) in lr.color.data_mut().iter_mut().enumerate() {
            *value = ((i * i * 37 % 101) as f32 / 101.0).clamp(0.0, 1.0);
        }
        difference(&mut lr);
        let [mut cubic, mut bicubic] = [(); 2].map(|()| Image::new(4 * width, 4 * height));
        assert_eq!(hermite(&lr, 4, &mut cubic), Ok(()));
        assert_eq!(resample(&lr, 4, ResampleKernel::Bicubic, &mut bicubic), Ok(()));
        for (i, (a, b)) in cubic.pixels().iter().zip(bicubic.pixels()).enumerate() {
            // Away from the border, where the two continue the frame in different ways.
            let (x, y) = (i % (4 * width), i / (4 * width));
            let is_inside = (8..4 * width - 8).contains(&x) && (8..4 * height - 8).contains(&y);
            assert!(!is_inside || (0..3).all(|c| (a[c] - b[c]).abs() < 1e-5), "({x}, {y}): {a:?}, {b:?}");
        }
    }
}
