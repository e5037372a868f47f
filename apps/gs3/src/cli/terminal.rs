//! The command's output. The macros of the standard library panic if the reader of a pipe has left or a disk is full.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write};

use super::error::CliError;

/// Prints `text`, the command's result, as it is.
pub fn print(text: impl Display) -> Result<(), CliError> {
    let text = text.to_string();
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        // The reader has seen enough; this is no error.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        printed => printed.map_err(CliError::Print),
    }
}

/// Says `text` beside the result, on a line of its own.
pub fn note(text: impl Display) {
    // Where this cannot be said, nothing can.
    let _ = io::stderr().write_all(format!("{text}\n").as_bytes());
}
