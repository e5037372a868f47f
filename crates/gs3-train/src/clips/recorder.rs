//! Renders a shot, and keeps what a network is fed.

use gs3::learned::{CameraDepth, InterpolateFeatures, LearnedSuperSampler, SuperSampleFeatures};
use gs3::neural::model::Tier;
use gs3::neural::{Arithmetic, Graph, Layer, Named, Op};
use gs3::raster::{Culling, Outputs, RasterSettings, Rasterizer};
use gs3::reconstruct::{Depth, Interpolator, Neighbor, SuperSampler, Warped};
use gs3::scene::{Camera, GBuffer, Image, Planes};
use gs3::{AdaptiveJitter, DepthLattice, ResetReason, Sampling};
use half::f16;

use super::draw::Draw;
use super::error::MakeError;
use super::shot::Shot;
use super::{ClipSettings, ClipSource};
use crate::clip::{Clip, ClipError, ClipFrame, ClipPlane, Network, to_unorm};

/// Renders clips of one scene; keeps its memory between them.
pub(super) struct Recorder<'a> {
    source: &'a ClipSource,
    settings: &'a ClipSettings,
    graph: Graph,
    jitter: AdaptiveJitter,
    rasterizer: Rasterizer,
    super_sampler: SuperSampler,
    learned: Option<LearnedSuperSampler>,
    interpolator: Interpolator,
    native: Image,
}

/// A frame as the pipeline makes it.
struct Rendered {
    camera: Camera,
    gbuffer: GBuffer,
    /// Made without learning.
    image: Image,
    /// Refined by the super-sampling network, where one is given.
    refined: Option<Image>,
}

impl Rendered {
    /// The frame as it was made without learning.
    const fn analytic(&self) -> Neighbor<'_> {
        Neighbor { camera: &self.camera, image: &self.image, gbuffer: &self.gbuffer, gradients: None }
    }

    /// The frame as it is shown.
    fn neighbor(&self) -> Neighbor<'_> {
        Neighbor { image: self.refined.as_ref().unwrap_or(&self.image), ..self.analytic() }
    }
}

impl<'a> Recorder<'a> {
    /// For clips of `source` with checked `settings`.
    pub fn new(source: &'a ClipSource, settings: &'a ClipSettings) -> Result<Self, MakeError> {
        let weights = settings.super_sample.clone();
        let learned =
            weights.map(|weights| LearnedSuperSampler::new(weights, settings.scale, Arithmetic::F32));
        Ok(Self {
            source,
            settings,
            // Inputs that clips hold are the same for all tiers.
            graph: settings.network.graph(settings.scale, Tier::Fast).map_err(ClipError::from)?,
            jitter: AdaptiveJitter::new(settings.scale, Sampling::Jittered),
            rasterizer: Rasterizer::new(source.scene.clone(), Culling::default()),
            super_sampler: SuperSampler::new(settings.scale, settings.kriging)?,
            learned: learned.transpose()?,
            interpolator: Interpolator::new(settings.scale)?,
            native: Image::default(),
        })
    }

    /// The clip of `seed`.
    pub fn record(&mut self, seed: u64, is_held_out: bool) -> Result<Clip, MakeError> {
        let mut draw = Draw::new(seed);
        let shot = Shot::draw(&mut draw, self.source, self.settings, is_held_out, &mut self.rasterizer)?;
        self.super_sampler.reset(ResetReason::CameraCut);
        self.jitter.reset();
        self.learned.iter_mut().for_each(LearnedSuperSampler::reset);
        let frames = match self.settings.network {
            Network::SuperSample => self.super_sampled(&shot)?,
            Network::Interpolate => self.interpolated(&shot)?,
        };
        let ClipSettings { network, scale, .. } = *self.settings;
        let camera = shot.camera(0.0)?.low_resolution(scale);
        let lr = [camera.height() as usize, camera.width() as usize];
        let clip = Clip { network, scene: self.source.name.clone(), scale, lr, frames };
        Ok(clip.crop(&shot.framing.window(self.settings.frames))?)
    }

    /// Frames for super sampling: the analytic pipeline's and features.
    fn super_sampled(&mut self, shot: &Shot) -> Result<Vec<ClipFrame>, MakeError> {
        let mut features = SuperSampleFeatures::new(self.settings.scale)?;
        let mut frames = Vec::with_capacity(self.settings.frames);
        let mut previous: Option<Rendered> = None;
        for k in 0..shot.past + self.settings.frames {
            let now = self.render(shot, k, previous.as_ref())?;
            if k >= shot.past {
                features.set(
                    now.analytic(),
                    self.super_sampler.innovation(),
                    previous.as_ref().map(Rendered::neighbor),
                )?;
                let target = self.native(shot, &now.camera)?;
                frames.push(frame(&self.graph, &features.named(&now.image), target));
            }
            previous = Some(now);
        }
        Ok(frames)
    }

    /// Frames for interpolation: those around them, as the analytic pipeline makes them, warped; and features.
    fn interpolated(&mut self, shot: &Shot) -> Result<Vec<ClipFrame>, MakeError> {
        let ClipSettings { frames: count, scale, .. } = *self.settings;
        let mut features = InterpolateFeatures::default();
        let mut frames = Vec::with_capacity(count);
        let mut warped = Warped::default();
        // Camera and inverse depths of the last in-between frame.
        let mut last: Option<(Camera, Planes<1>)> = None;
        let mut before = self.render(shot, 0, None)?;
        for k in 1.. {
            let after = self.render(shot, k, Some(&before))?;
            let parts = if k > shot.past { shot.in_between } else { 0 };
            for part in 1..=parts {
                let t = part as f64 / (shot.in_between + 1) as f64;
                let camera = shot.camera((k - 1) as f64 + t)?;
                let neighbors = (before.neighbor(), after.neighbor());
                self.interpolator.warp(neighbors.0, neighbors.1, t as f32, &camera, &mut warped)?;
                let seen =
                    last.as_ref().map(|(camera, depth)| CameraDepth { camera, depth: Depth::Inverse(depth) });
                features.set(&camera, &warped.inverse_depth, t as f32, seen, scale)?;
                let target = self.native(shot, &camera)?;
                let [from, to] = [&warped.before, &warped.after].map(|image| image.pixels().as_flattened());
                frames.push(frame(&self.graph, &features.named(from, to, warped.share.plane(0)), target));
                if frames.len() == count {
                    return Ok(frames);
                }
                last = Some((camera, warped.inverse_depth.clone()));
            }
            before = after;
        }
        Ok(frames)
    }

    /// Frame `k` after the reset, which follows `previous`.
    fn render(&mut self, shot: &Shot, k: usize, previous: Option<&Rendered>) -> Result<Rendered, MakeError> {
        let scale = self.settings.scale;
        let camera = shot.camera(k as f64)?;
        let depths = previous.map(|previous| DepthLattice::of(&previous.gbuffer)).unwrap_or_default();
        let settings = RasterSettings {
            dilation: self.settings.dilation.at_scale(scale),
            jitter: self.jitter.next(&camera, &depths),
            background: shot.background,
            ..RasterSettings::new(Outputs::GBuffer)
        };
        let mut gbuffer = GBuffer::default();
        self.rasterizer.rasterize(&camera.low_resolution(scale), &settings, &mut gbuffer)?;
        let mut image = Image::default();
        self.super_sampler.super_sample(&camera, &gbuffer, &mut image)?;
        let mut refined = None;
        if let Some(learned) = &mut self.learned {
            let now = Neighbor { camera: &camera, image: &image, gbuffer: &gbuffer, gradients: None };
            let mut out = Image::default();
            learned.refine(
                now,
                self.super_sampler.innovation(),
                previous.map(Rendered::neighbor),
                &mut out,
            )?;
            refined = Some(out);
        }
        Ok(Rendered { camera, gbuffer, image, refined })
    }

    /// What `camera` sees natively, as a target.
    fn native(&mut self, shot: &Shot, camera: &Camera) -> Result<Vec<u16>, MakeError> {
        let settings = RasterSettings { background: shot.background, ..RasterSettings::new(Outputs::Color) };
        self.rasterizer.rasterize_image(camera, &settings, &mut self.native)?;
        Ok(self.native.pixels().iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).map(to_unorm).collect())
    }
}

/// A frame of a clip for the network `graph` from what it is fed and what it should give.
fn frame(graph: &Graph, fed: &[Named<'_>], target: Vec<u16>) -> ClipFrame {
    let plane = |layer: &Layer| {
        let Op::Input { channels, .. } = layer.op else { return None };
        let (_, values) = fed.iter().find(|(name, _)| *name == layer.name)?;
        let values = values.iter().map(|v| f16::from_f32(*v)).collect();
        Some(ClipPlane { name: layer.name.clone(), channels, values })
    };
    ClipFrame { inputs: graph.inputs().filter_map(|(_, layer)| plane(layer)).collect(), target }
}
