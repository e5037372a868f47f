//! Independent verification of the rasterizer: its images against a naive double-precision evaluation of the same
//! published rules, and properties that every implementation must have.

mod against_oracle;
mod blocks;
mod compare;
mod culling;
mod derivatives;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_blocks;
mod importance;
mod invariances;
mod oracle;
mod real_scenes;
mod robustness;
mod scenes;

/// Every test of kernels, once more on each other SIMD level of this processor.
#[test]
fn all_of_this_on_every_simd_level() {
    gs3_simd::repeat_tests_on_levels(
        "all_of_this_on_every_simd_level",
        &["gpu::", "gpu_blocks::", "real_scenes::"],
    );
}
