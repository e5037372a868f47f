//! `gs3 gbuffer`, `gs3 info` and `gs3 convert`.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::succeed;

/// The arrays of an archive: shape as written, values.
fn npz(file: &Path) -> BTreeMap<String, (String, Vec<f32>)> {
    let mut zip = zip::ZipArchive::new(std::fs::File::open(file).unwrap()).unwrap();
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
    assert_eq!(demo["opacity_percentiles"].as_array().unwrap().len(), 7);
    succeed(folder.path(), "convert demo scene.ply");
    let converted = info("scene.ply");
    for field in ["gaussians", "sh_degree", "opacity_mode"] {
        assert_eq!(demo[field], converted[field], "{field}");
    }
    let text = String::from_utf8_lossy(&succeed(folder.path(), "info scene.ply").stdout).into_owned();
    assert!(text.starts_with("scene.ply\n") && text.contains("SH degree 2"), "{text}");
}
