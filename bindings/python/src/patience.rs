//! Long work in a thread of its own, while the caller's looks after signals and callbacks.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::error;

/// How often the caller looks: often enough for a bar to move, and for Ctrl-C to feel immediate.
const LOOK: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter's lock. `work` reports the share that is done, 0 to 1, and stops on request.
/// `progress` is called in this thread with the share; if it returns `False`, the work is stopped.
///
/// # Errors
/// The exception of a signal's handler or of the callback; `Cancelled`, if the callback returned `False`.
pub fn run<T: Send>(
    py: Python<'_>,
    what: &str,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&(dyn Fn(f32) + Sync), &AtomicBool) -> T + Send,
) -> PyResult<T> {
    let (stop, is_done) = (AtomicBool::new(false), AtomicBool::new(false));
    // Shares are not negative, so their bits are in order.
    let share = AtomicU32::new(0);
    let tell = |now: f32| {
        share.fetch_max(now.max(0.0).to_bits(), Ordering::Relaxed);
    };
    let look = || -> PyResult<()> {
        py.check_signals()?;
        let Some(progress) = progress else { return Ok(()) };
        let answer = progress.call1((f32::from_bits(share.load(Ordering::Relaxed)),))?;
        if answer.is(PyBool::new(py, false)) { Err(error::cancelled(what)) } else { Ok(()) }
    };
    look()?;
    let result = thread::scope(|scope| {
        let (waiting, tell, stop, is_done) = (thread::current(), &tell, &stop, &is_done);
        let worker = scope.spawn(move || {
            let result = work(tell, stop);
            is_done.store(true, Ordering::Release);
            waiting.unpark();
            result
        });
        let mut looked = Ok(());
        while !is_done.load(Ordering::Acquire) && !worker.is_finished() {
            py.detach(|| thread::park_timeout(LOOK));
            if looked.is_ok() && !is_done.load(Ordering::Acquire) {
                looked = look();
                if looked.is_err() {
                    stop.store(true, Ordering::Relaxed);
                }
            }
        }
        let result = py.detach(|| worker.join());
        looked?;
        result.map_err(|_| PyRuntimeError::new_err(format!("{what}: internal error, please report it")))
    })?;
    share.store(1.0_f32.to_bits(), Ordering::Relaxed);
    look()?;
    Ok(result)
}
