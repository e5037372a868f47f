//! Renders clips from scenes: random cameras near given paths that move at random, windows of their views, what a
//! network is fed there and the native frames.
//!
//! A clip is a window of a large view, not a small view: splats, gradients and motion are as in whole frames. Around
//! the window a margin is rendered too, and cut away, so that what enters it has a past.

mod analytic;
mod batch;
mod draw;
mod error;
mod framing;
mod movement;
mod preview;
mod recorder;
mod shot;
mod start;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use gs3::neural::Weights;
use gs3::scene::{CameraPath, Scene, Size};
use gs3::{Dilation, Kriging};

pub use analytic::{analytic, analytic_psnr};
pub use batch::{Batch, MadeClip};
pub use error::MakeError;
pub use preview::preview;

use crate::clip::Network;
use framing::Framing;

/// What clips are to be like.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipSettings {
    /// The network they are for.
    pub network: Network,
    /// HR pixels per LR pixel along a side.
    pub scale: u32,
    /// Frames of a clip, at least 1.
    pub frames: usize,
    /// HR pixels, sides that are multiples of `scale`, up to 4096×2160.
    pub size: Size,
    /// Dilation of projected covariances in LR frames.
    pub dilation: Dilation,
    /// The last part of every path that is for held-out clips only, as a share, `[0, ½]`.
    pub held_out: f64,
    /// What all that is random depends on, together with a scene's name and a clip's number.
    pub seed: u64,
    /// Weights of super sampling for the frames that others are made from: the neighbours of in-between frames, and
    /// the previous frame of super sampling. Without weights, these frames come from the pipeline without networks.
    /// Super sampling is trained in rounds: the first round without weights, and each later round on clips with the
    /// weights of the round before.
    pub super_sample: Option<Arc<Weights>>,
    /// Which pixels are kriged, as they are below the network to be trained: coarsely for tier fast, finely for tier
    /// high.
    pub kriging: Kriging,
}

/// A scene and where cameras may be in it.
#[derive(Clone, Debug)]
pub struct ClipSource {
    /// Names its clips.
    pub name: String,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Cameras of clips are near these.
    pub paths: Vec<CameraPath>,
}

impl ClipSettings {
    /// Checks sizes and shares.
    ///
    /// # Errors
    /// [`MakeError`] naming what makes no sense.
    pub fn check(&self) -> Result<(), MakeError> {
        // Refuses scales without a network, too.
        self.network.graph(self.scale, gs3::neural::model::Tier::Fast).map_err(crate::ClipError::from)?;
        let fits = |(side, most): (u32, u32)| side > 0 && side.is_multiple_of(self.scale) && side <= most;
        if !self.size.to_array().into_iter().zip(Framing::LARGEST.to_array()).all(fits) {
            return Err(MakeError::Size { scale: self.scale, actual: self.size });
        }
        if self.frames == 0 {
            return Err(MakeError::Frames);
        }
        if !(0.0..=0.5).contains(&self.held_out) {
            return Err(MakeError::HeldOut { actual: self.held_out });
        }
        Ok(())
    }

    /// Rendered frames that the frames of a clip need, with `in_between` frames between any two.
    fn rendered(&self, in_between: usize) -> usize {
        match self.network {
            Network::SuperSample => self.frames,
            Network::Interpolate => self.frames.div_ceil(in_between.max(1)) + 1,
        }
    }
}
