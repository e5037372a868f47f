//! The threads that all work runs on.

use super::error::CliError;

/// Starts the pool that all work runs on.
pub fn start_threads(threads: Option<u16>) -> Result<(), CliError> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.into())
        .build_global()
        .map_err(|e| CliError::Threads { message: e.to_string() })
}
