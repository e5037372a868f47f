//! Methods under evaluation: scene and cameras in, displayed frames out, timed by stage.
//!
//! gs3's own modes run through [`gs3::FramePipeline`], so that what is measured is what is shown. The baselines share
//! its rasterizer and differ in what follows.

mod baseline;
mod formation;
mod interpolation;
mod learned;
mod spec;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gs3::{
    Culling, Dilation, FramePipeline, KEYFRAMES, Mode, NetworkError, PipelineError, PipelineSettings,
    Presented, Quality, Refine, ResetReason, Sampling, Scale, Stage,
};
use gs3_raster::RasterError;
use gs3_reconstruct::{Kriging, ReconstructError};
use gs3_scene::{Camera, Scene};

use crate::network::PublishedWeightError;
use crate::upscale::{RidgeError, UpscaleError};
use baseline::Baseline;
pub(crate) use learned::{check_weights, weights_digest};
pub use spec::{DEFAULT_METHODS, Formation, Interpolation, MethodSpec, Spatial, SpecError};

/// Durations of the stages of a rendered frame, in the order of [`Stage::ALL`]; none for stages that did not run or
/// have no meaningful time.
pub type Durations = [Option<Duration>; Stage::ALL.len()];

/// Why a method gave no frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MethodError {
    /// The rasterizer refused its settings.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The frame pipeline failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The reconstruction failed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The upscaler failed.
    #[error(transparent)]
    Upscale(#[from] UpscaleError),
    /// The ridge map could not be fitted.
    #[error(transparent)]
    Ridge(#[from] RidgeError),
    /// A network's weights cannot be used.
    #[error(transparent)]
    Weights(#[from] PublishedWeightError),
    /// A network was asked for and no folder of weights named.
    #[error("{method}: expected a folder of weights, found none named")]
    NoWeights {
        /// The method.
        method: MethodSpec,
    },
    /// The folder of weights is none.
    #[error("weights: expected a folder, found none at {}", .folder.display())]
    WeightFolder {
        /// What was named.
        folder: PathBuf,
    },
    /// The folder of weights lacks a network's.
    #[error("{method}: expected a file of weights at {}, found none", .file.display())]
    WeightFile {
        /// The method.
        method: MethodSpec,
        /// The file expected.
        file: PathBuf,
    },
    /// Parts of the method do not go together.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A network of gs3 cannot be used.
    #[error("{method}: {source}")]
    Network {
        /// The method.
        method: MethodSpec,
        /// Why.
        source: NetworkError,
    },
    /// A file of weights cannot be used.
    #[error("{method}: {}: {source}", .file.display())]
    NetworkFile {
        /// The method.
        method: MethodSpec,
        /// The file.
        file: PathBuf,
        /// Why.
        source: Box<NetworkError>,
    },
    /// There are no frames to fit a map on.
    #[error("{method}: expected frames of the path outside the evaluated ones to fit on, found none")]
    NoTrainingFrames {
        /// The method.
        method: MethodSpec,
    },
}

/// A method at work on one sequence.
pub trait Method {
    /// Forgets the frames before.
    fn reset(&mut self);

    /// Renders the frame of `camera`, and the frames between the previous frame and this one at the cameras `between`:
    /// as many as [`MethodSpec::in_between`] says, in order, equally spaced in time. At the first frame and at a cut
    /// `between` is empty. Where a method gives no frames between, the previous frame is shown at these moments.
    ///
    /// # Errors
    /// [`MethodError`] if the method cannot, or if `between` has another number.
    fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Presented<'_>, MethodError>;

    /// How long the stages of the last frame took.
    fn durations(&self) -> Durations;

    /// The share of the last rendered frame's pixels, in `[0, 1]`, that were rasterized exactly beside its LR frame;
    /// none if the method never does that. Reports have a column of it where some method gives one.
    fn refined_share(&self) -> Option<f64> {
        None
    }
}

/// What all methods share.
#[derive(Clone, Debug)]
pub struct MethodSettings {
    /// The scene.
    pub scene: Arc<Scene>,
    /// HR over LR size.
    pub scale: u32,
    /// Which tiles a splat is assigned to.
    pub culling: Culling,
    /// Background, display-encoded RGB, finite.
    pub background: [f32; 3],
    /// Cameras outside the evaluated frames, for methods that fit something to the scene.
    pub training: Vec<Camera>,
    /// Folder with the weights of published networks: `span28_x4.safetensors`, `safmnpp_light_x4.safetensors`,
    /// `rt4ksr_x2.safetensors`; and of gs3's own, in place of those that come with it:
    /// `super_sample_balanced_x4.safetensors`, `interpolate_balanced_x4.safetensors` and so on.
    pub weights: Option<PathBuf>,
}

/// Makes the method that `spec` names.
///
/// # Errors
/// [`MethodError`] if the scale is not supported or a map cannot be fitted.
pub fn build(spec: MethodSpec, settings: &MethodSettings) -> Result<Box<dyn Method>, MethodError> {
    spec.check(&spec.to_string())?;
    let mode = match spec.interpolation {
        Interpolation::None if spec.spatial == Spatial::Native => Mode::Native,
        Interpolation::None if spec.spatial.is_pipeline() => Mode::SuperSample,
        Interpolation::Warp(_) | Interpolation::Learned(_) if spec.spatial.is_pipeline() => Mode::Full,
        _ => return Ok(Box::new(Baseline::new(spec, settings)?)),
    };
    Ok(Box::new(pipeline(mode, spec, settings)?))
}

fn pipeline(mode: Mode, spec: MethodSpec, settings: &MethodSettings) -> Result<FramePipeline, MethodError> {
    let dilation = match (mode, spec.formation) {
        (Mode::Native, _) | (_, Formation::Kerbl) => Dilation::Kerbl,
        (_, Formation::Matched | Formation::Antialiased) => Dilation::Matched,
    };
    let settings_ = PipelineSettings {
        mode,
        scale: Scale::Fixed(settings.scale),
        sampling: if spec.spatial.is_jittered() { Sampling::Jittered } else { Sampling::Centered },
        kriging: match spec.spatial {
            Spatial::Kriging | Spatial::Overscan => Kriging::On,
            _ => Kriging::Off,
        },
        overscan: spec.spatial == Spatial::Overscan,
        refine: if matches!(spec.spatial, Spatial::Refined(_)) { Refine::Auto } else { Refine::Off },
        quality: match spec.spatial {
            Spatial::Refined(quality) => quality,
            _ => Quality::default(),
        },
        // The paper's methods have none.
        keyframes: if matches!(spec.spatial, Spatial::Refined(_)) { KEYFRAMES } else { 0 },
        dilation,
        culling: settings.culling,
        // Modes without frames between do not read it.
        in_between: spec.in_between(),
        background: settings.background,
        ..PipelineSettings::default()
    };
    let networks = learned::networks(spec, settings.scale, settings.weights.as_deref())?;
    Ok(FramePipeline::with_networks(Arc::clone(&settings.scene), settings_, &networks)?)
}

impl Method for FramePipeline {
    fn reset(&mut self) {
        FramePipeline::reset(self, ResetReason::CameraCut);
    }

    fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Presented<'_>, MethodError> {
        Ok(self.render_with_poses(camera, between)?)
    }

    fn refined_share(&self) -> Option<f64> {
        let is_refined = self.settings().mode.has_history() && self.settings().refine.is_on();
        is_refined.then(|| f64::from(FramePipeline::refined_share(self)))
    }

    fn durations(&self) -> Durations {
        Stage::ALL.map(|stage| self.times().get(stage))
    }
}
