//! Spatial baselines: one low-resolution (LR) frame to one high-resolution (HR) frame, no memory of other frames.
//!
//! All place LR pixel `i` at HR coordinate `S (i + ½ + jitter)`: a shift of half an LR pixel, the commonest mistake in
//! comparisons of super sampling, costs several dB.

mod fsr1;
mod lanczos;
mod lattice;
mod ridge;

pub use fsr1::Fsr1;
pub use lanczos::Lanczos;
pub use ridge::{RidgeError, RidgeMap};

use gs3_raster::Outputs;
use gs3_reconstruct::{ReconstructError, ResampleKernel};
use gs3_scene::{GBuffer, Image, Size};

/// Why a frame was not upscaled.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UpscaleError {
    /// The reconstruction refused its input.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The output is not `scale` times the size of the input.
    #[error("upscaled image: expected {expected} pixels, found {actual}")]
    Size {
        /// `scale` times the size of the LR frame.
        expected: Size,
        /// Size of the output.
        actual: Size,
    },
    /// The method is made for one scale factor.
    #[error("{method}: expected scale {expected}, found {actual}")]
    Scale {
        /// The method.
        method: &'static str,
        /// The scale that it is made for.
        expected: u32,
        /// The scale found.
        actual: u32,
    },
    /// The method needs samples at the pixel centres.
    #[error("{method}: expected no jitter, found [{}, {}]", .actual[0], .actual[1])]
    Jitter {
        /// The method.
        method: &'static str,
        /// The jitter found.
        actual: [f32; 2],
    },
    /// A network cannot be run.
    #[error("{method}: {message}")]
    Network {
        /// The method.
        method: &'static str,
        /// Why.
        message: String,
    },
    /// The method reads image gradients and the frame has none.
    #[error("{method}: expected a G-buffer with gradients, found one without")]
    NoGradients {
        /// The method.
        method: &'static str,
    },
}

/// A spatial upscaler.
pub trait Upscaler: Send {
    /// Planes that it reads.
    fn outputs(&self) -> Outputs {
        Outputs::Color
    }

    /// The jitter of the LR frames that it is made for, in LR pixels.
    fn jitter(&self) -> [f32; 2] {
        [0.0; 2]
    }

    /// Enlarges `lr` by `scale` into `out`, which has `scale` times the size of `lr`. The fourth channel becomes 0.
    ///
    /// # Errors
    /// [`UpscaleError`] if sizes, scale or planes do not suit the method.
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError>;
}

impl Upscaler for ResampleKernel {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        Ok(gs3_reconstruct::resample(lr, scale, *self, out)?)
    }
}

/// Gradient-aware cubic Hermite interpolation of a single frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hermite {
    /// The mixed derivative is estimated from the gradients of the neighbours.
    EstimatedMixed,
    /// The mixed derivative is rendered: the spline of UpscaleGS.
    ExactMixed,
}

impl Upscaler for Hermite {
    fn outputs(&self) -> Outputs {
        match self {
            Self::EstimatedMixed => Outputs::Samples,
            Self::ExactMixed => Outputs::GBufferMixed,
        }
    }

    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        Ok(gs3_reconstruct::hermite(lr, scale, out)?)
    }
}

/// Checks that `out` is `scale` times the size of `lr`.
pub(crate) fn check_size(lr: &GBuffer, scale: u32, out: &Image) -> Result<(), UpscaleError> {
    let (expected, actual) = (lr.size().map(|side| side.saturating_mul(scale)), out.size());
    if expected == actual { Ok(()) } else { Err(UpscaleError::Size { expected, actual }) }
}
