//! Refuses options that were given and would not be read: a user expects every given option to count.

use gs3::{Dilation, Mode, Refine};

use super::Command;
use super::bench::{BenchArgs, BenchBackendArg};
use super::evaluate::{EvaluateArgs, ProtocolArg};
use super::gbuffer::GbufferArgs;
use super::render::RenderArgs;
use super::simplify::{ByArg, SimplifyArgs};
use crate::cli::error::CliError;
use crate::cli::options::{FrameOptions, TierArg};
use crate::cli::usage::{Given, alternatives};

/// Modes with a low-resolution frame.
const LOW: &[Mode] = &[Mode::Bicubic, Mode::SuperSample, Mode::Full];

/// Modes that super-sample.
const SUPER_SAMPLED: &[Mode] = &[Mode::SuperSample, Mode::Full];

/// Which modes read an option of `gs3 render`, of those that not all do.
const READ_BY: [(&str, &[Mode]); 14] = [
    ("--quality", SUPER_SAMPLED),
    ("--refine", SUPER_SAMPLED),
    ("--scale", LOW),
    ("--jitter", LOW),
    ("--tier", SUPER_SAMPLED),
    ("--weights", SUPER_SAMPLED),
    ("--arithmetic", SUPER_SAMPLED),
    ("--matrix-products", SUPER_SAMPLED),
    ("--kriging", SUPER_SAMPLED),
    ("--overscan", SUPER_SAMPLED),
    ("--keyframes", LOW),
    ("--warm-up", LOW),
    ("--interpolation", &[Mode::Full]),
    ("--in-between", &[Mode::Full]),
];

/// Checks the options of `command` that were given.
pub fn check(command: &Command, given: &Given) -> Result<(), CliError> {
    match command {
        Command::Render(args) => render(args, given),
        Command::Bench(args) => bench(args, given),
        Command::Simplify(args) => simplify(args, given),
        Command::Gbuffer(args) => gbuffer(args, given),
        Command::Evaluate(args) => evaluate(args, given),
        _ => Ok(()),
    }
}

fn render(args: &RenderArgs, given: &Given) -> Result<(), CliError> {
    let mode = Mode::from(args.mode);
    // That no network runs is true of every mode.
    let is_true = |option| option == "--tier" && args.frame_options.tier == TierArg::Analytic;
    for (option, modes) in READ_BY {
        if !modes.contains(&mode) && !is_true(option) {
            let names: Vec<_> = modes.iter().map(|mode| mode.name()).collect();
            let expected = format!("--mode {}", alternatives(&names));
            refuse(given, option, &expected, &format!("--mode {}", mode.name()))?;
        }
    }
    look(&args.frame_options, given)
}

fn look(args: &FrameOptions, given: &Given) -> Result<(), CliError> {
    match args.refine {
        Refine::Auto => Ok(()),
        other => refuse(given, "--quality", "--refine auto", &format!("--refine {other}")),
    }
}

fn bench(args: &BenchArgs, given: &Given) -> Result<(), CliError> {
    look(&args.frame_options, given)?;
    match args.backend {
        BenchBackendArg::Cpu => refuse(given, "--warm-up", "--backend gpu", "--backend cpu"),
        BenchBackendArg::Gpu => refuse(given, "--stages", "--backend cpu", "--backend gpu"),
    }
}

fn simplify(args: &SimplifyArgs, given: &Given) -> Result<(), CliError> {
    match args.by {
        ByArg::MiniSplatting => Ok(()),
        ByArg::SpeedySplat => ["--indoor", "--outdoor", "--mass", "--seed"]
            .into_iter()
            .try_for_each(|option| refuse(given, option, "--by mini-splatting", "--by speedy-splat")),
    }
}

fn gbuffer(args: &GbufferArgs, given: &Given) -> Result<(), CliError> {
    let dilation = match args.dilation.0 {
        Dilation::Matched => return Ok(()),
        Dilation::Kerbl => "kerbl".to_owned(),
        Dilation::Value(value) => value.to_string(),
    };
    refuse(given, "--scale", "--dilation matched", &format!("--dilation {dilation}"))
}

fn evaluate(args: &EvaluateArgs, given: &Given) -> Result<(), CliError> {
    match args.protocol {
        ProtocolArg::Methods => Ok(()),
        // It tries them all.
        ProtocolArg::Paper => refuse(given, "--culling", "--protocol methods", "--protocol paper"),
    }
}

/// Says that `option` was expected with something else than what it came with, if it was given.
fn refuse(given: &Given, option: &'static str, expected: &str, actual: &str) -> Result<(), CliError> {
    match given.has(option) {
        true => Err(CliError::Option { option, expected: expected.to_owned(), actual: actual.to_owned() }),
        false => Ok(()),
    }
}
