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

    fs::write(at.join("clips/demo_0000.clip"), b"kept").unwrap();
    fs::remove_file(at.join("clips/demo_0001.clip")).unwrap();
    let output = succeed(at, &format!("{options} --out clips"));
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("demo: 1 clips, "));
    assert_eq!(fs::read(at.join("clips/demo_0000.clip")).unwrap(), b"kept");
    assert_eq!(names(&at.join("clips")), files);
}

#[test]
fn nonsense_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("none.safetensors"), b"").unwrap();
    for (arguments, message) in [
        (
            "demo --network super-sample --size 66x64",
            "error: size of clips: expected multiples of 4 up to 4096×2160, found 66×64\n",
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
