//! Parts of a path, rendered apart and put together.

use std::fs;
use std::path::Path;
use std::time::SystemTime;

use super::{gs3, json, names, png, stderr, succeed};

/// A folder with a scene that takes little time: a fiftieth of the demo's Gaussians.
pub fn few_gaussians() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), "simplify demo --size 64x36 --frames 0..2 --keep 0.02 --out few.ply");
    fs::write(folder.path().join("path.json"), cameras(50)).unwrap();
    folder
}

/// A path around the scene's middle, `count` frames, as nerfstudio writes it.
pub fn cameras(count: usize) -> String {
    let pose = |k: usize| {
        let turn = 0.02 * k as f64;
        let (s, c) = (turn.sin(), turn.cos());
        format!(
            r#"{{"camera_to_world": [{c},0,{s},{}, 0,1,0,-1, {},0,{c},{}, 0,0,0,1], "fov": 50, "aspect": 1.78}}"#,
            7.0 * s,
            -s,
            7.0 * c
        )
    };
    let poses: Vec<String> = (0..count).map(pose).collect();
    format!(
        r#"{{"fps": 30, "render_height": 54, "render_width": 96, "camera_path": [{}]}}"#,
        poses.join(", ")
    )
}

/// Names and bytes of all frames.
fn frames(folder: &Path) -> Vec<(String, Vec<u8>)> {
    names(folder).into_iter().map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect()
}

fn render(folder: &Path, options: &str, out: &str) {
    succeed(folder, &format!("render few.ply --path path.json --backend cpu {options} --out {out}"));
}

#[test]
fn parts_of_a_path_have_the_bits_of_one_run() {
    let folder = few_gaussians();
    let at = folder.path();
    for (k, options) in [
        "",
        "--keyframes 8 --in-between 1",
        "--keyframes 8 --mode super-sample --refine 0.1",
        "--keyframes 8 --overscan",
        "--keyframes 8 --tier fast --interpolation learned",
        "--refine off",
        "--refine off --overscan --keyframes 4 --scale 2",
        "--refine off --jitter off --keyframes 7",
        "--mode bicubic",
    ]
    .iter()
    .enumerate()
    {
        render(at, options, &format!("whole{k}"));
        // One after a keyframe, at one, and somewhere.
        for part in ["0..9", "9..16", "16..43", "43..50"] {
            render(at, &format!("{options} --frames {part}"), &format!("parts{k}"));
        }
        let [whole, parts] = ["whole", "parts"].map(|name| frames(&at.join(format!("{name}{k}"))));
        assert!(whole.len() >= 50, "{options}: {}", whole.len());
        assert_eq!(names(&at.join(format!("whole{k}"))), names(&at.join(format!("parts{k}"))), "{options}");
        let differ: Vec<_> =
            whole.iter().zip(&parts).filter(|(a, b)| a.1 != b.1).map(|(a, _)| &a.0).collect();
        assert!(differ.is_empty(), "{options}: {differ:?}");
    }
    // Without the frames before it, a part begins otherwise.
    render(at, "--frames 43..50 --warm-up 0", "cold");
    let (whole, cold) = (frames(&at.join("whole0")), frames(&at.join("cold")));
    assert_eq!((cold[0].0.as_str(), cold.len()), ("frame_000129.png", 19));
    assert!(cold[1] != whole[130] && cold[18] != whole[147]);
}

fn written_at(file: &Path) -> SystemTime {
    fs::metadata(file).unwrap().modified().unwrap()
}

#[test]
fn frames_that_are_there_are_not_made_again() {
    let folder = few_gaussians();
    let at = folder.path();
    let made = |options: &str| {
        render(at, &format!("{options} --keyframes 8 --in-between 1 --json r.json"), "out");
        json(&at.join("r.json"))["frames_rendered"].as_u64().unwrap()
    };
    assert_eq!(made("--frames 0..30"), 30);
    let before = frames(&at.join("out"));
    assert_eq!(made("--frames 0..30 --skip-existing"), 0);
    // A rendered frame with the one between before it, and one between alone; far from each other and near.
    for number in [13, 14, 17, 45] {
        fs::remove_file(at.join(format!("out/frame_{number:06}.png"))).unwrap();
    }
    // Rendered frames without their in-between frame are made again, and their files stay.
    let times = || [18, 46].map(|number| written_at(&at.join(format!("out/frame_{number:06}.png"))));
    let kept = times();
    assert_eq!(made("--frames 0..30 --skip-existing"), 3);
    assert!(frames(&at.join("out")) == before);
    assert_eq!(times(), kept);
    assert_eq!(made("--skip-existing"), 20);
    assert_eq!(names(&at.join("out")).len(), 99);
    let output = gs3(at, "render few.ply --skip-existing --out v.mp4").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains(
            "--skip-existing: expected --out DIR (gs3 join makes a video of it), found --out v.mp4"
        )
    );
}

#[test]
fn frames_of_other_settings_are_not_mixed() {
    let folder = few_gaussians();
    let at = folder.path();
    render(at, "--frames 0..4", "out");
    let before = frames(&at.join("out"));
    fs::write(at.join("other.json"), cameras(49)).unwrap();
    for (options, reason) in [
        ("--frames 4..8 --quality high", "expected frames of quality high, found those of quality balanced"),
        ("--frames 4..8 --tier fast", "expected frames of arithmetic "),
        ("--frames 4..8 --mode native", "expected frames of mode native, found those of mode full"),
        ("--frames 0..4 --skip-existing --scale 2", "expected frames of scale 2, found those of scale 4"),
        ("--frames 4..8 --path other.json", "expected frames of cameras "),
    ] {
        let path = if options.contains("--path") { "" } else { "--path path.json" };
        let command = format!("render few.ply {path} --backend cpu {options} --out out");
        let output = gs3(at, &command).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{options}: {said}");
        assert!(said.contains(reason) && said.contains("out/manifest.json: "), "{options}: {said}");
        assert!(frames(&at.join("out")) == before, "{options}");
    }
    let output = gs3(at, "render demo --path path.json --frames 4..5 --out out").output().unwrap();
    assert!(stderr(&output).contains("expected frames of scene "), "{}", stderr(&output));
    // All that is there is replaced.
    render(at, "--frames 0..10 --mode native", "out");
    assert_eq!(json(&at.join("out/manifest.json"))["mode"], "native");
    assert_eq!(names(&at.join("out")).len(), 10);
    fs::write(at.join("out/manifest.json"), "{").unwrap();
    let output = gs3(at, "render few.ply --path path.json --frames 0..1 --out out").output().unwrap();
    assert!(stderr(&output).contains("manifest.json: expected what gs3 render writes, found "));
}

#[test]
fn joined_frames_are_the_video_of_one_run() {
    let folder = few_gaussians();
    let at = folder.path();
    fs::write(at.join("path.json"), cameras(6)).unwrap();
    let run = |command: &str| gs3(at, command).env("PATH", "").output().unwrap();
    let whole = run("render few.ply --path path.json --backend cpu --out whole.mp4");
    assert!(whole.status.success(), "{}", stderr(&whole));
    render(at, "--frames 0..2", "out");
    let output = run("join out --out joined.mp4");
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("DIR: expected all frames from 0 to 15 ") && said.contains("found none of 4 to 15"),
        "{said}"
    );
    render(at, "--frames 4..6", "out");
    assert!(stderr(&run("join out --out joined.mp4")).contains("found none of 4 to 9"));
    render(at, "--frames 2..4", "out");
    let output = run("join out --out joined.mp4");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(fs::read(at.join("joined.mp4")).unwrap() == fs::read(at.join("whole.mp4")).unwrap());
    let output = run("join out --frames 3..5 --out part.mp4");
    assert!(stderr(&output).contains("2 frames in part.mp4"), "{}", stderr(&output));
    // A frame that is no image, one of another size, and a folder of something else.
    fs::write(at.join("out/frame_000004.png"), "no image").unwrap();
    assert!(stderr(&run("join out --out x.mp4")).contains("frame_000004.png: no PNG file: "));
    render(at, "--frames 1..2 --mode native --size 48x27", "small");
    fs::copy(at.join("small/frame_000001.png"), at.join("out/frame_000004.png")).unwrap();
    assert_eq!(png(&at.join("out/frame_000004.png")).0, 48);
    let said = stderr(&run("join out --out x.mp4"));
    assert!(said.contains("frame_000004.png: expected 96x54 pixels, found 48x27"), "{said}");
    let said = stderr(&run("join . --out x.mp4"));
    assert!(
        said.contains(
            "manifest.json: expected the file that gs3 render writes beside its frames, found none"
        )
    );
    assert!(
        stderr(&run("join out --frames 3..17 --out x.mp4"))
            .contains("--frames: expected frames within 0..16")
    );
    assert!(!at.join("x.mp4").exists());
}

#[test]
#[cfg(target_os = "linux")]
fn exit_codes_tell_whether_to_try_again() {
    let folder = few_gaussians();
    let at = folder.path();
    let code = |command: &str| gs3(at, command).output().unwrap().status.code();
    let render = "render few.ply --path path.json --frames 0..1 --backend cpu --out o";
    assert_eq!(code(render), Some(0));
    assert_eq!(code(&format!("{render} --scale 99")), Some(2));
    assert_eq!(code("render missing.ply --out o"), Some(2));
    assert_eq!(code(&format!("{render} --json /proc/forbidden.json")), Some(2));
    assert_eq!(code(&format!("{render} --json /dev/full")), Some(75));
}
