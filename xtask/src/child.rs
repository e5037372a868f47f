//! A program that is run to its end, or to the end of its time.

use std::io::{self, Read, Seek};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Between looks at whether a program has ended: too rare to disturb what it measures, too short to add to minutes.
const PAUSE: Duration = Duration::from_millis(20);

/// What a killed program has to end. One that waits for a driver forever cannot be killed; it is left behind then.
const GRACE: Duration = Duration::from_secs(5);

/// How a program ended, and what it said.
#[derive(Debug)]
pub struct Ended {
    /// None: its time was over, and it was killed.
    pub status: Option<ExitStatus>,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

/// Runs `command` for `limit` at most.
pub fn run(command: &mut Command, limit: Duration) -> io::Result<Ended> {
    // Files, because a full pipe without a reader would stop the program.
    let [stdout, stderr] = [tempfile::tempfile()?, tempfile::tempfile()?];
    command.stdin(Stdio::null()).stdout(stdout.try_clone()?).stderr(stderr.try_clone()?);
    let mut child = command.spawn()?;
    let status = ended(&mut child, limit)?;
    if status.is_none() {
        child.kill()?;
        ended(&mut child, GRACE)?;
    }
    Ok(Ended { status, stdout: text(stdout)?, stderr: text(stderr)? })
}

/// The line of what a failed program said that tells most: its last error or panic, else the last of all.
pub fn reason(stderr: &str) -> String {
    let lines: Vec<&str> = stderr.lines().filter(|line| !line.trim().is_empty()).collect();
    // Newer Rust says the thread's number between both.
    let panics = |line: &str| line.starts_with("thread '") && line.contains(" panicked at ");
    match lines.iter().rposition(|line| line.starts_with("error:") || panics(line)) {
        // A panic's line says where; the next one says why.
        Some(at) if panics(lines[at]) => lines[at..].iter().take(2).copied().collect::<Vec<_>>().join(" "),
        Some(at) => lines[at].to_owned(),
        None => lines.last().copied().unwrap_or("no message").to_owned(),
    }
}

/// How `child` ended, if it does within `limit`.
fn ended(child: &mut Child, limit: Duration) -> io::Result<Option<ExitStatus>> {
    let started = Instant::now();
    loop {
        let status = child.try_wait()?;
        if status.is_some() || started.elapsed() >= limit {
            return Ok(status);
        }
        sleep(PAUSE);
    }
}

/// The whole content of a file that a program wrote to. Drivers may write text that is not UTF-8.
fn text(mut file: std::fs::File) -> io::Result<String> {
    let mut bytes = Vec::new();
    file.rewind()?;
    file.read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, limit: Duration) -> Ended {
        run(Command::new("sh").args(["-c", script]), limit).unwrap()
    }

    #[test]
    fn programs_are_heard_to_the_end_and_more_than_a_pipe_holds() {
        let said =
            shell("echo out; head -c 1000000 /dev/zero | tr '\\0' x >&2; exit 3", Duration::from_secs(60));
        assert_eq!(said.status.unwrap().code(), Some(3));
        assert_eq!((said.stdout.as_str(), said.stderr.len()), ("out\n", 1_000_000));
    }

    #[test]
    fn a_program_that_hangs_is_killed_at_its_limit_and_what_it_said_is_kept() {
        let started = Instant::now();
        let said = shell("echo first >&2; exec sleep 60", Duration::from_secs(2));
        assert!(said.status.is_none(), "{said:?}");
        assert_eq!(said.stderr, "first\n");
        // It ends by being killed, not by being left behind.
        assert!(started.elapsed() < GRACE, "{:?}", started.elapsed());
    }

    #[test]
    fn the_reason_is_the_last_error_or_panic_else_the_last_line() {
        for (stderr, expected) in [
            ("error: first\nerror: lost\nnote: more\n", "error: lost"),
            ("warning\nlast\n\n", "last"),
            ("", "no message"),
            (
                "error: early\n\nthread 'main' panicked at a.rs:1:2:\nno room\nnote: run with `RUST_BACKTRACE=1`\n",
                "thread 'main' panicked at a.rs:1:2: no room",
            ),
            (
                "thread 'main' (7) panicked at a.rs:1:2:\nno room\n",
                "thread 'main' (7) panicked at a.rs:1:2: no room",
            ),
            ("thread 'main' panicked at 'no room'", "thread 'main' panicked at 'no room'"),
            ("thread 'main' panicked at a.rs:1:2:\nno room\nerror: after\n", "error: after"),
        ] {
            assert_eq!(reason(stderr), expected, "{stderr}");
        }
    }
}
