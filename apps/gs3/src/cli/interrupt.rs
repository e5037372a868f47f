//! Ctrl-C, or a request to terminate. A command that watches for it finishes the frame in work and ends; any other ends
//! at once, and so does one that waits for another program when it is asked twice. All leave whole files only.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

use gs3_files::discard_temporaries;

use super::error::CliError;
use super::exit::INTERRUPTED;
use super::terminal::note;

static HANDLED: AtomicBool = AtomicBool::new(false);
static WATCHED: AtomicBool = AtomicBool::new(false);
static REQUESTED: AtomicBool = AtomicBool::new(false);

/// What a command does last that is ended by a second request.
type LastAct = Box<dyn Fn() + Send>;

static LAST_ACT: Mutex<Option<LastAct>> = Mutex::new(None);

/// From now on Ctrl-C ends the command at once, without the files in work.
pub fn end_whole() {
    // Refused if the process that started the command made it ignore such requests, as `nohup` does: this is
    // accepted.
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

/// From now on a second request does `last` and ends the command at once, without the files in work: for as long as it
/// may wait for another program that is stuck. With none, second requests are as good as the first.
pub fn on_second_request(last: Option<LastAct>) {
    *last_act() = last;
}

fn last_act() -> MutexGuard<'static, Option<LastAct>> {
    LAST_ACT.lock().unwrap_or_else(PoisonError::into_inner)
}

fn on_request() {
    if !WATCHED.load(Relaxed) {
        end_at_once();
    }
    let is_second = REQUESTED.swap(true, Relaxed);
    if is_second && let Some(last) = &*last_act() {
        last();
        note("interrupted at once; all files are whole");
        end_at_once();
    }
}

fn end_at_once() -> ! {
    discard_temporaries();
    std::process::exit(INTERRUPTED.into());
}
