//! The command `gs3`: render, inspect, convert and measure 3D Gaussian Splatting scenes.

#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "doc comments of arguments are help texts for the terminal; their brackets are no links"
)]
// They panic where the text cannot be written; module `terminal` does not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod alpha;
mod args;
mod backend;
mod bench;
mod bench_gpu;
mod compare;
mod convert;
mod copies;
mod course;
mod destination;
mod devices;
mod error;
mod evaluate;
mod export;
mod gbuffer;
mod info;
mod inputs;
mod interrupt;
mod join;
mod levels;
mod manifest;
mod npz;
mod output;
mod panorama;
mod render;
mod report;
mod simplify;
mod terminal;
mod train;
mod train_clips;
mod unused;
mod usage;
mod values;
mod video;
#[cfg(feature = "view")]
mod view;

use std::process::ExitCode;

use gs3_train::Network;

use args::{Command, Train};
use error::CliError;
use terminal::note;

/// Exit code for bad input, also clap's: the same command fails again.
const BAD_INPUT: u8 = 2;

/// Exit code where the machine failed, not the input: the same command may succeed later or elsewhere. `EX_TEMPFAIL` of
/// sysexits.h, on which schedulers retry.
const MAY_PASS: u8 = 75;

/// Exit code after Ctrl-C: 128 + SIGINT, as shells expect.
const INTERRUPTED: u8 = 130;

/// How a command ended that met no error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Done,
    Interrupted,
}

fn main() -> ExitCode {
    let (args, given) = match usage::parse() {
        Ok(parsed) => parsed,
        Err(error) => match usage::complaint(&error) {
            Some(line) => {
                note(line);
                return BAD_INPUT.into();
            }
            None => error.exit(),
        },
    };
    interrupt::end_whole();
    let outcome = unused::check(&args.command, &given).and_then(|()| {
        gs3::simd::requested()?;
        run(&args.command)
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

fn run(command: &Command) -> Result<Outcome, CliError> {
    match command {
        Command::Render(args) => render::run(args),
        Command::Join(args) => join::run(args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(args),
        Command::Gbuffer(args) => gbuffer::run(args),
        Command::Info(args) => info::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Simplify(args) => simplify::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Train(Train::Clips(args)) => train_clips::run(args),
        Command::Train(Train::SuperSample(args)) => train::run(Network::SuperSample, args),
        Command::Train(Train::Interpolate(args)) => train::run(Network::Interpolate, args),
        Command::Train(Train::Baseline(args)) => train::run_baseline(args),
        Command::Export(args) => export::run(args),
    }
}

/// Starts the pool that all work runs on.
fn start_threads(threads: Option<u16>) -> Result<(), CliError> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.into())
        .build_global()
        .map_err(|e| CliError::Threads { message: e.to_string() })
}
