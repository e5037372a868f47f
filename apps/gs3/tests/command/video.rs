//! Videos, with a stand-in for `ffmpeg` that keeps what it is given.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Stdio;

use super::{gs3, interrupt, names, png, stderr};

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

#[test]
fn without_ffmpeg_the_frames_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let output = gs3(folder.path(), RENDER).env("PATH", "").output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("no ffmpeg on PATH, so no clip.mp4: the frames are clip/frame_"));
    assert_eq!(names(folder.path()), ["clip"]);
}

#[test]
fn a_failing_ffmpeg_is_quoted_and_leaves_no_video() {
    let folder = tempfile::tempdir().unwrap();
    let path =
        path_with_ffmpeg(folder.path(), "echo 'Unknown encoder libx264' >&2; : > clip.mp4.partial; exit 1");
    let output = gs3(folder.path(), RENDER).env("PATH", path).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("clip.mp4: ffmpeg failed: Unknown encoder libx264; the frames are in clip")
    );
    assert_eq!(names(folder.path()), ["bin", "clip"]);
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
