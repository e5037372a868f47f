//! What can be wrong with weights, and with images for a network.

use std::path::PathBuf;

use thiserror::Error;

use crate::graph::{GraphError, Shape};

/// Weights that cannot be read, or do not fit a graph.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WeightError {
    /// A file cannot be read or written.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// Not a safetensors file.
    #[error("expected safetensors, found {message}")]
    Format {
        /// What the reader says.
        message: String,
    },
    /// A field of the header is missing or belongs to another network.
    #[error("header, {field}: expected {expected}, found {actual}")]
    Header {
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: String,
        /// What it is.
        actual: String,
    },
    /// An array is missing.
    #[error("{name}: expected f32 {expected:?}, found none")]
    Missing {
        /// The array.
        name: String,
        /// Its shape.
        expected: Vec<usize>,
    },
    /// An array has another shape or type.
    #[error("{name}: expected f32 {expected:?}, found {actual}")]
    Shape {
        /// The array.
        name: String,
        /// The shape it should have.
        expected: Vec<usize>,
        /// Shape or type found.
        actual: String,
    },
    /// A weight is infinite or not a number.
    #[error("{name}: expected finite numbers, found {value}")]
    NotFinite {
        /// The array.
        name: String,
        /// The number.
        value: f32,
    },
    /// An array that no layer has.
    #[error("{name}: expected arrays of the network's layers only")]
    Unknown {
        /// The array.
        name: String,
    },
}

/// An engine that cannot be made, or images that do not fit it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// The network cannot take an image size.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The weights are not the network's.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// An image that the network has not.
    #[error("image {name}: expected one of {expected}")]
    Unknown {
        /// The image.
        name: String,
        /// The network's.
        expected: String,
    },
    /// An image that the network needs was not given.
    #[error("image {name}: expected {expected}, found none")]
    Missing {
        /// The image.
        name: String,
        /// Its shape.
        expected: Shape,
    },
    /// An image of another size.
    #[error("image {name}: expected {expected} numbers ({shape}), found {actual}")]
    Length {
        /// The image.
        name: String,
        /// Its shape.
        shape: Shape,
        /// Numbers in that shape.
        expected: usize,
        /// Numbers given.
        actual: usize,
    },
    /// Memory of another plan, or without what it should hold.
    #[error("{name}: expected {expected}, found {actual}")]
    Memory {
        /// Which memory.
        name: &'static str,
        /// What it should be or hold.
        expected: &'static str,
        /// What it is or holds.
        actual: &'static str,
    },
}
