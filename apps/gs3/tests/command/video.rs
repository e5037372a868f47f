//! Videos, with a stand-in for `ffmpeg` that keeps what it is given.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Stdio;

use super::{gs3, interrupt, names, png, send_interrupt, stderr};

/// A PATH that holds nothing but an `ffmpeg` with this script.
fn path_with_ffmpeg(folder: &Path, script: &str) -> String {
    let bin = folder.join("bin");
    fs::create_dir(&bin).unwrap();
    let file = bin.join("ffmpeg");
    fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    bin.display().to_string()
}

const RENDER: &str = "render demo --size 96x54 --frames 0..3 --out clip.mp4";

#[test]
fn frames_reach_ffmpeg_in_order() {
    let folder = tempfile::tempdir().unwrap();
    // The last argument is the file to write.
    let script = r#"echo "$@" > arguments; for last; do :; done; /bin/cat > "$last""#;
    let path = path_with_ffmpeg(folder.path(), script);
    let output = gs3(folder.path(), RENDER).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let video = fs::read(folder.path().join("clip.mp4")).unwrap();
    let frames = names(&folder.path().join("clip"));
    assert_eq!(frames.len(), 5);
    let expected: Vec<u8> =
        frames.iter().flat_map(|name| png(&folder.path().join("clip").join(name)).2).collect();
    assert!(video == expected, "the raw frames are those of the PNG files, in order");
    let arguments = fs::read_to_string(folder.path().join("arguments")).unwrap();
    assert!(arguments.contains("-s 96x54 -r 60 "), "{arguments}");
    assert_eq!(names(folder.path()), ["arguments", "bin", "clip", "clip.mp4"]);
}

/// How the command says that a video of frames 0 to 4 is made.
const BY_HAND: &str = "ffmpeg -framerate 60 -start_number 0 -i ./clip/frame_%06d.png -frames:v 5 -vf ";

/// Those of an earlier, longer run are none of this one's.
#[test]
fn without_ffmpeg_the_frames_are_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("clip")).unwrap();
    fs::write(folder.path().join("clip/frame_000005.png"), "").unwrap();
    let output = gs3(folder.path(), RENDER).env("PATH", "").output().unwrap();
    let said = stderr(&output);
    assert!(output.status.success(), "{said}");
    let named =
        "no ffmpeg on PATH, so no clip.mp4: the frames are clip/frame_000000.png to frame_000004.png, ";
    assert!(said.contains(named) && said.contains(BY_HAND), "{said}");
    assert_eq!(names(folder.path()), ["clip"]);
}

#[test]
fn a_failing_ffmpeg_is_quoted_and_costs_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path =
        path_with_ffmpeg(folder.path(), "echo 'Unknown encoder libx264' >&2; : > clip.mp4.partial; exit 1");
    let run = || gs3(folder.path(), &format!("{RENDER} --json r.json")).env("PATH", &path).output().unwrap();
    let output = run();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    let failed = "error: clip.mp4: ffmpeg failed: Unknown encoder libx264; the frames are in clip, and ";
    assert!(said.lines().last().unwrap().starts_with(&format!("{failed}{BY_HAND}")), "{said}");
    assert_eq!(names(folder.path()), ["bin", "clip", "r.json"]);
    assert_eq!(names(&folder.path().join("clip")).len(), 5, "all frames are there");

    // One that nobody may execute.
    fs::set_permissions(folder.path().join("bin/ffmpeg"), fs::Permissions::from_mode(0o644)).unwrap();
    fs::remove_dir_all(folder.path().join("clip")).unwrap();
    let output = run();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("ffmpeg failed: Permission denied") && said.contains(BY_HAND), "{said}");
    assert_eq!(names(&folder.path().join("clip")).len(), 5);
}

/// It neither takes frames nor ends, for much longer than a second interruption takes.
#[test]
fn a_stuck_ffmpeg_is_ended_by_a_second_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let path = path_with_ffmpeg(at, ": > clip.mp4.partial; echo $$ > pid; exec /bin/sleep 30");
    let mut command = gs3(at, "render demo --size 320x180 --threads 1 --tier analytic --out clip.mp4");
    let child = command.env("PATH", path).stderr(Stdio::piped()).spawn().unwrap();
    let frames = at.join("clip");
    let id = child.id();
    let output = interrupt(child, || {
        // One frame is more than a pipe holds.
        let is_stuck = at.join("pid").is_file() && frames.is_dir() && !names(&frames).is_empty();
        if is_stuck {
            send_interrupt(id);
            std::thread::sleep(std::time::Duration::from_millis(300));
        }
        is_stuck
    });
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.ends_with("interrupted at once; all files are whole\n"), "{said}");
    assert_eq!(names(at), ["bin", "clip", "pid"]);
    for name in names(&frames) {
        assert_eq!(png(&frames.join(name)).0, 320);
    }
    let pid = fs::read_to_string(at.join("pid")).unwrap();
    let is_there = std::process::Command::new("kill").args(["-0", pid.trim()]).output().unwrap().status;
    assert!(!is_there.success(), "ffmpeg has ended");
}

#[test]
fn a_link_leads_to_the_video_and_a_pipe_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let script = r#"for last; do :; done; /bin/cat > "$last""#;
    let path = path_with_ffmpeg(at, script);
    fs::create_dir(at.join("far")).unwrap();
    // To a file and to none yet.
    for target in ["far/old", "far/new"] {
        fs::write(at.join("far/old"), "before").unwrap();
        std::os::unix::fs::symlink(target, at.join("clip.mp4")).unwrap();
        let output = gs3(at, RENDER).env("PATH", &path).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(fs::read_link(at.join("clip.mp4")).unwrap(), Path::new(target));
        assert_eq!(fs::metadata(at.join(target)).unwrap().len(), 5 * 96 * 54 * 3);
        fs::remove_file(at.join("clip.mp4")).unwrap();
    }
    assert_eq!(names(&at.join("far")), ["new", "old"]);
    assert!(std::process::Command::new("mkfifo").arg(at.join("pipe.mp4")).status().unwrap().success());
    let output = gs3(at, "render no.ply --out pipe.mp4").env("PATH", &path).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(stderr(&output), "error: --out: expected a file, found pipe.mp4, a device or a pipe\n");
}

#[test]
fn frames_of_different_sizes_are_no_video() {
    let folder = tempfile::tempdir().unwrap();
    let camera = |width: u32, height: u32| {
        format!(
            r#"{{"width": {width}, "height": {height}, "position": [0, 0, -5], "fx": 50, "fy": 50,
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}"#
        )
    };
    let cameras = format!("[{}, {}, {}]", camera(64, 36), camera(64, 36), camera(80, 45));
    fs::write(folder.path().join("cameras.json"), cameras).unwrap();
    let path = path_with_ffmpeg(folder.path(), "/bin/cat > /dev/null");
    let render = "render demo --path cameras.json --tier analytic --mode native --out";
    let output = gs3(folder.path(), &format!("{render} v.mp4")).env("PATH", &path).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("--size") && said.contains("found 64x36 in frame 0 and 80x45 in frame 2"),
        "{said}"
    );
    assert_eq!(names(folder.path()), ["bin", "cameras.json"]);
    // Files may differ, and those before do not.
    for out in ["frames", "v.mp4 --frames 0..2"] {
        let output = gs3(folder.path(), &format!("{render} {out}")).env("PATH", "").output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
}

#[test]
fn a_name_is_no_option_of_ffmpeg() {
    let folder = tempfile::tempdir().unwrap();
    let script = r#"for last; do :; done; echo "$last" > last; /bin/cat > "$last""#;
    let path = path_with_ffmpeg(folder.path(), script);
    let render = "render demo --size 16x9 --frames 0..1 --tier analytic --out=-y.mp4";
    let output = gs3(folder.path(), render).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(folder.path().join("last")).unwrap(), "./-y.mp4.partial\n");
}

#[test]
fn after_an_interruption_it_is_said_how_the_whole_video_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = path_with_ffmpeg(folder.path(), "/bin/cat > /dev/null");
    let mut command = gs3(folder.path(), "render demo --size 320x180 --frames 2..240 --out clip.mp4");
    let child = command.env("PATH", path).stderr(Stdio::piped()).spawn().unwrap();
    let frames = folder.path().join("clip");
    let output = interrupt(child, || frames.is_dir() && names(&frames).len() >= 4);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    let names = names(&frames);
    // Frames 3 to 478, of which the next one to render shows two.
    let left = 2 + names.len() / 2;
    assert_eq!(names[0], "frame_000003.png");
    let rest = format!("To go on: the same command with --frames {left}..240 --out ./clip/, and then, ");
    assert!(said.contains(&rest), "{said}");
    let whole = "ffmpeg -framerate 60 -start_number 3 -i ./clip/frame_%06d.png -frames:v 476 -vf 'pad=ceil(iw/2)*2:ceil(ih/2)*2' ";
    assert!(said.contains(whole) && said.trim_end().ends_with(" ./clip.mp4"), "{said}");
}
