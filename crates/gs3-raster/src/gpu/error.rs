//! Errors of rasterization on a GPU.

use gs3_compute::GpuError;

use crate::settings::RasterError;

/// Why a frame was not rasterized on a GPU.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuRasterError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] RasterError),
    /// The device refuses, is lost, or has too little memory.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}
