//! What can stop a training.

use std::path::PathBuf;

use gs3_neural::{GraphError, RunError, WeightError};

use crate::clip::ClipError;

/// Why a training does not start or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A clip is damaged or gone.
    #[error(transparent)]
    Clip(#[from] ClipError),
    /// No network of that scale.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The network refuses its inputs.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A frame cannot be interpolated.
    #[error(transparent)]
    Reconstruct(#[from] gs3::reconstruct::ReconstructError),
    /// Weights cannot be read or written, or are another network's.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// What is wrong with a weights file.
    #[error("{}: {source}", path.display())]
    WeightsFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: WeightError,
    },
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// A setting out of range.
    #[error("{name}: expected {expected}, found {actual}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// What it can be.
        expected: String,
        /// What it is.
        actual: String,
    },
    /// No clips to train on.
    #[error("{}: expected clips (*.clip) to train on, found none", folder.display())]
    NoClips {
        /// The folder.
        folder: PathBuf,
    },
    /// A clip for another network or scale, or too small.
    #[error("{}: expected {expected}, found {actual}", path.display())]
    OtherClip {
        /// The clip.
        path: PathBuf,
        /// What the training needs.
        expected: String,
        /// What the clip is.
        actual: String,
    },
    /// A checkpoint that makes no sense.
    #[error("{}, {field}: expected {expected}, found {actual}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: String,
        /// What it is.
        actual: String,
    },
    /// The loss is infinite or not a number.
    #[error("step {step}: expected a finite loss, found {loss}; a lower rate may help")]
    Diverged {
        /// The step.
        step: u64,
        /// The loss.
        loss: f64,
    },
}
