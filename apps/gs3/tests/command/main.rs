//! The command as its users meet it: what it writes, what it says, how it ends.
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

mod aov;
mod asked;
mod backend;
mod bad_input;
mod chunks;
mod evaluate;
mod export;
mod frames;
mod golden;
mod kinds;
mod large;
mod memory;
mod outputs;
mod photos;
mod scenes;
mod sharing;
mod simplify;
mod train_clips;
mod video;
#[cfg(all(feature = "view", target_os = "linux"))]
mod view;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

/// The command, in `folder`, with whatever `gs3 {arguments}` is split into at blanks.
fn gs3(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gs3"));
    // Mesa's layer of device selection writes a line of its own where there is none.
    command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    command.current_dir(folder).args(arguments.split_ascii_whitespace());
    command
}

/// Runs it to a good end.
fn succeed(folder: &Path, arguments: &str) -> Output {
    let output = gs3(folder, arguments).output().unwrap();
    assert!(output.status.success(), "gs3 {arguments}: {}", stderr(&output));
    output
}

/// Runs a command that is refused with one line, and returns the line.
fn refused(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{command:?}: {said}");
    assert!(said.starts_with("error: ") && said.lines().count() == 1, "{command:?}: {said}");
    said
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Sends it Ctrl-C once it is `ready`, and waits for its end.
#[cfg(unix)]
fn interrupt(child: Child, ready: impl Fn() -> bool) -> Output {
    let deadline = Instant::now() + Duration::from_secs(60);
    while !ready() {
        assert!(Instant::now() < deadline, "nothing came");
        std::thread::sleep(Duration::from_millis(5));
    }
    send_interrupt(child.id());
    child.wait_with_output().unwrap()
}

#[cfg(unix)]
fn send_interrupt(process: u32) {
    assert!(Command::new("kill").args(["-INT", &process.to_string()]).status().unwrap().success());
}

/// The names in `folder`, sorted, but for what is written beside frames.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name != "manifest.json");
    names.sort();
    names
}

/// Width, height and RGB bytes of a whole PNG file.
fn png(file: &Path) -> (u32, u32, Vec<u8>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(file).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    reader.finish().unwrap();
    (info.width, info.height, bytes)
}

fn json(file: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(file).unwrap()).unwrap()
}
