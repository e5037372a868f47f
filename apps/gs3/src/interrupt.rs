//! Ctrl-C: the frame in work is finished, then the command ends.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use crate::error::CliError;

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C (and a request to terminate) only sets the flag that [`requested`] reads.
pub fn watch() -> Result<(), CliError> {
    Ok(ctrlc::set_handler(|| REQUESTED.store(true, Relaxed))?)
}

/// Whether the command is to end.
pub fn requested() -> bool {
    REQUESTED.load(Relaxed)
}
