//! Real captures, where they are at hand.

use std::path::{Path, PathBuf};

use gs3_scene::format::{LoadOptions, Streamed, load, save, streamed};
use gs3_scene::info::SceneInfo;

fn real(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/scenes")).join(name);
    if !path.exists() {
        eprintln!("skipped: no scene {name}");
        return None;
    }
    Some(path)
}

#[track_caller]
fn info(path: &Path) -> SceneInfo {
    let shares = std::sync::Mutex::new(Vec::new());
    let scene = load(path, &LoadOptions::default(), &|share| shares.lock().unwrap().push(share)).unwrap();
    let shares = shares.into_inner().unwrap();
    assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)));
    assert_eq!(shares.last(), Some(&1.0));
    let info = SceneInfo::of(&scene);
    assert_eq!(info.dropped.total(), 0);
    // Trained scenes have opacities all over the range.
    assert!(info.opacity.p5 < 0.4 && info.opacity.p95 > 0.5, "{:?}", info.opacity);
    assert!(info.smallest_scale.p50 <= info.largest_scale.p50);
    info
}

#[test]
fn streamed_scenes_fill_the_bounds_that_their_index_states() {
    for (name, count, degree) in [
        ("flowers", 542_104, 2),
        ("playbot", 500_000, 2),
        ("fungi", 1_500_000, 3),
        ("hqgarden", 3_390_927, 0),
    ] {
        let Some(path) = real(name) else { return };
        let info = info(&path);
        assert_eq!((info.gaussians, info.sh_degree), (count, degree), "{name}");
        if name == "hqgarden" {
            // Its environment lies outside the tree.
            continue;
        }
        let index: serde_json::Value =
            serde_json::from_slice(&std::fs::read(path.join("lod-meta.json")).unwrap()).unwrap();
        for axis in 0..3 {
            let bound = |side: &str| index["tree"]["bound"][side][axis].as_f64().unwrap() as f32;
            let extent = bound("max") - bound("min");
            assert!(info.bounds.min[axis] >= bound("min") - 1e-3 * extent, "{name}: {:?}", info.bounds);
            assert!(info.bounds.max[axis] <= bound("max") + 1e-3 * extent, "{name}: {:?}", info.bounds);
        }
    }
}

#[test]
fn the_environment_is_optional() {
    let Some(path) = real("lacadiere") else { return };
    assert_eq!(
        streamed(&path).unwrap(),
        Some(Streamed { levels: 1, has_environment: true, takes_budget: true })
    );
    let count = |environment| {
        let options = LoadOptions { level_of_detail: Some(0), environment, ..LoadOptions::default() };
        load(&path, &options, &|_| {}).unwrap().gaussians().len()
    };
    assert_eq!(count(false), 537_127 + 543_312 + 415_197);
    assert_eq!(count(true), 1_531_081);
}

#[test]
fn bundles_and_compressed_ply() {
    let Some(statue) = real("statues/st-peter.sog") else { return };
    assert_eq!(info(&statue).gaussians, 133_618);
    let Some(guitar) = real("guitar.compressed.ply") else { return };
    assert_eq!(info(&guitar).gaussians, 90_854);
}

#[test]
fn converting_a_capture_keeps_its_distributions() {
    let Some(path) = real("statues/angel.sog") else { return };
    let scene = load(&path, &LoadOptions::default(), &|_| {}).unwrap();
    let before = SceneInfo::of(&scene);
    let folder = tempfile::tempdir().unwrap();
    for extension in ["ply", "spz", "sog"] {
        let target = folder.path().join(format!("angel.{extension}"));
        save(&scene, &target).unwrap();
        let after = info(&target);
        assert_eq!(after.gaussians, before.gaussians);
        for axis in 0..3 {
            assert!(
                (after.robust_bounds.min[axis] - before.robust_bounds.min[axis]).abs() < 1e-3,
                "{extension}"
            );
            assert!(
                (after.robust_bounds.max[axis] - before.robust_bounds.max[axis]).abs() < 1e-3,
                "{extension}"
            );
        }
        assert!((after.opacity.p50 - before.opacity.p50).abs() < 0.004, "{extension}");
        // SPZ stores log scales in steps of 1/16.
        assert!((after.largest_scale.p50 / before.largest_scale.p50).ln().abs() < 0.033, "{extension}");
    }
}
