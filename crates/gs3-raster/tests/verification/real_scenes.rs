//! The procedural demo scene, and trained captures where they are at hand.

use std::sync::Arc;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_scene::format::LoadOptions;
use gs3_scene::{Camera, CameraPath, GBuffer, Scene, capture, demo, format};

use crate::compare::{EVERYTHING, EXACT_CULLING, assert_identical, oracle, pairs};
use crate::scenes::Random;

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");

/// Scenes with a camera each: the demo, and the scenes of `../shared` that exist.
pub fn scenes() -> Vec<(&'static str, Arc<Scene>, Camera)> {
    paths().into_iter().map(|(name, scene, cameras)| (name, scene, cameras[0])).collect()
}

/// A scene with cameras.
type Path = (&'static str, Arc<Scene>, Vec<Camera>);

/// The same scenes with cameras from all over their paths.
pub fn paths() -> Vec<Path> {
    let mut all = vec![("demo", Arc::new(demo::scene().expect("valid")), spread(&demo::path()))];
    all.extend(captures(&[
        ("flowers", "flowers", "flowers_orbit.json"),
        ("guitar", "guitar.compressed.ply", "guitar_orbit.json"),
        ("playbot", "playbot", "playbot_orbit.json"),
    ]));
    all
}

/// A few cameras of `path`, evenly spread.
fn spread(path: &CameraPath) -> Vec<Camera> {
    let cameras = path.cameras();
    cameras.iter().step_by(cameras.len().div_ceil(3)).copied().collect()
}

/// Those captures of `../shared` that exist: of each its name, file and path of cameras.
pub fn captures(files: &[(&'static str, &str, &str)]) -> Vec<Path> {
    let mut all = Vec::new();
    for (name, file, path) in files {
        let file = std::path::Path::new(SHARED).join("scenes").join(file);
        let path = std::path::Path::new(SHARED).join("paths").join(path);
        if !(file.exists() && path.exists()) {
            eprintln!("skipped: {name}: {} is absent", file.display());
            continue;
        }
        let scene = format::load(&file, &LoadOptions::default(), &|_| ()).expect("a scene");
        all.push((*name, Arc::new(scene), spread(&capture::load(&path).expect("a path"))));
    }
    all
}

fn render(scene: &Arc<Scene>, culling: Culling, camera: &Camera, settings: &RasterSettings) -> GBuffer {
    let mut gbuffer = GBuffer::default();
    Rasterizer::new(Arc::clone(scene), culling)
        .rasterize(camera, settings, &mut gbuffer)
        .expect("valid settings");
    gbuffer
}

#[test]
fn exact_methods_agree_bit_for_bit() {
    for (name, scene, camera) in scenes() {
        for (width, height, dilation) in [(480, 270, matched_dilation(4)), (961, 543, 0.3)] {
            let camera = camera.resized(width, height).expect("a size");
            let settings = RasterSettings { dilation, ..EVERYTHING };
            let [snug, accu, exact] = EXACT_CULLING.map(|c| render(&scene, c, &camera, &settings));
            assert!(snug.alpha.data().iter().any(|a| *a > 0.5), "{name}: nothing in view");
            assert_identical(&snug, &accu, &format!("{name} {width}x{height}: SnugBox and AccuTile"));
            assert_identical(&snug, &exact, &format!("{name} {width}x{height}: SnugBox and Exact"));
        }
    }
}

/// Real scenes are thick with steps and thin splats, so a few pixels fall on the other side; the rest must agree.
#[test]
fn pixels_match_the_oracle() {
    for (name, scene, camera) in scenes() {
        let camera = camera.resized(480, 270).expect("a size");
        let settings =
            RasterSettings { outputs: Outputs::GBuffer, dilation: matched_dilation(4), ..EVERYTHING };
        let frame = render(&scene, Culling::AccuTile, &camera, &settings);
        let oracle = oracle(&scene, &camera, &settings);
        // Empty pixels agree trivially.
        let hit: Vec<usize> = (0..480 * 270).filter(|p| frame.alpha.data()[*p] > 0.1).collect();
        let mut random = Random(5);
        let mut errors: Vec<f64> = (0..150)
            .map(|_| hit[random.bits() as usize % hit.len()])
            .filter_map(|p| {
                let (i, j) = (p % 480, p / 480);
                let sample = oracle.pixel(i, j);
                let error = |c: usize| (f64::from(frame.color.row(c, j)[i]) - sample.color[c]).abs();
                (!sample.cut_offs.any()).then(|| error(0).max(error(1)).max(error(2)))
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
        eprintln!(
            "{name}: {} pixels, error median {:.1e}, 95 % {:.1e}, largest {:.1e}",
            errors.len(),
            at(0.5),
            at(0.95),
            at(1.0)
        );
        assert!(errors.len() > 50, "{name}: most pixels are near a cut-off");
        assert!(at(0.5) < 1e-5 && at(0.95) < 1e-4 && at(1.0) < 1.0 / 255.0, "{name}");
    }
}

/// What the published 3σ boxes lose on whole scenes, against the full support.
#[test]
fn three_sigma_methods_lose_little() {
    for (name, scene, camera) in scenes() {
        let camera = camera.resized(960, 540).expect("a size");
        let settings = RasterSettings { outputs: Outputs::Color, ..EVERYTHING };
        let full = render(&scene, Culling::Exact, &camera, &settings);
        for culling in [Culling::Aabb3Sigma, Culling::Adr] {
            let cut = render(&scene, culling, &camera, &settings);
            let squares: f64 =
                (full.color.data().iter().zip(cut.color.data())).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            let psnr = -10.0 * (squares / full.color.data().len() as f64).log10();
            eprintln!("{name}: {culling:?} is {psnr:.1} dB from the full support");
            assert!(psnr > 45.0 && psnr.is_finite(), "{name}: {culling:?}: {psnr} dB");
        }
    }
}

/// A matched, jittered low-resolution frame is every fourth native pixel.
#[test]
fn matched_low_resolution_samples_the_native_image() {
    for (name, scene, camera) in scenes() {
        let native_camera = camera.resized(1920, 1080).expect("a size");
        let native = render(
            &scene,
            Culling::AccuTile,
            &native_camera,
            &RasterSettings { outputs: Outputs::GBuffer, ..EVERYTHING },
        );
        let (a, b) = (2, 1);
        let settings = RasterSettings {
            outputs: Outputs::GBuffer,
            jitter: [(a as f32 - 1.5) / 4.0, (b as f32 - 1.5) / 4.0],
            dilation: matched_dilation(4),
            ..EVERYTHING
        };
        let low = render(&scene, Culling::AccuTile, &native_camera.low_resolution(4), &settings);
        for (l, n) in pairs(&low).iter().zip(pairs(&native)) {
            let factor = if l.name.starts_with("color_d") { 4.0 } else { 1.0 };
            let (mut squares, mut largest) = (0.0, 0.0_f64);
            for (i, v) in l.actual.iter().enumerate() {
                let (k, y, x) = (i / (480 * 270), i / 480 % 270 * 4 + b, i % 480 * 4 + a);
                let expected = factor * f64::from(n.actual[(k * 1080 + y) * 1920 + x]);
                squares += (f64::from(*v) - expected).powi(2);
                largest = largest.max(expected.abs());
            }
            let psnr = 10.0 * (largest.powi(2) * l.actual.len() as f64 / squares).log10();
            eprintln!("{name}: {} {psnr:.1} dB", l.name);
            // No pixel is excluded here: a few steps crossed by rounding are part of the figure.
            let floor = if matches!(l.name, "color" | "alpha") { 120.0 } else { 110.0 };
            assert!(psnr > floor, "{name}: {} {psnr:.1} dB", l.name);
        }
    }
}
