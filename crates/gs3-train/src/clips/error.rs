//! Why clips cannot be made.

use std::path::PathBuf;

use gs3::NetworkError;
use gs3::raster::RasterError;
use gs3::reconstruct::ReconstructError;
use gs3::scene::{CameraError, Size};

use super::framing::Framing;
use crate::clip::ClipError;

/// A clip that cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MakeError {
    /// The size of a clip is not one that its network works on, or larger than any view.
    #[error("size of clips: expected multiples of {scale} up to {}, found {actual}", Framing::LARGEST)]
    Size {
        /// HR pixels per LR pixel along a side.
        scale: u32,
        /// The size found.
        actual: Size,
    },
    /// There are no frames to record.
    #[error("frames of a clip: expected at least 1, found 0")]
    Frames,
    /// The share of clips to hold out makes no sense.
    #[error("held-out share: expected at least 0 and at most 0.5, found {actual}")]
    HeldOut {
        /// The share found.
        actual: f64,
    },
    /// There is no camera to start from.
    #[error("{scene}: expected at least one camera path, found none")]
    NoPath {
        /// The scene.
        scene: String,
    },
    /// The scene shows nothing where cameras start.
    #[error("{scene}: expected a window that shows something, found none in {attempts} random views")]
    NothingInSight {
        /// The scene.
        scene: String,
        /// Views that were tried.
        attempts: usize,
    },
    /// A camera makes no sense.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A frame cannot be rasterized.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A frame cannot be reconstructed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// Weights do not fit, or their network refuses a frame.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A clip does not fit its network, or cannot be written.
    #[error(transparent)]
    Clip(#[from] ClipError),
    /// A clip that is there already is not like those to be made.
    #[error("{}: {field}: expected {expected}, found {actual}; clips of other settings go to another folder", file.display())]
    Mixed {
        /// The clip.
        file: PathBuf,
        /// In what it differs.
        field: &'static str,
        /// What is to be made.
        expected: String,
        /// What is there.
        actual: String,
    },
    /// No thread can be started.
    #[error("threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}
