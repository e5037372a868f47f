//! Errors of reconstruction on a GPU.

use gs3_compute::GpuError;

use crate::error::ReconstructError;

/// Why a frame was not reconstructed on a GPU. The history stays unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuReconstructError {
    /// An input does not fit the output.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The device refuses, is lost, or has too little memory.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A binding belongs to another object.
pub(super) fn other_bound(kernel: &str) -> GpuReconstructError {
    let [expected, actual] = ["that records them", "of another"].map(str::to_owned);
    GpuError::Bindings { kernel: kernel.to_owned(), expected, actual }.into()
}
