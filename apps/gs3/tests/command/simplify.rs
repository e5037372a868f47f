//! `gs3 simplify`.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use gs3::Culling;
use gs3::raster::{Outputs, RasterSettings, Rasterizer};
use gs3::scene::{Image, Scene, demo};
use gs3_evaluate::metrics::{Quantisation, psnr};
use gs3_evaluate::simplify::sample;

use super::{gs3, names, refused, succeed};

/// A fifth of the demo's Gaussians shows this much, a random fifth far less, dB. Found: 24.7, and 12.9 at random.
const FIFTH_BOUND: f64 = 22.0;

/// More than half of the demo is never seen by these cameras, so its better half shows the same but for contributions
/// that make no difference, dB. Found: 121, and 22.3 at random.
const HALF_BOUND: f64 = 60.0;

/// What the command says: Gaussians kept, of all, mean and lowest PSNR in dB.
fn simplify(folder: &Path, options: &str) -> [f64; 4] {
    let output = succeed(folder, &format!("simplify demo --size 320x180 --frames 0..6 {options}"));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let numbers: Vec<f64> = text.split_ascii_whitespace().filter_map(|word| word.parse().ok()).collect();
    // Such as: 106602 of 533008 Gaussians kept (20.0 %), PSNR against all 25.33 dB on average, 24.74 dB at least
    // The share is no word of its own, so four numbers are found.
    numbers.try_into().unwrap_or_else(|numbers| panic!("{text}: {numbers:?}"))
}

fn count(folder: &Path, scene: &str) -> f64 {
    let output = succeed(folder, &format!("info {scene} --json"));
    serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()["gaussians"].as_f64().unwrap()
}

/// PSNR in dB of `test` against the demo, in the first of the views that [`simplify`] uses.
fn psnr_against_demo(test: Scene) -> f64 {
    let camera = demo::path().resized(320, 180).unwrap().cameras()[0];
    let [reference, test] = [demo::scene().unwrap(), test].map(|scene| {
        let mut image = Image::default();
        Rasterizer::new(Arc::new(scene), Culling::AccuTile)
            .rasterize_image(&camera, &RasterSettings::new(Outputs::Color), &mut image)
            .unwrap();
        image
    });
    psnr(&reference, &test, Quantisation::None).unwrap()
}

fn random_part(keep: f64) -> Scene {
    let mut gaussians = demo::scene().unwrap().into_gaussians();
    let all = gaussians.len();
    let chosen = sample(&vec![1.0; all], (keep * all as f64) as usize, 5);
    let mut is_chosen = vec![false; all];
    chosen.into_iter().for_each(|i| is_chosen[i] = true);
    gaussians.retain(|_, i| is_chosen[i]);
    Scene::new(gaussians, Default::default()).unwrap()
}

#[test]
fn the_gaussians_that_matter_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (keep, bound) in [(0.5, HALF_BOUND), (0.2, FIFTH_BOUND)] {
        let [kept, all, mean, lowest] = simplify(at, &format!("--keep {keep} --out part.ply"));
        assert_eq!(kept, (keep * all).round());
        assert_eq!((count(at, "part.ply"), count(at, "demo")), (kept, all));
        assert!(mean >= lowest && lowest > bound, "{keep}: {mean} dB, {lowest} dB");
        let part = gs3::open(at.join("part.ply")).unwrap();
        let (own, random) = (psnr_against_demo(part), psnr_against_demo(random_part(keep)));
        assert!(own >= lowest - 1.0 && own > bound, "{keep}: {own} dB, said {lowest} dB");
        assert!(random < bound - 5.0, "{keep}: {random} dB at random: the bound says nothing");
    }
}

#[test]
fn mini_splatting_draws_by_seed_from_what_is_dominant_somewhere() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mini = |options: &str, out: &str| {
        let said = simplify(at, &format!("--by mini-splatting {options} --out {out}.ply"));
        (said, fs::read(at.join(format!("{out}.ply"))).unwrap())
    };
    let ([kept, all, mean, _], bytes) = mini("--keep 0.05 --threads 1", "one");
    assert_eq!(kept, (0.05 * all).round());
    assert!(bytes == mini("--keep 0.05 --threads 3", "again").1, "the same for any number of threads");
    assert!(bytes != mini("--keep 0.05 --seed 1", "seed").1);
    assert!(bytes != mini("--keep 0.05 --indoor", "indoor").1);
    let [fewer, .., cut_mean, _] = mini("--keep 0.05 --mass 0.9", "mass").0;
    assert!(fewer < 0.95 * kept && cut_mean < mean, "{fewer} of {kept}, {cut_mean} dB of {mean} dB");
    // Six views of 57,600 pixels have no more dominant Gaussians.
    let [most, _, all_mean, _] = mini("--keep 1", "most").0;
    assert!(
        most < 6.0 * 57_600.0 && most > kept && all_mean > mean + 3.0,
        "{most}, {all_mean} dB of {mean} dB"
    );
}

#[test]
fn bad_input_gets_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("file"), "not a folder").unwrap();
    // Far above the demo, looking up.
    let away = r#"{"fl_x": 50, "w": 64, "h": 36, "frames": [
        {"transform_matrix": [[1,0,0,0],[0,-1,0,0],[0,0,-1,9999],[0,0,0,1]]}]}"#;
    fs::write(at.join("away.json"), away).unwrap();
    let cases = [
        ("--keep 0 --out o.ply", "keep: expected a number above 0 and at most 1, found 0"),
        ("--keep 1.5 --out o.ply", "found 1.5"),
        ("--keep -1 --out o.ply", "found -1"),
        ("--keep nan --out o.ply", "found NaN"),
        ("--keep half --out o.ply", "half"),
        ("--keep 0.5 --by mini-splatting --mass 2 --out o.ply", "mass: expected"),
        ("--keep 0.5 --by size --out o.ply", "size"),
        ("--keep 0.5 --frames 0..9999 --out o.ply", "--frames: expected frames within 0..240"),
        (
            "--keep 0.5 --frames 0..1 --out o.xyz",
            "expected .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json",
        ),
        ("--keep 0.5 --frames 0..1 --out file/o.ply", "file/o.ply"),
        ("--keep 0.5 --cameras nowhere.json --out o.ply", "nowhere.json"),
        ("--keep 0.5 --cameras away.json --out o.ply", "Gaussians to be seen by 1 cameras, found 0"),
    ];
    let before = names(at);
    for (options, expected) in cases {
        let said = refused(&mut gs3(at, &format!("simplify demo --size 64x36 {options}")));
        assert!(said.contains(expected), "{options}: {said}");
        assert_eq!(names(at), before, "{options} leaves nothing");
    }
}
