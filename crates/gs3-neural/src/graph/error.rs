//! What can be wrong with a graph.

use thiserror::Error;

/// A graph that makes no sense, or an image size that it cannot take.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum GraphError {
    /// The inputs of a layer do not fit it, or each other.
    #[error("layer {layer}: expected {expected}, found {actual}")]
    Shape {
        /// The layer's name.
        layer: String,
        /// What the layer needs.
        expected: String,
        /// What its inputs have.
        actual: String,
    },
    /// Two layers have the same name.
    #[error("layer {layer}: expected a name of its own, found it twice")]
    Duplicate {
        /// The name.
        layer: String,
    },
    /// An enlargement for which there is no network.
    #[error("scale: expected 1 to {max}, found {actual}")]
    Scale {
        /// HR pixels per LR pixel along a side.
        actual: usize,
        /// The largest.
        max: usize,
    },
    /// An image size that no tensor can have.
    #[error("image: expected 1 to {max} pixels a side, found {width}×{height}")]
    Size {
        /// Width in LR pixels.
        width: usize,
        /// Height in LR pixels.
        height: usize,
        /// The largest side.
        max: usize,
    },
}
