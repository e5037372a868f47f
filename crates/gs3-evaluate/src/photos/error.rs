//! What can be wrong with a photo set.

use std::path::PathBuf;

use gs3_files::ReadError;
use gs3_scene::{CameraError, Size};

use crate::methods::MethodSpec;
use crate::protocol::EvaluateError;

/// Why renders were not compared with photos.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotoError {
    /// A camera of the capture names no photo.
    #[error("camera {camera} of the capture: expected the name of its photo, found none")]
    Unnamed {
        /// Index of the camera.
        camera: usize,
    },
    /// A photo is not there.
    #[error(
        "photo '{name}': expected a file of this name, or with .png, .jpg or .jpeg added, in one of {}; found none",
        folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    Missing {
        /// The name in the capture.
        name: String,
        /// Where it was looked for.
        folders: Vec<PathBuf>,
    },
    /// The lens of a photo shows nothing that a pinhole does.
    #[error(
        "photo '{name}': expected a lens that shows the middle of what a pinhole sees, found another distortion"
    )]
    Lens {
        /// The photo.
        name: String,
    },
    /// A photo cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: ReadError,
    },
    /// A file is not an image that can be read.
    #[error("{}: expected a PNG or JPEG image: {message}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        message: String,
    },
    /// A photo is not its camera's image, enlarged or reduced.
    #[error(
        "{}: expected the shape of its camera's image, {expected} pixels or the same at another scale, found {actual}; \
         photos must be uncropped",
        path.display()
    )]
    Shape {
        /// The file.
        path: PathBuf,
        /// Size of the camera's image.
        expected: Size,
        /// Size of the photo.
        actual: Size,
    },
    /// Photos have no frames between them.
    #[error("method '{method}': expected one without interpolation, since nothing lies between photos")]
    Interpolates {
        /// The method.
        method: MethodSpec,
    },
    /// The cameras cannot take the photos' sizes.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The protocol that is shared with rendered ground truth failed.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
}
