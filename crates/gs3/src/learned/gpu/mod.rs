//! The networks on a device. Each file has a twin of the same name in `learned`, with the same rules.

mod interpolator;
mod network;
mod super_sampler;

use gs3_compute::GpuError;
use gs3_raster::GpuGBuffer;
use gs3_reconstruct::gpu::GpuPlanes;
pub use interpolator::{GpuLearnedInterpolator, InBetween};
pub use super_sampler::{GpuLearnedSuperSampler, Refined};

/// The mean depth of a frame. Both networks get depths relative to it.
const MEAN_WGSL: &str = include_str!("mean.wgsl");

/// `PARTS` of `mean.wgsl`.
const PARTS: u32 = 64;

/// The planes of a G-buffer that reconstruction reads, if the G-buffer has them.
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
