//! What is saved is what is loaded, within the format's precision.

use std::path::Path;

use gs3_scene::format::{
    Clamped, LoadOptions, SaveError, SaveOptions, SpzVersion, clamped, load, losses, save, save_with, write,
};
use gs3_scene::glam::DVec3;
use gs3_scene::{Details, Gaussians, OpacityMode, Scene};
use proptest::prelude::*;
use proptest::test_runner::Config;

/// A number in ±1 that looks random.
pub fn noise(seed: u64, i: usize, k: usize) -> f32 {
    let mut x = seed ^ (i as u64) << 32 ^ k as u64;
    for _ in 0..3 {
        x = (x ^ x >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    (x >> 40) as f32 / (1 << 23) as f32 - 1.0
}

pub fn scene(seed: u64, count: usize, degree: u8, mode: OpacityMode) -> Scene {
    let mut gaussians = Gaussians::zeroed(count, degree);
    let stride = gaussians.sh_stride();
    for i in 0..count {
        for axis in 0..3 {
            gaussians.means[axis][i] = noise(seed, i, axis) * 10.0;
            gaussians.scales[axis][i] = (noise(seed, i, 3 + axis) * 4.0 - 4.0).exp();
        }
        for component in 0..4 {
            gaussians.rotations[component][i] = noise(seed, i, 6 + component);
        }
        gaussians.opacities[i] = noise(seed, i, 10).abs();
        for k in 0..stride {
            gaussians.sh[i * stride + k] = noise(seed, i, 11 + k) * 0.9;
        }
    }
    Scene::new(gaussians, mode).unwrap()
}

fn round_trip(scene: &Scene, extension: &str) -> Scene {
    round_trip_with(scene, extension, &SaveOptions::default())
}

fn round_trip_with(scene: &Scene, extension: &str, options: &SaveOptions) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("scene.{extension}"));
    save_with(scene, &path, options).unwrap();
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), 1, "more than the target was left: {left:?}");
    load(&path, &LoadOptions::default(), &|_| {}).unwrap()
}

/// Tolerances of a format.
#[derive(Clone, Copy)]
pub struct Tolerance {
    pub mean: f32,
    /// Of the logarithm.
    pub scale: f32,
    /// Angle between rotations.
    pub radians: f32,
    pub opacity: f32,
    /// Constant term.
    pub sh0: f32,
    /// Higher terms.
    pub sh: f32,
}

/// Gaussian `i` of `before` against Gaussian `partner(i)` of `after`.
#[track_caller]
pub fn compare(before: &Scene, after: &Scene, tolerance: &Tolerance, partner: impl Fn(usize) -> usize) {
    compare_with(before, after, tolerance, partner, |_| 1.0);
}

/// The same, where what has codebooks may be off by `slack(i)` times as much.
#[track_caller]
pub fn compare_with(
    before: &Scene,
    after: &Scene,
    tolerance: &Tolerance,
    partner: impl Fn(usize) -> usize,
    slack: impl Fn(usize) -> f32,
) {
    let (a, b) = (before.gaussians(), after.gaussians());
    assert_eq!((a.len(), a.sh_degree, before.opacity_mode()), (b.len(), b.sh_degree, after.opacity_mode()));
    for i in 0..a.len() {
        let j = partner(i);
        for axis in 0..3 {
            let (x, y) = (a.mean(i)[axis], b.mean(j)[axis]);
            assert!((x - y).abs() <= tolerance.mean * x.abs().max(1.0), "mean {x} came back as {y}");
            let (x, y) = (a.scale(i)[axis].ln(), b.scale(j)[axis].ln());
            assert!((x - y).abs() <= tolerance.scale * slack(i), "log scale {x} came back as {y}");
        }
        let angle = angle(a.rotation(i), b.rotation(j));
        assert!(angle <= tolerance.radians, "rotation of {i} is off by {angle} radians");
        let (x, y) = (a.opacities[i], b.opacities[j]);
        assert!((x - y).abs() <= tolerance.opacity, "opacity {x} came back as {y}");
        for (k, (x, y)) in a.sh_of(i).iter().zip(b.sh_of(j)).enumerate() {
            let allowed = if k < 3 { tolerance.sh0 } else { tolerance.sh };
            assert!((x - y).abs() <= allowed * slack(i), "SH value {k} of {i}: {x} came back as {y}");
        }
    }
}

/// The angle between two ellipsoids' rotations. Principal axes have no signs: half a turn about one is none.
fn angle(a: [f32; 4], [w, x, y, z]: [f32; 4]) -> f32 {
    let turned = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
    let dots = turned.map(|b| a.iter().zip(b).map(|(x, y)| x * y).sum::<f32>().abs());
    2.0 * dots.into_iter().fold(0.0, f32::max).min(1.0).acos()
}

/// Exact but for the rounding of exp, ln and the sigmoid; acos near 1 turns 1e-7 into 1e-3.
pub const PLY: Tolerance =
    Tolerance { mean: 0.0, scale: 2e-6, radians: 2e-3, opacity: 1e-6, sh0: 0.0, sh: 0.0 };

/// 24 bits for ±10: 2⁻¹⁹ of the unit at most; log scale in steps of 1/16; 9 bits of √½ per component; 8 bits
/// else.
pub const SPZ: Tolerance =
    Tolerance { mean: 1e-6, scale: 0.0313, radians: 0.006, opacity: 0.00197, sh0: 0.0132, sh: 0.0040 };

/// 16 bits for the logarithm of ±10: 2 · ln 11 / 65,535 / 2 relative to 1 + |x|. 8 bits of √2 per component,
/// three of them and the fourth made of them: 2 · 0.0096. Codebooks of 256 for up to 1,200 values: those that
/// share a code lie within three of the mean gaps (8 / 256 for log scales, 1.8 / 256 for colours; 2.2 were seen, once
/// in some hundred scenes). Palette rows of their own.
pub const SOG: Tolerance =
    Tolerance { mean: 1e-4, scale: 0.094, radians: 0.02, opacity: 0.00197, sh0: 0.021, sh: 0.021 };

/// Exact but for signs; acos as above.
pub const GLB: Tolerance =
    Tolerance { mean: 0.0, scale: 0.0, radians: 2e-3, opacity: 0.0, sh0: 0.0, sh: 0.0 };

/// 8 bits for colours over ½ / 0.282 on each side, for opacity and for each component of the rotation.
const SPLAT: Tolerance =
    Tolerance { mean: 0.0, scale: 1e-6, radians: 0.02, opacity: 0.00197, sh0: 0.0070, sh: 0.0 };

/// Within a chunk of ±10: 11 and 10 bits of 20 for positions and of 8 for log scales; 10 bits of √2 per component of the
/// rotation; 8 bits of 0.51 / 0.282 for colours; 8 bits of ±4 for harmonics.
pub const COMPRESSED_PLY: Tolerance =
    Tolerance { mean: 0.0101, scale: 0.0040, radians: 0.006, opacity: 0.00197, sh0: 0.0036, sh: 0.0157 };

proptest! {
    #![proptest_config(Config { cases: 24, failure_persistence: None, ..Config::default() })]

    #[test]
    fn ply(seed: u64, count in 1usize..600, degree in 0u8..5, antialiased: bool) {
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        let before = scene(seed, count, degree, mode);
        compare(&before, &round_trip(&before, "ply"), &PLY, |i| i);
    }

    #[test]
    fn spz(seed: u64, count in 1usize..600, degree in 0u8..5, antialiased: bool, is_old: bool) {
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        let before = scene(seed, count, degree.min(if is_old { 3 } else { 4 }), mode);
        let spz_version = if is_old { SpzVersion::Three } else { SpzVersion::Four };
        let after = round_trip_with(&before, "spz", &SaveOptions { spz_version, ..SaveOptions::default() });
        compare(&before, &after, &SPZ, |i| i);
    }

    #[test]
    fn glb(seed: u64, count in 1usize..600, degree in 0u8..5) {
        let before = scene(seed, count, degree, OpacityMode::Default);
        compare(&before, &round_trip(&before, "glb"), &GLB, |i| i);
    }

    #[test]
    fn splat(seed: u64, count in 1usize..600) {
        let before = scene(seed, count, 0, OpacityMode::Default);
        compare(&before, &round_trip(&before, "splat"), &SPLAT, |i| i);
    }

    #[test]
    fn compressed_ply(seed: u64, count in 1usize..600, degree in 0u8..5, antialiased: bool) {
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        let before = scene(seed, count, degree, mode);
        let after = round_trip(&before, "compressed.ply");
        compare(&before, &after, &COMPRESSED_PLY, |i| nearest(&after, before.gaussians().mean(i)));
    }

    #[test]
    fn sog(seed: u64, count in 1usize..400, degree in 0u8..4, antialiased: bool) {
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        let before = scene(seed, count, degree, mode);
        let after = round_trip(&before, "sog");
        compare_with(&before, &after, &SOG, |i| nearest(&after, before.gaussians().mean(i)), sog_slack(&before));
    }
}

/// How much wider the codes of a SOG's codebooks may lie for Gaussians that show less than the mean: their density goes
/// with the cube root of the weight, the square of opacity times area, of which each counts a thousandth of the mean at
/// least.
pub fn sog_slack(scene: &Scene) -> impl Fn(usize) -> f32 {
    let gaussians = scene.gaussians();
    let shown = |i: usize| {
        let [a, b, c] = gaussians.scale(i);
        gaussians.opacities[i].powi(2) * (a * b).max(b * c).max(c * a)
    };
    let weights: Vec<f32> = (0..gaussians.len()).map(shown).collect();
    let mean = weights.iter().sum::<f32>() / weights.len() as f32;
    move |i| (mean / weights[i].max(1e-3 * mean)).cbrt().max(1.0)
}

/// SOG reorders: the partner is the nearest Gaussian.
pub fn nearest(scene: &Scene, mean: [f32; 3]) -> usize {
    let distance = |i: &usize| {
        let other = scene.gaussians().mean(*i);
        (0..3).map(|axis| (other[axis] - mean[axis]).powi(2)).sum::<f32>()
    };
    (0..scene.gaussians().len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

#[test]
fn a_palette_smaller_than_the_scene_keeps_the_harmonics_close() {
    // 100,000 Gaussians of 1,000 kinds that differ by a little: 65,536 rows must find them.
    let count = 100_000;
    let mut gaussians = Gaussians::zeroed(count, 1);
    for i in 0..count {
        gaussians.means[0][i] = i as f32;
        gaussians.rotations[0][i] = 1.0;
        for k in 0..9 {
            gaussians.sh[i * 12 + 3 + k] = noise(1, i % 1000, k) + 0.001 * noise(2, i, k);
        }
    }
    let before = Scene::new(gaussians, OpacityMode::Default).unwrap();
    let after = round_trip(&before, "sog");
    // A line along x in logarithmic 16-bit steps: neighbours share codes, so compare by the order that the
    // curve keeps.
    let mut squared = 0.0;
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| after.gaussians().mean(*a)[0].total_cmp(&after.gaussians().mean(*b)[0]));
    for (i, j) in order.into_iter().enumerate() {
        let (a, b) = (before.gaussians().sh_of(i), after.gaussians().sh_of(j));
        squared += a.iter().zip(b).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>();
    }
    let error = (squared / (count * 9) as f64).sqrt();
    assert!(error < 0.01, "root mean square error {error}");
}

#[test]
fn limits_of_the_values() {
    let mut gaussians = Gaussians::zeroed(3, 0);
    gaussians.rotations[2] = vec![1.0; 3];
    gaussians.opacities = vec![0.0, 1.0, 0.5];
    gaussians.means[1] = vec![-3000.0, 5000.0, 0.0];
    gaussians.sh = vec![-30.0, 0.0, 30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let before = Scene::new(gaussians, OpacityMode::Default).unwrap();
    for extension in ["ply", "spz", "sog", "glb", "compressed.ply"] {
        let after = round_trip(&before, extension);
        assert_eq!(after.gaussians().len(), 3, "{extension}");
        for i in 0..3 {
            let mean = before.gaussians().mean(i);
            let j = nearest(&after, mean);
            // A 10-bit step of 8,000 in compressed PLY.
            assert!((after.gaussians().mean(j)[1] - mean[1]).abs() < 4.0, "{extension}: {mean:?}");
            let (x, y) = (before.gaussians().opacities[i], after.gaussians().opacities[j]);
            assert!((x - y).abs() < 0.003, "{extension}: opacity {x} came back as {y}");
            assert!(after.gaussians().scale(j).iter().all(|scale| *scale < 1e-4), "{extension}");
        }
    }
}

/// SPZ tells of each Gaussian that it changes by more than rounding, and of no other.
#[test]
fn what_spz_cuts_is_counted() {
    let path = Path::new("scene.spz");
    // Version 3 has other signs of y and z.
    let old = SaveOptions { spz_version: SpzVersion::Three, ..SaveOptions::default() };
    assert_eq!(clamped(&scene(3, 5000, 3, OpacityMode::Default), path, &old), None);
    let mut gaussians = Gaussians::zeroed(9, 1);
    gaussians.rotations[0] = vec![1.0; 9];
    for plane in &mut gaussians.scales {
        plane.fill(1.0);
    }
    // e^5.9375 is the largest; what rounds to it is no loss. Nor is a flat Gaussian, but one that is a point.
    (gaussians.scales[1][0], gaussians.scales[2][1], gaussians.scales[0][2]) = (390.0, 400.0, 1e6);
    gaussians.scales[2][3] = 0.0;
    for plane in &mut gaussians.scales {
        plane[4] = 1e-6;
    }
    let coefficient = |i: usize, k: usize| i * 12 + k;
    // ½ / 0.15 is the largest constant term.
    (gaussians.sh[coefficient(5, 0)], gaussians.sh[coefficient(6, 2)]) = (3.33, -3.4);
    // The sign of y and z is changed: −1 becomes 1, which is 256 of 255.
    (gaussians.sh[coefficient(7, 3)], gaussians.sh[coefficient(8, 11)]) = (1.0, 1.5);
    gaussians.sh[coefficient(2, 3)] = 30.0;
    let scene = Scene::new(gaussians, OpacityMode::Default).unwrap();
    let counted = clamped(&scene, path, &old).unwrap();
    assert_eq!(counted, Clamped { scales: 3, sh: 3 });
    assert_eq!(
        counted.to_string(),
        "3 Gaussians are larger than 379, or smaller than 4.5e-5 on every axis, and 3 Gaussians have spherical harmonics \
         outside ±1 (constant terms ±3.33): they are cut to that"
    );
    // In version 4 nothing is turned: of coefficient 7 a 1 is 256 of 255, too.
    assert_eq!(clamped(&scene, path, &SaveOptions::default()).unwrap().sh, 4);
    for other in ["scene.ply", "scene.sog", "scene"] {
        assert_eq!(clamped(&scene, Path::new(other), &old), None);
    }
    // The counts are those of what comes back changed.
    let after = round_trip_with(&scene, "spz", &old);
    let is_scale_off = |i: &usize| {
        let pairs = scene.gaussians().scale(*i).into_iter().zip(after.gaussians().scale(*i));
        pairs.into_iter().any(|(a, b)| a > 1e-9 && (a / b).ln().abs() > 0.04)
    };
    let is_sh_off = |i: &usize| {
        let pairs = scene.gaussians().sh_of(*i).iter().zip(after.gaussians().sh_of(*i));
        pairs.into_iter().any(|(a, b)| (a - b).abs() > 0.02)
    };
    assert_eq!((0..9).filter(is_scale_off).count(), 3);
    assert_eq!((0..9).filter(is_sh_off).count(), 3);
}

#[test]
fn what_cannot_be_saved_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(1, 3, 0, OpacityMode::Default);
    let error = save(&scene, folder.path().join("scene.obj")).unwrap_err();
    assert!(matches!(&error, SaveError::UnknownFormat { actual, .. } if actual == "obj"), "{error}");
    let error = save(&scene, Path::new("/nowhere/at/all/scene.ply")).unwrap_err();
    assert!(matches!(error, SaveError::Io { .. }), "{error}");
    let mut gaussians = scene.into_gaussians();
    gaussians.means[0][0] = 1e30;
    let far = Scene::new(gaussians, OpacityMode::Default).unwrap();
    let error = save(&far, folder.path().join("scene.spz")).unwrap_err();
    assert!(error.to_string().contains("position"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// A scene far from 0 keeps its places: exactly in formats of double precision, as far as f32 goes in others, aloud.
#[test]
fn far_scenes_keep_their_places() {
    let origin = DVec3::new(500_000.0, -4.5e6, 300.0);
    let near = scene(4, 300, 1, OpacityMode::Default);
    let before = near.with_details(Details { origin, up: Some(DVec3::Z), ..Details::default() });
    for (extension, tolerance, is_told) in [
        ("ply", 5e-5, false),
        ("glb", 5e-5, false),
        ("sog", 0.1, false),
        ("compressed.ply", 0.6, true),
        ("splat", 0.6, true),
    ] {
        let after = round_trip(&before, extension);
        let place = |scene: &Scene, i: usize| {
            DVec3::from(scene.gaussians().mean(i).map(f64::from)) + scene.details().origin
        };
        for i in 0..300 {
            let wanted = place(&before, i);
            let off = (0..300)
                .map(|j| (place(&after, j) - wanted).abs().max_element())
                .fold(f64::INFINITY, f64::min);
            assert!(off <= tolerance, "{extension}: {wanted} is off by {off}");
        }
        let up = extension.ends_with("ply").then_some(DVec3::Z);
        assert_eq!(after.details().up, up, "{extension}");
        let path = format!("scene.{extension}");
        let told = losses(&before, &path).iter().any(|loss| loss.contains("positions"));
        assert_eq!(told, is_told, "{extension}: {:?}", losses(&before, &path));
    }
}

#[test]
fn what_a_format_cannot_hold_is_told_or_refused() {
    let antialiased = scene(5, 10, 4, OpacityMode::Antialiased);
    assert!(losses(&antialiased, "s.ply").is_empty() && losses(&antialiased, "s.spz").is_empty());
    assert!(losses(&antialiased, "s.glb")[0].contains("antialiased"));
    assert_eq!(losses(&antialiased, "s.splat").len(), 2);
    let folder = tempfile::tempdir().unwrap();
    let options = SaveOptions { spz_version: SpzVersion::Three, ..SaveOptions::default() };
    let error = save_with(&antialiased, folder.path().join("s.spz"), &options).unwrap_err().to_string();
    assert!(error.contains("SH degree: expected at most 3, found 4"), "{error}");
    let error = save(&antialiased, folder.path().join("s.sog")).unwrap_err().to_string();
    assert!(error.contains("SH degree: expected at most 3, found 4"), "{error}");
}

/// Written to memory, a scene has the bytes of its file.
#[test]
fn writing_to_memory_is_saving() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(5, 300, 2, OpacityMode::Default);
    for name in ["a.ply", "a.compressed.ply", "a.splat", "a.glb", "a.spz", "a.sog"] {
        let file = folder.path().join(name);
        save(&scene, &file).unwrap();
        let mut memory = std::io::Cursor::new(Vec::new());
        write(&scene, name, &SaveOptions::default(), &mut memory).unwrap();
        assert!(memory.into_inner() == std::fs::read(&file).unwrap(), "{name}");
    }
    let mut memory = std::io::Cursor::new(Vec::new());
    let error = write(&scene, "lod-meta.json", &SaveOptions::default(), &mut memory).unwrap_err();
    assert_eq!(error.to_string(), "lod-meta.json: format: expected a format of one file, found streamed SOG");
}
