//! What can be wrong with a camera file.

use std::path::{Path, PathBuf};

#[cfg(feature = "fs")]
use gs3_files::ReadError;

use crate::camera::CameraError;

/// Why cameras could not be read: the file and its fault.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", path.display())]
pub struct CaptureError {
    /// The file or folder.
    pub path: PathBuf,
    /// What is wrong with it.
    pub fault: CaptureFault,
}

/// What is wrong with a camera file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureFault {
    /// The file cannot be read, or is too large.
    #[cfg(feature = "fs")]
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It is none of the known formats.
    #[error(
        "expected cameras (a COLMAP model, transforms.json, cameras.json, camera_path.json, settings of SuperSplat or a \
         RealityScan CSV), found {actual}"
    )]
    Unrecognized {
        /// What was found.
        actual: String,
    },
    /// The JSON is malformed.
    #[error("expected valid JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A field is missing or has an unusable value.
    #[error("{field}: expected {expected}, found {actual}")]
    Field {
        /// The field with its place, as `frames[3].fl_x` or `line 5`.
        field: String,
        /// What is accepted.
        expected: String,
        /// What was found.
        actual: String,
    },
    /// A binary file ends early.
    #[error("{field}: expected {expected} more bytes, found {actual} (the file is truncated)")]
    Truncated {
        /// The field being read.
        field: String,
        /// Bytes needed.
        expected: u64,
        /// Bytes left.
        actual: u64,
    },
    /// The camera has a lens of a kind that is not known.
    #[error(
        "{field}: expected a pinhole, radial or fisheye lens, found {model}; run undistortion first \
         (`colmap image_undistorter`) and give the undistorted model"
    )]
    Lens {
        /// The field that states the model.
        field: String,
        /// The model found.
        model: String,
    },
    /// The values do not make a camera.
    #[error("{field}: {source}")]
    Camera {
        /// The camera's place in the file.
        field: String,
        /// The reason.
        source: Box<CameraError>,
    },
}

impl CaptureFault {
    /// This fault in the file or folder `path`.
    #[must_use]
    pub fn at(self, path: &Path) -> CaptureError {
        CaptureError { path: path.to_path_buf(), fault: self }
    }

    pub(super) fn field(field: &str, expected: &str, actual: impl ToString) -> Self {
        Self::Field { field: field.into(), expected: expected.into(), actual: actual.to_string() }
    }

    pub(super) fn camera(field: &str, source: CameraError) -> Self {
        Self::Camera { field: field.into(), source: Box::new(source) }
    }
}
