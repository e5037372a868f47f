//! What can go wrong.

use gs3_compute::GpuError;

use crate::error::ReconstructError;

/// Why a frame was not reconstructed on a GPU. The history is as before.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuReconstructError {
    /// An input is not what the output demands.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The device refused, is lost, or has no room.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// What is recorded was bound by another.
pub(super) fn other_bound(kernel: &str) -> GpuReconstructError {
    let [expected, actual] = ["that records them", "of another"].map(str::to_owned);
    GpuError::Bindings { kernel: kernel.to_owned(), expected, actual }.into()
}
