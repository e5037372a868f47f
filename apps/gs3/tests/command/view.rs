//! `gs3 view` in a window that nobody sees: a script plays what a hand does, on the CPU, without a driver.
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use gs3::scene::format::save;
use gs3_test_support::{psnr_of_bytes, row_of_gaussians, serve};

use super::{gs3, png, refused, stderr};

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

fn view(display: &Display, folder: &Path, arguments: &str, steps: &str) -> Output {
    viewing(display, folder, arguments, steps).output().unwrap()
}

fn viewing(display: &Display, folder: &Path, arguments: &str, steps: &str) -> Command {
    viewing_of("demo", display, folder, arguments, steps)
}

fn viewing_of(scene: &str, display: &Display, folder: &Path, arguments: &str, steps: &str) -> Command {
    fs::write(folder.join("script.json"), format!("{{\"steps\": [{steps}]}}")).unwrap();
    let mut command = gs3(folder, &format!("view {scene} --backend cpu --script script.json {arguments}"));
    command.env("DISPLAY", &display.name).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    // There is no driver to find.
    command.env("VK_DRIVER_FILES", "/nonexistent");
    // Nor a desktop that asks for files.
    command.env("DBUS_SESSION_BUS_ADDRESS", "unix:path=/nonexistent");
    command
}

/// The names of the files in `folder`, those that begin with a dot too.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
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
        let psnr = psnr_of_bytes(&shown.2, &expected.2);
        assert!(psnr > 50.0, "{shot}: {psnr:.1} dB");
    }
    let [first, second] = ["first.png", "second.png"].map(|name| png(&folder.join(name)).2);
    assert!(psnr_of_bytes(&first, &second) < 40.0, "the camera has moved");
    let tour = fs::read_to_string(folder.join("tour.json")).unwrap();
    assert!(tour.contains("camera_to_world"));
}

/// A path of eight cameras around the demo, recorded in the window.
fn record(display: &Display, folder: &Path) {
    let steps = r#"{"do": "key", "key": "K"},
        {"do": "drag", "button": "left", "from": [0.5, 0.5], "to": [0.55, 0.5], "frames": 2}, {"do": "wait_idle"},
        {"do": "key", "key": "K"}, {"do": "save_path", "file": "way.json"},
        {"do": "save_path", "file": "settings.json"}, {"do": "expect", "message": "", "note": "written: settings.json"},
        {"do": "end"}"#;
    let output = view(display, folder, "--size 160x90", steps);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn a_video_is_the_one_of_render_and_the_window_lives_on_meanwhile() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(&display, folder);
    // The window moves its camera, opens a scene and refuses a second video while the first one is rendered.
    let steps = r#"{"do": "video", "file": "shown.mp4"}, {"do": "expect", "video": true},
        {"do": "video", "file": "second.mp4"}, {"do": "expect", "message": "expected no other video under way"},
        {"do": "key", "key": "Escape"},
        {"do": "drag", "button": "left", "from": [0.5, 0.5], "to": [0.6, 0.5], "frames": 5},
        {"do": "wait_idle"}, {"do": "figures", "file": "figures.json"}, {"do": "expect", "video": true},
        {"do": "screenshot", "file": "meanwhile.png", "panels": true},
        {"do": "wait_video"}, {"do": "expect", "video": false, "message": "", "note": "written: shown.mp4"},
        {"do": "video", "file": "short.mp4", "size": [64, 36], "fps": 24, "frames": 3}, {"do": "wait_video"},
        {"do": "end"}"#;
    let output = view(&display, folder, "--size 160x90 --path way.json", steps);
    assert!(output.status.success(), "{}", stderr(&output));
    let figures: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("figures.json")).unwrap()).unwrap();
    assert!(figures["rendered"].as_u64().unwrap() > 16, "{figures}");
    // The command encodes by itself where there is no ffmpeg.
    let render = "render demo --path way.json --size 160x90 --in-between 1 --backend cpu --out rendered.mp4";
    let rendered = gs3(folder, render).env("PATH", "/nonexistent").output().unwrap();
    assert!(rendered.status.success(), "{}", stderr(&rendered));
    let [shown, rendered, short] =
        ["shown.mp4", "rendered.mp4", "short.mp4"].map(|name| fs::read(folder.join(name)).unwrap());
    assert!(shown.len() > 10_000 && shown == rendered, "{} and {} bytes", shown.len(), rendered.len());
    assert!(short.len() > 500 && short.len() < shown.len());
    assert!(!names(folder).iter().any(|name| name.contains("partial") || name == "second.mp4"));
}

#[test]
fn a_video_that_is_cancelled_or_left_or_fails_leaves_no_file() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let steps = r#"{"do": "video", "file": "stopped.mp4"}, {"do": "wait", "frames": 3}, {"do": "stop_video"},
        {"do": "wait_video"}, {"do": "expect", "video": false, "message": "", "note": "cancelled"}, {"do": "end"}"#;
    // The demo's own path takes longer than three loops.
    let output = view(&display, folder, "--size 160x90", steps);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(names(folder), ["script.json"]);
    let steps = r#"{"do": "video", "file": "left.mp4"}, {"do": "wait", "frames": 3}, {"do": "end"}"#;
    let output = view(&display, folder, "--size 160x90", steps);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(names(folder), ["script.json"]);
    for (step, expected) in [
        (r#""file": "none/a.mp4""#, "none/a.mp4: the video cannot be written: "),
        (
            r#""file": "a.mp4", "fps": 2000, "frames": 3"#,
            "a.mp4: the video cannot be written: frame rate: expected more than 0 and at most 1000",
        ),
    ] {
        let steps = format!(r#"{{"do": "video", {step}}}, {{"do": "wait_video"}}, {{"do": "end"}}"#);
        let output = view(&display, folder, "--size 64x36", &steps);
        assert_eq!(output.status.code(), Some(2));
        let text = stderr(&output);
        assert!(text.contains(expected) && text.trim().lines().count() == 1, "{text}");
        assert_eq!(names(folder), ["script.json"]);
    }
}

#[test]
fn settings_of_supersplat_come_back_and_files_are_chosen_in_a_dialog() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(&display, folder);
    // Without a portal, without zenity.
    let steps = r#"{"do": "drop", "file": "settings.json"}, {"do": "wait", "frames": 1},
        {"do": "expect", "keys": 61, "message": "", "note": "settings.json: 61 cameras"},
        {"do": "key", "key": "O"}, {"do": "wait", "frames": 30},
        {"do": "expect", "message": "file dialog: expected xdg-desktop-portal or zenity, found neither"},
        {"do": "key", "key": "Escape"}, {"do": "wait_idle"}, {"do": "end"}"#;
    let output =
        viewing(&display, folder, "--size 160x90", steps).env("PATH", "/nonexistent").output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    // A zenity that chooses two files after a while, and then cancels.
    let zenity = folder.join("bin/zenity");
    fs::create_dir(folder.join("bin")).unwrap();
    let answer = "#!/bin/sh\n[ -e asked ] && exit 1\n: > asked\nsleep 0.3\necho 'one.ply|way.json'\n";
    fs::write(&zenity, answer).unwrap();
    fs::set_permissions(&zenity, fs::Permissions::from_mode(0o755)).unwrap();
    save(&row_of_gaussians(3, 0.3), folder.join("one.ply")).unwrap();
    let steps = r#"{"do": "key", "key": "O"}, {"do": "wait", "frames": 60},
        {"do": "expect", "gaussians": 3, "keys": 61, "message": ""},
        {"do": "key", "key": "O"}, {"do": "wait", "frames": 30}, {"do": "expect", "gaussians": 3, "message": ""},
        {"do": "end"}"#;
    let output = viewing(&display, folder, "--size 160x90", steps)
        .env("PATH", format!("{}:/usr/bin:/bin", folder.join("bin").display()))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn a_scene_comes_from_a_url() {
    let Some(display) = Display::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    save(&row_of_gaussians(3, 0.3), folder.join("three.ply")).unwrap();
    let address = serve(folder);
    let steps = r#"{"do": "wait_idle"}, {"do": "expect", "gaussians": 3, "message": "", "note": "opened three.ply"},
        {"do": "end"}"#;
    let output = viewing_of(&format!("{address}/three.ply"), &display, folder, "--size 64x36", steps)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let steps = r#"{"do": "wait_idle"}, {"do": "expect", "message": "none.ply: expected a file, found 404"}, {"do": "end"}"#;
    let output =
        viewing_of(&format!("{address}/none.ply"), &display, folder, "--size 64x36", steps).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let text = refused(&mut viewing_of(&address, &display, folder, "--size 64x36 --axes rub", steps));
    assert!(text.contains("--axes: expected a scene in the file system"), "{text}");
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
    let text = refused(&mut command);
    assert!(text.contains("window: expected a display"), "{text}");
}
