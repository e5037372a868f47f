//! Errors of the library as exceptions of the package (`python/gs3/_errors.py`).

use std::fmt::Display;

use gs3::scene::format::{LoadError, SaveError};
use gs3::{NetworkError, PipelineError};
use pyo3::prelude::*;

/// Which exception an error is.
#[derive(Clone, Copy)]
enum Kind {
    /// A value that is not accepted.
    Input,
    /// A file that cannot be read or written.
    File,
    /// A device that fails.
    Device,
    /// A callback said no.
    Cancelled,
}

impl Kind {
    const fn class(self) -> &'static str {
        match self {
            Self::Input => "InputError",
            Self::File => "FileError",
            Self::Device => "DeviceError",
            Self::Cancelled => "Cancelled",
        }
    }
}

fn exception(kind: Kind, message: impl Display) -> PyErr {
    let message = message.to_string();
    Python::attach(|py| {
        let made = py
            .import("gs3._errors")
            .and_then(|errors| errors.getattr(kind.class()))
            .and_then(|class| class.call1((message,)));
        match made {
            Ok(exception) => PyErr::from_value(exception),
            Err(error) => error,
        }
    })
}

/// A value that is not accepted.
pub fn input(message: impl Display) -> PyErr {
    exception(Kind::Input, message)
}

/// What a callback stopped.
pub fn cancelled(what: impl Display) -> PyErr {
    exception(Kind::Cancelled, format_args!("{what}: stopped, as the callback returned False"))
}

/// A file that cannot be read or written.
pub fn file(error: impl Display) -> PyErr {
    exception(Kind::File, error)
}

pub fn of_load(error: &LoadError) -> PyErr {
    let kind = if matches!(error, LoadError::Io { .. }) { Kind::File } else { Kind::Input };
    exception(kind, error)
}

pub fn of_save(error: &SaveError) -> PyErr {
    let kind = if matches!(error, SaveError::Io { .. }) { Kind::File } else { Kind::Input };
    exception(kind, error)
}

pub fn of_pipeline(error: &PipelineError) -> PyErr {
    let kind = match error {
        #[cfg(feature = "gpu")]
        PipelineError::Gpu(_) => Kind::Device,
        PipelineError::NotOnDevice | PipelineError::Internal { .. } => Kind::Device,
        _ => Kind::Input,
    };
    exception(kind, error)
}

pub fn of_network(error: &NetworkError) -> PyErr {
    exception(Kind::Input, error)
}
