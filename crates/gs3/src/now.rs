//! Calls that wait for a frame.

#[cfg(feature = "gpu")]
pub use gs3_compute::now;

#[cfg(not(feature = "gpu"))]
use crate::error::PipelineError;

/// The result of the future of a frame, which is ready: the CPU waits for nothing.
#[cfg(not(feature = "gpu"))]
pub fn now<T>(future: impl Future<Output = Result<T, PipelineError>>) -> Result<T, PipelineError> {
    pollster::block_on(future)
}
