//! What can be wrong with a clip.

use std::path::PathBuf;

use gs3_neural::{GraphError, Shape};

use super::ClipWindow;

/// A clip that cannot be read, or holds something else than its network needs.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClipError {
    /// A file cannot be written.
    #[error("{}: cannot be written: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// Nothing more can be read.
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// What is wrong within a file.
    #[error("{}: {source}", path.display())]
    Within {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: Box<ClipError>,
    },
    /// Not a safetensors file, or a damaged one.
    #[error("expected a clip in safetensors, found {message}")]
    Format {
        /// What the reader says.
        message: String,
    },
    /// A field of the header is missing or makes no sense.
    #[error("header, {field}: expected {expected}, found {actual}")]
    Header {
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: String,
        /// What it is.
        actual: String,
    },
    /// An array of a file is missing, or of another type or shape.
    #[error("{name}: expected {expected}, found {actual}")]
    Array {
        /// The array.
        name: String,
        /// Its type and shape.
        expected: String,
        /// What is there.
        actual: String,
    },
    /// No network takes that size.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// No frames.
    #[error("expected at least one frame, found none")]
    Empty,
    /// An input of the network is missing or of another size.
    #[error("frame {frame}, {name}: expected {expected}, found {} numbers, {} channels", actual[1], actual[0])]
    Plane {
        /// The frame.
        frame: usize,
        /// The input.
        name: String,
        /// Its shape.
        expected: Shape,
        /// Channels and numbers; 0 if it is missing.
        actual: [usize; 2],
    },
    /// An input that the network has not.
    #[error("{name}: expected inputs of the network only, without hidden")]
    Unknown {
        /// The input.
        name: String,
    },
    /// The inputs of a frame have another order than the inputs of the first frame.
    #[error("frame {frame}: expected inputs in the order {expected:?}, found {actual:?}")]
    Order {
        /// The frame.
        frame: usize,
        /// Names in the first frame.
        expected: Vec<String>,
        /// Names in this frame.
        actual: Vec<String>,
    },
    /// A target of another size.
    #[error("frame {frame}, target: expected {expected} numbers, found {actual}")]
    Target {
        /// The frame.
        frame: usize,
        /// Numbers of an HR frame.
        expected: usize,
        /// Numbers found.
        actual: usize,
    },
    /// A part that the clip has not.
    #[error("expected a part of {frames} frames of {}×{} LR pixels, found {actual:?}", lr[1], lr[0])]
    Window {
        /// Frames of the clip.
        frames: usize,
        /// Its LR grid, `[height, width]`.
        lr: [usize; 2],
        /// The part asked for.
        actual: ClipWindow,
    },
}
