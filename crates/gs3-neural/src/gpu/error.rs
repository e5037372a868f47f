//! What can go wrong with a network on a GPU.

use gs3_compute::GpuError;
use thiserror::Error;

use crate::error::{RunError, WeightError};
use crate::graph::GraphError;

/// A network that a GPU cannot run, or images that do not fit it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GpuRunError {
    /// The network, its weights or its images do not fit each other.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// An operation that only other engines have.
    #[error("layer {layer}: expected an operation that GPUs have here, found {actual}")]
    Operation {
        /// The layer's name.
        layer: String,
        /// Its operation.
        actual: String,
    },
    /// An image's buffer is too short.
    #[error("image {name}: expected {expected} bytes, found {actual}")]
    Bytes {
        /// The image.
        name: String,
        /// Bytes of the image in its format.
        expected: u64,
        /// Bytes given.
        actual: u64,
    },
    /// Products of matrices that are not what invocations give by themselves.
    #[error("products of matrices: expected results within {max} of plain ones, found {actual}")]
    Matrices {
        /// How far they may be apart.
        max: f32,
        /// How far they are at most.
        actual: f32,
    },
}

impl From<GraphError> for GpuRunError {
    fn from(error: GraphError) -> Self {
        Self::Run(error.into())
    }
}

impl From<WeightError> for GpuRunError {
    fn from(error: WeightError) -> Self {
        Self::Run(error.into())
    }
}
