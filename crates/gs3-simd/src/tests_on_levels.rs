//! Tests of kernels, once more on every other level.

use std::env;
use std::process::{Command, Stdio};

use crate::{VARIABLE, level, levels, name};

/// Runs the calling test binary once more for every other level of this CPU, without the test `this` and without
/// tests with one of `skipped` in their names. Does nothing if [`VARIABLE`] already asks for a level, so that
/// binaries started here start no others.
///
/// # Panics
/// If the binary cannot be started, or a test fails on a level: with the level's name and the tests' output.
pub fn repeat_tests_on_levels(this: &str, skipped: &[&str]) {
    if env::var_os(VARIABLE).is_some_and(|value| !value.is_empty()) {
        return;
    }
    let binary = env::current_exe().unwrap_or_else(|error| panic!("the test binary is unknown: {error}"));
    let others = levels().into_iter().map(|(name, _)| name).filter(|other| *other != name(level()));
    for other in others {
        let mut command = Command::new(&binary);
        command.env(VARIABLE, other).stdin(Stdio::null()).args(["--skip", this]);
        for name in skipped {
            command.args(["--skip", name]);
        }
        let output = command.output().unwrap_or_else(|error| panic!("{}: {error}", binary.display()));
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && !text.contains("running 0 tests"),
            "{VARIABLE}={other}: {text}{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}
