//! What is asked for is what is done, and what figures say was done.

use std::fs;

use gs3::Networks;
use gs3::neural::model::Tier;

use super::{gs3, json, names, stderr, succeed};

/// Weights take the place of those of their own network alone.
#[test]
fn weights_of_interpolation_leave_super_sampling_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let weights = Networks::shipped(4, Tier::Fast).unwrap().interpolate.unwrap();
    weights.save(at.join("w.safetensors")).unwrap();
    let render = "render demo --size 64x48 --frames 0..2 --backend cpu";
    succeed(at, &format!("{render} --json default.json --out default"));
    succeed(at, &format!("{render} --weights w.safetensors --json own.json --out own"));
    let frame = |run: &str, k: usize| fs::read(at.join(run).join(format!("frame_00000{k}.png"))).unwrap();
    for rendered in [0, 3] {
        assert_eq!(frame("own", rendered), frame("default", rendered), "{rendered}");
    }
    let ran = |run: &str| {
        let figures = json(&at.join(format!("{run}.json")));
        ["tier", "interpolation"].map(|key| figures[key].as_str().unwrap().to_owned())
    };
    assert_eq!(ran("default"), ["analytic", "analytic"]);
    assert_eq!(ran("own"), ["analytic+fast", "learned"]);
}

/// A file is judged as what its name says: it must be that.
#[test]
fn weights_of_another_tier_are_not_judged() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("own")).unwrap();
    let weights = Networks::shipped(4, Tier::Fast).unwrap().super_sample.unwrap();
    weights.save(at.join("own/super_sample_balanced_x4.safetensors")).unwrap();
    let evaluate =
        "evaluate demo --size 64x48 --frames 0..3 --methods bicubic,balanced --weights own --out out";
    let output = gs3(at, evaluate).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let expected = "super_sample_balanced_x4.safetensors: header, tier: expected balanced, found fast";
    assert!(stderr(&output).contains(expected), "{}", stderr(&output));
}

/// Two runs that differ in anything that pictures or speed depend on differ in their figures.
#[test]
fn figures_tell_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = "render demo --size 64x48 --frames 3..4 --tier analytic --backend cpu";
    let others = "--kriging --overscan --dilation kerbl --jitter off --culling exact --background 1,1,1";
    succeed(at, &format!("{render} --json a.json --out a"));
    succeed(at, &format!("{render} {others} --json b.json --out b"));
    let [a, b] = ["a.json", "b.json"].map(|file| json(&at.join(file)));
    for (key, values) in [
        ("kriging", ["\"off\"", "\"on\""]),
        ("overscan", ["false", "true"]),
        ("dilation", ["\"matched\"", "\"kerbl\""]),
        ("sampling", ["\"jittered\"", "\"centered\""]),
        ("culling", ["\"accutile\"", "\"exact\""]),
        ("background", ["[0.0,0.0,0.0]", "[1.0,1.0,1.0]"]),
        ("scene", ["\"demo\""; 2]),
        ("path", ["\"orbit\""; 2]),
        ("frames", ["[3,4]"; 2]),
    ] {
        assert_eq!([&a, &b].map(|run| run[key].to_string()), values, "{key}");
    }
    assert!(b["command"].as_str().unwrap().ends_with(&format!("{others} --json b.json --out b")));
}

#[test]
fn frames_of_other_runs_in_a_folder_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = "render demo --size 32x24 --mode native --backend cpu --out out";
    let said = |frames: &str| stderr(&succeed(at, &format!("{render} --frames {frames}")));
    let told = "2 frames in out are of other runs than this one";
    assert!(!said("0..4").contains("other runs"));
    assert!(said("0..2").contains(told));
    assert!(said("2..4").contains(told));
    assert_eq!(names(&at.join("out")).len(), 4);
}

/// Cameras of several sizes cannot be judged at one; nothing to be seen is no good figure.
#[test]
fn paths_that_make_no_sense_of_figures_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let camera = |width: u32, turned: &str| {
        format!(r#"{{"fl_x": 50, "w": {width}, "h": 48, "transform_matrix": {turned}}}"#)
    };
    let toward = "[[1,0,0,0],[0,0,-1,-9],[0,1,0,2],[0,0,0,1]]";
    // Above all of it, looking up.
    let away = "[[1,0,0,0],[0,-1,0,-9],[0,0,-1,200],[0,0,0,1]]";
    let write = |name: &str, cameras: [String; 3]| {
        fs::write(at.join(name), format!(r#"{{"frames": [{}]}}"#, cameras.join(", "))).unwrap();
    };
    write("sizes.json", [camera(64, toward), camera(80, toward), camera(64, toward)]);
    write("away.json", [64; 3].map(|width| camera(width, away)));
    let output = gs3(at, "evaluate demo --path sizes.json --methods bicubic --out out").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let expected = "found 64x48 in frame 0 and 80x48 in frame 1";
    assert!(stderr(&output).contains(expected), "{}", stderr(&output));
    for command in ["bench demo --tier analytic", "gbuffer demo --out g.npz --backend cpu"] {
        let said = stderr(&succeed(at, &format!("{command} --path away.json")));
        assert!(said.contains("no Gaussian is visible"), "{command}: {said}");
    }
}
