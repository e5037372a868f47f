//! The networks on a device. Each file has a twin of the same name in `learned`, with the same rules.

mod interpolator;
mod network;
mod super_sampler;

use gs3_compute::{GpuError, constants};
use gs3_raster::GpuGBuffer;
use gs3_reconstruct::gpu::GpuPlanes;
pub use interpolator::{GpuLearnedInterpolator, InBetween};
pub use super_sampler::{GpuLearnedSuperSampler, Refined};

/// Workgroups that sum depths.
const PARTS: u32 = 64;

/// Invocations of a workgroup of kernels that sum depths or read the sum: a power of two, which a sum is halved to.
const THREADS: u32 = 256;
const _: () = assert!(THREADS.is_power_of_two() && PARTS <= THREADS);

/// The mean depth of a frame. Both networks get depths relative to it.
fn mean_source() -> String {
    constants(&[("PARTS", PARTS), ("THREADS", THREADS)]) + include_str!("mean.wgsl")
}

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

#[cfg(test)]
mod tests {
    #[test]
    fn numbers_of_the_shaders_are_explained() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/learned/gpu");
        assert_eq!(gs3_test_support::check_literals(folder), 3);
    }
}
