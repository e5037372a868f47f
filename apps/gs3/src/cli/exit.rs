//! How the process ends.

/// Exit code for bad input, also clap's: the same command fails again.
pub const BAD_INPUT: u8 = 2;

/// Exit code where the machine failed, not the input: the same command may succeed later or elsewhere. `EX_TEMPFAIL` of
/// sysexits.h, on which schedulers retry.
pub const MAY_PASS: u8 = 75;

/// Exit code after Ctrl-C: 128 + SIGINT, as shells expect.
pub const INTERRUPTED: u8 = 130;

/// How a command ended that met no error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Done,
    Interrupted,
}
