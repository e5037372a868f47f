//! Videos, with a stand-in for `ffmpeg` that keeps what it is given.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::{gs3, names, png, stderr};

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
