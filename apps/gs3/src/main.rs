//! The command `gs3`: render, inspect, convert and measure 3D Gaussian Splatting scenes.

#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "doc comments of arguments are help texts for the terminal; their brackets are no links"
)]
// They panic where the text cannot be written; module `terminal` does not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cli;
mod commands;
mod io;

use std::process::ExitCode;

use cli::exit::{BAD_INPUT, INTERRUPTED, MAY_PASS, Outcome};
use cli::terminal::note;
use cli::{interrupt, memory, usage};
use commands::{Args, Command, unused};

fn main() -> ExitCode {
    let (args, given) = match usage::parse::<Args>() {
        Ok(parsed) => parsed,
        Err(error) => match usage::complaint(&error) {
            Some(line) => {
                note(line);
                return BAD_INPUT.into();
            }
            None => error.exit(),
        },
    };
    #[cfg(feature = "view")]
    if matches!(args.command, Command::View(_)) {
        #[allow(unsafe_code, reason = "the viewer's memory is chosen before threads start")]
        // SAFETY: the first thread besides this one is that which waits for Ctrl-C, below.
        unsafe {
            gs3_viewer::use_one_arena();
        }
    }
    if matches!(args.command, Command::Convert(_)) {
        #[allow(unsafe_code, reason = "memory is chosen before threads start")]
        // SAFETY: the first thread besides this one is that which waits for Ctrl-C, below.
        unsafe {
            memory::give_back_at_once();
        }
    }
    interrupt::end_whole();
    let outcome = unused::check(&args.command, &given).and_then(|()| {
        gs3::simd::requested()?;
        commands::run(&args.command)
    });
    match outcome {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => INTERRUPTED.into(),
        Err(error) => {
            note(format_args!("error: {}", error.one_line()));
            if error.may_pass() { MAY_PASS.into() } else { BAD_INPUT.into() }
        }
    }
}
