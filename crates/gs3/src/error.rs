//! Why frames cannot be made.

use gs3_neural::{RunError, WeightError};
use gs3_raster::RasterError;
use gs3_reconstruct::ReconstructError;
use gs3_scene::Size;

/// A network that cannot be used, or frames that do not fit it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// Weights of another network.
    #[error("weights: expected those of {expected}, found those of {actual}")]
    Other {
        /// The network expected.
        expected: &'static str,
        /// The network that the weights are of.
        actual: String,
    },
    /// Weights for another scale.
    #[error("weights: expected those for scale {expected}, found those for scale {actual}")]
    Scale {
        /// The pipeline's scale.
        expected: u32,
        /// The weights' scale.
        actual: u32,
    },
    /// Two weights files for one network.
    #[error("weights: expected at most one file for {network}, found two")]
    Twice {
        /// The network.
        network: String,
    },
    /// No weights of this tier and scale are part of this version.
    #[error("tier {tier} at scale {scale}: expected one of {available}, which come with this version")]
    NotShipped {
        /// Tier asked for.
        tier: &'static str,
        /// Scale asked for.
        scale: u32,
        /// Tiers and scales that there are.
        available: String,
    },
    /// Weights that do not fit their network.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The network refuses its inputs.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The GPU cannot run the network.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] gs3_neural::GpuRunError),
    /// The reconstruction refuses its inputs.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
}

/// Why a frame could not be made. No frame is presented then, and the last frame stays. An invalid request is refused
/// before anything changes. If a device fails later, the next frame starts without history.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// Frames are to stay on a device that does not make the whole frame.
    #[error(
        "frame on a device: expected a pipeline that makes all of it on a GPU (render_on, mode super-sample or full, with networks a size that is a multiple of the scale), found one that does not"
    )]
    NotOnDevice,
    /// The rasterizer refuses the settings.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A GPU has too little memory, fails or is lost:
    /// [`FramePipeline::render_on_cpu`](crate::FramePipeline::render_on_cpu) continues without it.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] gs3_compute::GpuError),
    /// A GPU is asked for, and the library was built without GPU support.
    #[cfg(not(feature = "gpu"))]
    #[error("backend: expected auto or cpu, as gs3 was built without its feature gpu, found gpu")]
    NoGpuFeature,
    /// The reconstruction refuses its inputs.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// A network cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The number of in-between frames is too small or too large.
    #[error(
        "in-between frames: expected {} to {} frames for each rendered one, found {actual}",
        expected[0],
        expected[1]
    )]
    InBetween {
        /// Least and largest number.
        expected: [u32; 2],
        /// Frames asked for.
        actual: u32,
    },
    /// The share of pixels to be rasterized exactly is not in `[0, 1]`.
    #[error("refine: expected a share of the pixels from 0 to 1, found {actual}")]
    RefineShare {
        /// The share asked for.
        actual: f32,
    },
    /// A fault of this library: a stage lacks data that earlier stages should have left.
    #[error("internal error: expected {expected}, found none; please report it")]
    Internal {
        /// What the stage needs.
        expected: &'static str,
    },
    /// The number of cameras between the previous frame and this one is not the number of in-between frames.
    #[error("cameras between two frames: expected none or {expected}, found {actual}")]
    Between {
        /// Number of in-between frames.
        expected: usize,
        /// Number of cameras given.
        actual: usize,
    },
    /// A camera between the previous frame and this one has another size.
    #[error("camera between two frames: expected {expected} pixels, found {actual}")]
    BetweenSize {
        /// The frame's size.
        expected: Size,
        /// The size of the camera between.
        actual: Size,
    },
}

#[cfg(feature = "gpu")]
impl From<gs3_raster::GpuRasterError> for PipelineError {
    fn from(error: gs3_raster::GpuRasterError) -> Self {
        match error {
            gs3_raster::GpuRasterError::Settings(error) => error.into(),
            gs3_raster::GpuRasterError::Gpu(error) => error.into(),
        }
    }
}

#[cfg(feature = "gpu")]
impl From<gs3_reconstruct::gpu::GpuReconstructError> for PipelineError {
    fn from(error: gs3_reconstruct::gpu::GpuReconstructError) -> Self {
        match error {
            gs3_reconstruct::gpu::GpuReconstructError::Reconstruct(error) => error.into(),
            gs3_reconstruct::gpu::GpuReconstructError::Gpu(error) => error.into(),
        }
    }
}

#[cfg(feature = "gpu")]
impl From<gs3_neural::GpuRunError> for PipelineError {
    fn from(error: gs3_neural::GpuRunError) -> Self {
        match error {
            gs3_neural::GpuRunError::Gpu(error) => error.into(),
            error => NetworkError::from(error).into(),
        }
    }
}
