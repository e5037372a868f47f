//! Super sampling and interpolation against analytic worlds. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod common;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_select;
mod interpolate;
mod motion;
mod moving;
mod reconstructor;
mod refine;
mod super_sample;
mod textures;
mod upsample;
mod world;

/// The kernels' tests. Those of whole frames are made of the same kernels.
#[test]
fn all_of_this_on_every_simd_level() {
    let others = ["gpu::", "gpu_select::", "moving::", "reconstructor::", "textures::"];
    gs3_simd::repeat_tests_on_levels("all_of_this_on_every_simd_level", &others);
}
