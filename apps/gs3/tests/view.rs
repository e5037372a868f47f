//! `gs3 view` in a window that nobody sees: a script plays what a hand does, on the CPU, without a driver.
#![cfg(all(feature = "view", target_os = "linux"))]
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// An X server without a screen, ended with the value.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// None where Xvfb is not installed, which the test says.
    fn new() -> Option<Self> {
        // It chooses a free number and writes it.
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp"]);
        let mut server = match command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn() {
            Ok(server) => server,
            Err(error) => {
                eprintln!("skipped: no Xvfb: {error}");
                return None;
            }
        };
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap().by_ref()).read_line(&mut line).unwrap();
        let number: u32 = line.trim().parse().expect("Xvfb writes its number");
        Some(Self { server, name: format!(":{number}") })
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        _ = self.server.kill();
        _ = self.server.wait();
    }
}

fn gs3(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gs3"));
    command.current_dir(folder).args(arguments.split_ascii_whitespace());
    command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    command
}

fn view(display: &Display, folder: &Path, arguments: &str, steps: &str) -> Output {
    fs::write(folder.join("script.json"), format!("{{\"steps\": [{steps}]}}")).unwrap();
    let mut command = gs3(folder, &format!("view demo --backend cpu --script script.json {arguments}"));
    command.env("DISPLAY", &display.name).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    // There is no driver to find.
    command.env("VK_DRIVER_FILES", "/nonexistent");
    command.output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Width, height and RGB bytes of a PNG file.
fn png(file: &Path) -> (u32, u32, Vec<u8>) {
    let mut reader = png::Decoder::new(BufReader::new(fs::File::open(file).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    (info.width, info.height, bytes)
}

fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (255.0 * 255.0 / (sum / a.len() as f64)).log10()
}

#[test]
fn a_script_plays_in_a_window_and_its_screenshots_are_what_render_writes() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("bad.ply"), "ply\nformat nonsense\n").unwrap();
    let steps = r#"
        {"do": "wait_idle"}, {"do": "expect", "idle": true, "message": ""},
        {"do": "screenshot", "file": "first.png"},
        {"do": "drag", "button": "left", "from": [0.5, 0.5], "to": [0.6, 0.45], "frames": 5},
        {"do": "key", "key": "K"}, {"do": "hold", "key": "W", "frames": 5},
        {"do": "drag", "button": "right", "from": [0.5, 0.5], "to": [0.45, 0.55], "frames": 3},
        {"do": "wheel", "lines": 1, "at": [0.5, 0.5]}, {"do": "key", "key": "K"},
        {"do": "drop", "file": "bad.ply"}, {"do": "expect", "message": "bad.ply"},
        {"do": "screenshot", "file": "message.png", "panels": true},
        {"do": "key", "key": "Escape"}, {"do": "expect", "message": "", "keys": 2},
        {"do": "wait_idle"}, {"do": "screenshot", "file": "second.png", "camera": "second.json"},
        {"do": "save_path", "file": "tour.json"},
        {"do": "key", "key": "C"}, {"do": "wait", "frames": 3}, {"do": "key", "key": "C"},
        {"do": "key", "key": "Space"}, {"do": "wait", "frames": 3}, {"do": "expect", "playing": true, "idle": false},
        {"do": "figures", "file": "figures.json"}, {"do": "end"}"#;
    let output = view(&display, folder, "--size 320x180", steps);
    assert!(output.status.success(), "{}", stderr(&output));
    // The first camera is the path's, the second one was written.
    for (shot, arguments) in [("first", ""), ("second", "--path second.json")] {
        let arguments =
            format!("render demo {arguments} --size 320x180 --mode native --backend cpu --frames 0..1");
        let rendered = gs3(folder, &format!("{arguments} --out {shot}-rendered.png")).output().unwrap();
        assert!(rendered.status.success(), "{}", stderr(&rendered));
        let shown = png(&folder.join(format!("{shot}.png")));
        let expected = png(&folder.join(format!("{shot}-rendered.png")));
        assert_eq!((shown.0, shown.1), (320, 180));
        let psnr = psnr(&shown.2, &expected.2);
        assert!(psnr > 50.0, "{shot}: {psnr:.1} dB");
    }
    let [first, second] = ["first.png", "second.png"].map(|name| png(&folder.join(name)).2);
    assert!(psnr(&first, &second) < 40.0, "the camera has moved");
    let tour = fs::read_to_string(folder.join("tour.json")).unwrap();
    assert!(tour.contains("camera_to_world"));
}

#[test]
fn a_script_that_meets_what_it_does_not_expect_ends_with_one_line() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let output = view(&display, folder.path(), "--size 64x36", r#"{"do": "expect", "gaussians": 3}"#);
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(text.contains("script: steps[0]: expected gaussians 3, found gaussians 533008"), "{text}");
    let output = view(&display, folder.path(), "--size 64x36", r#"{"do": "jump"}"#);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("steps[0]: unknown variant `jump`"), "{}", stderr(&output));
}

#[test]
fn without_a_display_one_line_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = gs3(folder.path(), "view demo --backend cpu --size 64x36");
    for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
        command.env_remove(name);
    }
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(text.contains("window: expected a display") && text.trim().lines().count() == 1, "{text}");
}
