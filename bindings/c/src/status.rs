//! What calls tell: a status, and in words what was expected and found.
#![allow(unsafe_code, reason = "exported functions")]

use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};

use gs3::PipelineError;
use gs3::reconstruct::ReconstructError;
use gs3::scene::format::LoadError;
use gs3::scene::{CameraError, SceneError};

use crate::log::{self, gs3_log_level};

/// What a call tells. Values stay what they are in all versions; new ones may be added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_status {
    /// The call did what it says.
    GS3_OK = 0,
    /// A fault of the library. The handle that was passed is of no more use but to be destroyed.
    GS3_ERROR_INTERNAL = -1,
    /// A pointer is null, a number out of its range, or two arguments do not go together.
    GS3_ERROR_ARGUMENT = -2,
    /// A descriptor's struct_size is too small, or the descriptor is larger than this version knows and its tail is not
    /// zero.
    GS3_ERROR_DESCRIPTOR = -3,
    /// Memory of the caller is too small for the image that is said to lie there, or its strides do not fit.
    GS3_ERROR_LAYOUT = -4,
    /// A scene file cannot be read, or has no scene.
    GS3_ERROR_FILE = -5,
    /// Arrays make no scene.
    GS3_ERROR_SCENE = -6,
    /// This version of the library, or this handle, does not offer that.
    GS3_ERROR_UNSUPPORTED = -7,
    /// A GPU cannot be opened, has no room, fails or is lost.
    GS3_ERROR_DEVICE = -8,
    /// A call with the same handle runs, in another thread.
    GS3_ERROR_BUSY = -9,
}

use gs3_status::{
    GS3_ERROR_ARGUMENT, GS3_ERROR_DEVICE, GS3_ERROR_FILE, GS3_ERROR_INTERNAL, GS3_ERROR_LAYOUT,
    GS3_ERROR_SCENE, GS3_OK,
};

/// Why a call failed.
#[derive(Clone, Debug)]
pub struct Fault {
    pub status: gs3_status,
    pub text: String,
}

impl Fault {
    pub fn new(status: gs3_status, text: impl fmt::Display) -> Self {
        Self { status, text: text.to_string() }
    }

    /// `field` is not what it is to be.
    pub fn argument(field: &str, expected: impl fmt::Display, actual: impl fmt::Display) -> Self {
        Self::new(GS3_ERROR_ARGUMENT, format_args!("{field}: expected {expected}, found {actual}"))
    }

    /// The pointer `field` is null.
    pub fn null(field: &str) -> Self {
        Self::argument(field, "a pointer", "null")
    }

    /// The same fault of what `field` points to.
    pub fn within(self, field: &str) -> Self {
        Self { text: format!("{field}: {}", self.text), ..self }
    }
}

impl From<LoadError> for Fault {
    fn from(error: LoadError) -> Self {
        Self::new(GS3_ERROR_FILE, error)
    }
}

impl From<SceneError> for Fault {
    fn from(error: SceneError) -> Self {
        Self::new(GS3_ERROR_SCENE, error)
    }
}

impl From<CameraError> for Fault {
    fn from(error: CameraError) -> Self {
        Self::new(GS3_ERROR_ARGUMENT, error)
    }
}

impl From<ReconstructError> for Fault {
    fn from(error: ReconstructError) -> Self {
        let status = match &error {
            ReconstructError::TooShort { .. } => GS3_ERROR_LAYOUT,
            _ => GS3_ERROR_ARGUMENT,
        };
        Self::new(status, error)
    }
}

impl From<PipelineError> for Fault {
    fn from(error: PipelineError) -> Self {
        match error {
            PipelineError::Reconstruct(error) => error.into(),
            PipelineError::Gpu(error) => Self::new(GS3_ERROR_DEVICE, error),
            PipelineError::Internal { .. } => Self::new(GS3_ERROR_INTERNAL, error),
            error => Self::new(GS3_ERROR_ARGUMENT, error),
        }
    }
}

thread_local! {
    /// The text of the thread's last failed call.
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Text for C. Zeros inside, which no message of the library has, become question marks.
pub fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', "?")).unwrap_or_default()
}

/// Runs the body of the exported function `name`: faults and panics become a status and a text.
pub fn guard(name: &str, call: impl FnOnce() -> Result<(), Fault>) -> gs3_status {
    let fault = match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(())) => return GS3_OK,
        Ok(Err(fault)) => fault,
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
            Fault::new(GS3_ERROR_INTERNAL, format_args!("internal error: {text}; please report it"))
        }
    };
    let text = c_text(&format!("{name}: {}", fault.text));
    log::tell(gs3_log_level::GS3_LOG_ERROR, &text);
    LAST_ERROR.with_borrow_mut(|last| *last = text);
    fault.status
}

/// The text of this thread's last call that failed, in UTF-8: function, field, what was expected and what was found. Empty
/// before the first. The memory is the library's, and stays until the next call of this thread fails.
#[unsafe(no_mangle)]
pub extern "C" fn gs3_last_error() -> *const c_char {
    LAST_ERROR.with_borrow(|last| last.as_ptr())
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use super::*;

    #[test]
    fn panics_become_a_status_and_a_text() {
        let status = guard("gs3_nothing", || panic!("a wall fell"));
        assert_eq!(status, GS3_ERROR_INTERNAL);
        // SAFETY: a text of the library, which no call of this thread replaces meanwhile.
        let text = unsafe { CStr::from_ptr(gs3_last_error()) }.to_str().unwrap();
        assert_eq!(text, "gs3_nothing: internal error: a wall fell; please report it");
        assert_eq!(guard("gs3_nothing", || Ok(())), GS3_OK);
    }

    #[test]
    fn texts_end_where_they_end() {
        assert_eq!(c_text("a\0b").as_bytes(), b"a?b");
    }
}
