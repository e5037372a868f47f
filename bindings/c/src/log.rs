//! Messages to the host.
#![allow(unsafe_code, reason = "exported functions, and calls of the host's")]

use std::ffi::{CStr, c_char, c_void};
use std::sync::{Mutex, PoisonError};

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_log_level {
    /// A call failed: the text of gs3_last_error.
    GS3_LOG_ERROR = 0,
    /// What people should be told: the CPU took over from a GPU, a file says something that is not used, Gaussians were
    /// invalid.
    GS3_LOG_WARNING = 1,
    /// What was opened, and what renders.
    GS3_LOG_INFO = 2,
}

/// Takes a message: UTF-8 text of one line, which is valid during the call, and the user pointer that was set. Nothing may
/// be thrown out of it.
pub type gs3_log_callback =
    Option<unsafe extern "C" fn(level: gs3_log_level, message: *const c_char, user: *mut c_void)>;

/// The host's callback and pointer.
#[derive(Clone, Copy)]
struct Sink {
    callback: gs3_log_callback,
    user: *mut c_void,
}

// SAFETY: the pointer is only passed on, and `gs3_set_log_callback` demands that any thread may use it.
unsafe impl Send for Sink {}

static SINK: Mutex<Sink> = Mutex::new(Sink { callback: None, user: std::ptr::null_mut() });

/// Tells the host, if it listens.
pub fn tell(level: gs3_log_level, text: &CStr) {
    // The lock is not held during the call, in which the host may call the library.
    let sink = *SINK.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(callback) = sink.callback {
        // SAFETY: `gs3_set_log_callback` demands a function of this type that takes this pointer.
        unsafe { callback(level, text.as_ptr(), sink.user) };
    }
}

/// Sets what takes the library's messages from now on, all handles' and threads'; NULL for nobody, as at the start.
///
/// Messages come from the thread of the call that they are about, before that call returns. The callback may call the library. A call
/// that runs in another thread may still use the callback that was set before.
///
/// # Safety
/// `callback` may be called by any thread that calls the library, with `user`, until another one is set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_set_log_callback(callback: gs3_log_callback, user: *mut c_void) {
    *SINK.lock().unwrap_or_else(PoisonError::into_inner) = Sink { callback, user };
}
