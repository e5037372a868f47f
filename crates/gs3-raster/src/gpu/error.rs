//! What can go wrong.

use gs3_compute::GpuError;

use crate::settings::RasterError;

/// Why a frame was not rasterized on a GPU.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuRasterError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] RasterError),
    /// The device refused, is lost, or has no room.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}
