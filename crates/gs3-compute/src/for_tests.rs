//! The device of a test that needs one.

use std::fmt::Display;

use crate::error::GpuError;
use crate::gpu::{Gpu, GpuSettings};

/// Set to anything but `0`, a test without a device fails instead of being skipped.
const REQUIRED: &str = "GS3_REQUIRE_GPU";

/// The device of this machine, or a word that the test is skipped for want of one.
///
/// # Panics
/// If there is an adapter that does not open, or none and `GS3_REQUIRE_GPU=1` asks for one.
#[must_use]
pub fn device_for_tests(settings: &GpuSettings) -> Option<Gpu> {
    match Gpu::new(settings) {
        Ok(gpu) => Some(gpu),
        Err(error @ GpuError::NoAdapter { .. }) => {
            skip_without_gpu(error);
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Says that a test is skipped because there is no adapter. `why` is the error that says so.
///
/// # Panics
/// If `GS3_REQUIRE_GPU=1` asks for an adapter.
pub fn skip_without_gpu(why: impl Display) {
    let required = std::env::var_os(REQUIRED).is_some_and(|value| !value.is_empty() && value != "0");
    assert!(!required, "{REQUIRED}: expected an adapter, found none: {why}");
    eprintln!("skipped: no adapter: {why}");
}
