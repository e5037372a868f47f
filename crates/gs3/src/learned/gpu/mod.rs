//! The networks on a device, file by file the twins of those of `learned`, whose rules they have.

mod interpolator;
mod network;
mod super_sampler;

use gs3_compute::GpuError;
use gs3_raster::GpuGBuffer;
use gs3_reconstruct::gpu::GpuPlanes;
pub use interpolator::{GpuLearnedInterpolator, InBetween};
pub use super_sampler::{GpuLearnedSuperSampler, Refined};

/// The mean depth, which both networks are told depths by.
const MEAN_WGSL: &str = include_str!("mean.wgsl");

/// `PARTS` of `mean.wgsl`.
const PARTS: u32 = 64;

/// The planes that reconstruction reads of a G-buffer that has them.
pub fn planes(gbuffer: &GpuGBuffer) -> Result<GpuPlanes<'_>, GpuError> {
    let missing = || GpuError::Bindings {
        kernel: "reconstruction".to_owned(),
        expected: "a G-buffer with gradients and geometry".to_owned(),
        actual: "one without".to_owned(),
    };
    Ok(GpuPlanes {
        color_alpha: gbuffer.color_alpha().ok_or_else(missing)?,
        dx_median: gbuffer.dx_median().ok_or_else(missing)?,
        dy_expected: gbuffer.dy_expected().ok_or_else(missing)?,
    })
}
