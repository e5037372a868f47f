//! `gs3 train clips`.

use std::fs;

use super::{gs3, names, png, stderr, succeed};

#[test]
fn clips_are_written_once_and_shown() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let options = "train clips demo --network super-sample --count 3 --held-out 0.34 --frames 2 --size 64x32";
    let output = succeed(at, &format!("{options} --out clips --preview first.png"));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.starts_with("demo: 3 clips, "), "{text}");
    let files = ["demo_0000.clip", "demo_0001.clip", "held_demo_0000.clip"];
    assert_eq!(names(&at.join("clips")), files);
    let (width, height, _) = png(&at.join("first.png"));
    assert_eq!((width, height), (5 * 64, 2 * 32));

    let kept = fs::read(at.join("clips/held_demo_0000.clip")).unwrap();
    fs::write(at.join("clips/demo_0000.clip"), &kept).unwrap();
    fs::remove_file(at.join("clips/demo_0001.clip")).unwrap();
    let output = succeed(at, &format!("{options} --out clips"));
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("demo: 1 clips, "));
    assert_eq!(fs::read(at.join("clips/demo_0000.clip")).unwrap(), kept);
    assert_eq!(names(&at.join("clips")), files);

    for (other, message) in [
        ("--frames 3", "frames: expected 3, found 2"),
        ("--size 32x32", "size: expected 32x32, found 64x32"),
        ("--scale 2", "scale: expected 2, found 4"),
        ("--network interpolate", "network: expected interpolate, found super_sample"),
    ] {
        let option = other.split(' ').next().unwrap();
        let words: Vec<&str> = options.split(' ').collect();
        let at_option = words.iter().position(|word| *word == option);
        let same: Vec<&str> = (words.iter().enumerate())
            .filter(|(k, _)| at_option.is_none_or(|at| *k != at && *k != at + 1))
            .map(|(_, word)| *word)
            .collect();
        let output = gs3(at, &format!("{} {other} --out clips", same.join(" "))).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("demo_0000.clip: ") && said.contains(message), "{said}");
        assert_eq!(names(&at.join("clips")), files);
    }
}

#[test]
fn a_scene_without_clips_is_not_previewed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, "convert demo other.spz");
    let options = "--network super-sample --count 1 --held-out 0 --frames 1 --size 32x32";
    succeed(at, &format!("train clips demo other.spz {options} --out clips --preview first.png"));
    assert_eq!(names(&at.join("clips")), ["other_0000.clip"]);
    assert_eq!(png(&at.join("first.png")).1, 32);
}

#[test]
fn nonsense_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("none.safetensors"), b"").unwrap();
    for (arguments, message) in [
        (
            "demo --network super-sample --size 66x64",
            "error: size of clips: expected multiples of 4 up to 4096x2160, found 66x64\n",
        ),
        ("demo --network interpolate --frames 0", "error: frames of a clip: expected at least 1, found 0\n"),
        (
            "demo --network interpolate --held-out 0.6",
            "error: held-out share: expected at least 0 and at most 0.5, found 0.6\n",
        ),
        (
            "demo demo --network interpolate",
            "error: SCENE: expected scenes with different names, found demo, demo\n",
        ),
        (
            "demo a.ply --paths b.json --network interpolate",
            "error: --paths: expected a single scene, that the cameras are of, found 2 scenes\n",
        ),
        ("demo --network interpolate --weights none.safetensors", "error: none.safetensors: "),
    ] {
        let output = gs3(folder.path(), &format!("train clips {arguments} --out clips")).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments}");
        assert!(stderr(&output).starts_with(message), "{arguments}: {}", stderr(&output));
        assert!(!folder.path().join("clips").exists(), "{arguments}");
    }
}
