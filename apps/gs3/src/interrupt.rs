//! Ctrl-C, or a request to terminate. A command that watches for it finishes the frame in work and ends; any other ends at
//! once. Both leave whole files only.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use gs3::scene::format::discard_temporaries;

use crate::INTERRUPTED;
use crate::error::CliError;

static HANDLED: AtomicBool = AtomicBool::new(false);
static WATCHED: AtomicBool = AtomicBool::new(false);
static REQUESTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C ends the command at once, without the files in work.
pub fn end_whole() {
    // Refused where whoever started the command has it ignore such requests, as `nohup` does: so be it.
    HANDLED.store(ctrlc::try_set_handler(on_request).is_ok(), Relaxed);
}

/// From now on Ctrl-C only sets the flag that [`requested`] reads.
pub fn watch() -> Result<(), CliError> {
    WATCHED.store(true, Relaxed);
    if !HANDLED.load(Relaxed) {
        ctrlc::set_handler(on_request)?;
    }
    Ok(())
}

/// Whether the command is to end.
pub fn requested() -> bool {
    REQUESTED.load(Relaxed)
}

fn on_request() {
    if WATCHED.load(Relaxed) {
        REQUESTED.store(true, Relaxed);
    } else {
        discard_temporaries();
        std::process::exit(INTERRUPTED.into());
    }
}
