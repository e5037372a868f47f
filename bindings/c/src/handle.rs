//! What handles have in common: threads, and one call at a time.
#![allow(unsafe_code, reason = "pointers that the library gave")]

use std::sync::{Mutex, TryLockError};

use crate::memory::gs3_memory;
use crate::status::Fault;
use crate::status::gs3_status::{GS3_ERROR_BUSY, GS3_ERROR_INTERNAL};
use crate::workers::Workers;

/// A part of the library behind a handle.
#[derive(Debug)]
pub struct Handle<T> {
    /// First, so that it is dropped while the workers are there. None once it is being dropped.
    state: Mutex<Option<T>>,
    workers: Workers,
}

impl<T: Send> Handle<T> {
    /// What `make` makes, on `threads` threads of its own (0 for as many as the machine runs at once).
    pub fn new<E: Send + Into<Fault>>(
        threads: u32,
        make: impl FnOnce() -> Result<T, E> + Send,
    ) -> Result<Self, Fault> {
        let workers = Workers::new(threads)?;
        let state = workers.try_run(make)?;
        Ok(Self { state: Mutex::new(Some(state)), workers })
    }

    /// Runs `call` on the handle's threads.
    pub fn call<R: Send, E: Send + Into<Fault>>(
        &self,
        call: impl FnOnce(&mut T) -> Result<R, E> + Send,
    ) -> Result<R, Fault> {
        let broken = || {
            let text =
                "handle: expected one with calls that ended, found one after an internal error; destroy it";
            Fault::new(GS3_ERROR_INTERNAL, text)
        };
        let mut guard = self.state.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => {
                Fault::new(GS3_ERROR_BUSY, "handle: expected no call with it that runs, found one")
            }
            TryLockError::Poisoned(_) => broken(),
        })?;
        let state = guard.as_mut().ok_or_else(broken)?;
        self.workers.try_run(|| call(state))
    }

    /// The memory of the handle; `device_bytes` of it are a device's.
    pub fn memory(&self, device_bytes: u64) -> gs3_memory {
        gs3_memory::new(self.workers.bytes(), device_bytes)
    }
}

impl<T> Drop for Handle<T> {
    fn drop(&mut self) {
        // On the account that it was allocated on. After an internal error it is dropped all the same.
        let state = match self.state.get_mut() {
            Ok(state) => state.take(),
            Err(poisoned) => poisoned.into_inner().take(),
        };
        let _work = self.workers.enter();
        drop(state);
    }
}

/// What the handle at `from` is, which the caller calls `field`.
///
/// # Safety
/// `from` is null or a handle that was created and not destroyed, and stays until the end of the call.
pub unsafe fn read<'a, T>(field: &str, from: *const T) -> Result<&'a T, Fault> {
    // SAFETY: the contract of this function.
    unsafe { from.as_ref() }.ok_or_else(|| Fault::null(field))
}

/// Destroys the handle at `from`; null is none.
///
/// # Safety
/// `from` is null or a handle that [`Box::into_raw`] gave, and nobody uses it any more.
pub unsafe fn destroy<T>(from: *mut T) {
    if !from.is_null() {
        // SAFETY: the contract of this function.
        drop(unsafe { Box::from_raw(from) });
    }
}
