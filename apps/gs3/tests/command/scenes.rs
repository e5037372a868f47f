//! `gs3 gbuffer`, `gs3 info` and `gs3 convert`.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::Path;

use super::{gs3, names, refused, succeed};

/// The arrays of an archive: shape as written, values.
pub fn npz(file: &Path) -> BTreeMap<String, (String, Vec<f32>)> {
    let mut zip = zip::ZipArchive::new(fs::File::open(file).unwrap()).unwrap();
    let mut arrays = BTreeMap::new();
    for i in 0..zip.len() {
        let mut entry = zip.by_index(i).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10;
        let text = String::from_utf8_lossy(&bytes[10..header]).into_owned();
        let shape = text.split("'shape': ").nth(1).unwrap().trim().trim_end_matches(", }").to_owned();
        let values =
            bytes[header..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        arrays.insert(entry.name().unwrap().trim_end_matches(".npy").to_owned(), (shape, values));
    }
    arrays
}

#[test]
fn gbuffer_planes_are_numpy_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, "gbuffer demo --frame 5 --size 80x45 --mixed --out g.npz");
    let arrays = npz(&at.join("g.npz"));
    let expected = "alpha color color_dx color_dxy color_dy depth_expected depth_median normal";
    assert_eq!(arrays.keys().cloned().collect::<Vec<_>>().join(" "), expected);
    assert_eq!(arrays["color"].0, "(45,80,3,)");
    assert_eq!(arrays["alpha"].0, "(45,80,)");
    assert_eq!(arrays["color"].1.len(), 45 * 80 * 3);
    assert!(arrays["alpha"].1.iter().all(|a| (0.0..=1.0).contains(a)));

    // Moving the samples by h changes the colour by h times the gradient, colour by colour: the axes and the order
    // within [H, W, 3] are right.
    succeed(at, "gbuffer demo --frame 5 --size 80x45 --jitter -0.01,0 --out left.npz");
    succeed(at, "gbuffer demo --frame 5 --size 80x45 --jitter 0.01,0 --out right.npz");
    let (left, right) = (npz(&at.join("left.npz")), npz(&at.join("right.npz")));
    assert!(!left.contains_key("color_dxy"));
    let slopes = left["color"].1.iter().zip(&right["color"].1).map(|(l, r)| (r - l) / 0.02);
    let close =
        slopes.zip(&arrays["color_dx"].1).filter(|(s, dx)| (s - **dx).abs() <= 0.02 + 0.1 * dx.abs()).count();
    assert!(close as f64 > 0.8 * arrays["color"].1.len() as f64, "{close} of {}", arrays["color"].1.len());
}

#[test]
fn info_counts_and_converting_keeps_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let info = |scene: &str| -> serde_json::Value {
        serde_json::from_slice(&succeed(folder.path(), &format!("info {scene} --json")).stdout).unwrap()
    };
    let demo = info("demo");
    assert!(demo["gaussians"].as_u64().unwrap() >= 300_000);
    assert_eq!(demo["dropped"]["total"], 0);
    assert!(demo["opacity"]["p5"].as_f64().unwrap() < demo["opacity"]["p95"].as_f64().unwrap());
    assert!(demo["bulk"]["radius"].as_f64().unwrap() > 0.0);
    succeed(folder.path(), "convert demo scene.ply");
    let converted = info("scene.ply");
    for field in ["gaussians", "sh_degree", "opacity_mode"] {
        assert_eq!(demo[field], converted[field], "{field}");
    }
    let text = String::from_utf8_lossy(&succeed(folder.path(), "info scene.ply").stdout).into_owned();
    assert!(text.starts_with("scene.ply\n") && text.contains("SH degree 2"), "{text}");
}

/// A streamed scene: level 0 with three Gaussians, level 1 with one of them, and an environment of two.
fn streamed(at: &Path) {
    let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let fields: String = fields.split(' ').map(|field| format!("property float {field}\n")).collect();
    for (name, count) in [("fine", 3), ("coarse", 1), ("sky", 2)] {
        let gaussians: String = (0..count).map(|k| format!("{k} 0 1 0 0 0 2 -5 -5 -5 1 0 0 0\n")).collect();
        let ply = format!("ply\nformat ascii 1.0\nelement vertex {count}\n{fields}end_header\n{gaussians}");
        fs::write(at.join("one.ply"), ply).unwrap();
        succeed(at, &format!("convert one.ply streamed/{name}.sog"));
    }
    let index = r#"{"lodLevels": 2, "environment": "sky.sog", "filenames": ["fine.sog", "coarse.sog"], "tree":
        {"children": [{"lods": {"0": {"file": 0, "offset": 0, "count": 3}, "1": {"file": 1, "offset": 0, "count": 1}}}]}}"#;
    fs::write(at.join("streamed/lod-meta.json"), index).unwrap();
}

#[test]
fn a_streamed_scene_is_written_once() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, "convert demo parts/lod-meta.json --lod-chunk-count 100");
    let facts: serde_json::Value = serde_json::from_slice(&succeed(at, "info parts --json").stdout).unwrap();
    let count = facts["gaussians"].as_u64().unwrap();
    // Halved until no part has more than 100,000.
    let parts = names(&at.join("parts"));
    let halvings = (count as f64 / 1e5).log2().ceil().exp2() as usize;
    assert_eq!(parts.len(), halvings + 1, "{count} Gaussians: {parts:?}");
    let expected = "error: OUTPUT: expected a folder without a streamed scene, found parts/lod-meta.json, which is there already\n";
    assert_eq!(refused(&mut gs3(at, "convert demo parts/lod-meta.json")), expected);
    assert_eq!(names(&at.join("parts")), parts);
}

#[test]
fn levels_and_environments_of_streamed_scenes_are_chosen() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    streamed(at);
    let info = |scene: &str| -> serde_json::Value {
        serde_json::from_slice(&succeed(at, &format!("info {scene} --json")).stdout).unwrap()
    };
    for (options, gaussians) in [
        ("", 5),
        ("--lod 0", 5),
        ("--lod 1", 3),
        ("--environment off", 3),
        ("--lod 0 --environment on", 5),
        ("--lod 1 --environment off", 1),
    ] {
        for scene in ["streamed", "streamed/lod-meta.json"] {
            let facts = info(&format!("{scene} {options}"));
            assert_eq!(facts["gaussians"], gaussians, "{scene} {options}");
            assert_eq!((&facts["levels"], &facts["has_environment"]), (&2.into(), &true.into()));
        }
    }
    let text = String::from_utf8_lossy(&succeed(at, "info streamed").stdout).into_owned();
    assert!(text.contains("\n  levels          2, and an environment\n"), "{text}");
    assert_eq!(info("one.ply").get("levels"), None);

    let level = "--lod 1 --environment off";
    succeed(at, &format!("convert streamed few.ply {level}"));
    assert_eq!(info("few.ply")["gaussians"], 1);
    for (command, expected) in [
        (
            format!(
                "render streamed --size 16x9 --frames 0..1 --tier analytic {level} --out o --json r.json"
            ),
            1,
        ),
        ("render streamed --size 16x9 --frames 0..1 --tier analytic --out o --json r.json".to_owned(), 5),
    ] {
        succeed(at, &command);
        assert_eq!(super::json(&at.join("r.json"))["gaussians"], expected, "{command}");
    }
    succeed(at, &format!("gbuffer streamed --size 16x9 {level} --out g.npz"));
    succeed(at, &format!("bench streamed --size 16x9 --frames 0..1 --tier analytic {level}"));
    succeed(at, &format!("evaluate streamed --size 32x16 --frames 0..3 --methods bicubic {level} --out e"));
    let simplified = succeed(at, &format!("simplify streamed --size 16x9 --keep 1 {level} --out s.ply"));
    assert!(simplified.stdout.starts_with(b"1 of 1 Gaussians"));

    for (command, expected) in [
        ("info streamed --lod 2", "level of detail: expected a level below 2, the number of levels, found 2"),
        ("info one.ply --lod 0", "--lod: expected a streamed scene (lod-meta.json), which has levels and an"),
        ("info one.ply --environment on", "--environment: expected a streamed scene"),
        ("render demo --lod 0 --out p", "--lod: expected a streamed scene"),
    ] {
        let said = refused(&mut gs3(at, command));
        assert!(said.contains(expected), "{command}: {said}");
    }
}

/// Bounds and sizes of a scene may be of any magnitude; a line of them stays readable.
#[test]
fn info_is_readable_whatever_the_magnitudes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let fields: String = fields.split(' ').map(|field| format!("property float {field}\n")).collect();
    let gaussian = |x: &str, log_scale: &str| format!("{x} 0 1 0 0 0 2 {log_scale} -5 -5 1 0 0 0\n");
    let gaussians = [gaussian("-1e29", "-14"), gaussian("1e29", "-14")].concat();
    let ply = format!("ply\nformat ascii 1.0\nelement vertex 2\n{fields}end_header\n{gaussians}");
    fs::write(at.join("far.ply"), ply).unwrap();
    let text = String::from_utf8_lossy(&succeed(at, "info far.ply").stdout).into_owned();
    assert!(text.contains("bounds          -1.000e29, 0, 1.000  to  1.000e29, 0, 1.000\n"), "{text}");
    assert!(text.contains("smallest scale  8.315e-7  "), "{text}");
}
