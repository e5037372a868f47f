//! Files that PlayCanvas' splat-transform reads and writes, an implementation independent of this one: its files of a
//! scene are read as its PLY, and ours are read by it as ours.
//!
//! Needs the program: `SPLAT_TRANSFORM` is its command line, as `.ci/run` sets it.

use std::path::Path;
use std::process::Command;

use gs3_scene::format::{LoadOptions, SaveOptions, SpzVersion, load, save, save_with};
use gs3_scene::{Axes, OpacityMode, Scene};

use crate::round_trip::{COMPRESSED_PLY, GLB, PLY, SOG, SPZ, Tolerance, compare, nearest, scene};

/// Runs the program in `folder`, where there is one.
fn splat_transform(folder: &Path, arguments: &[&str]) -> bool {
    let Ok(command) = std::env::var("SPLAT_TRANSFORM") else {
        eprintln!("skipped: SPLAT_TRANSFORM names no splat-transform");
        return false;
    };
    let mut words = command.split_ascii_whitespace();
    let program = words.next().expect("SPLAT_TRANSFORM names a program");
    let output = Command::new(program).args(words).args(arguments).current_dir(folder).output().unwrap();
    let said =
        String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "splat-transform {arguments:?}: {said}");
    true
}

fn read(path: impl AsRef<Path>) -> Scene {
    load(path, &LoadOptions::default(), &|_| {}).unwrap()
}

/// Scenes of several degrees, no Gaussians at one place, so that partners are told by their positions.
fn scenes() -> impl Iterator<Item = Scene> {
    [0, 1, 3].into_iter().map(|degree| {
        let mut gaussians = scene(u64::from(degree) + 77, 700, degree, OpacityMode::Default).into_gaussians();
        // Its WebP encoder forgets colours where the opacity beside them is 0.
        gaussians.opacities.iter_mut().for_each(|opacity| *opacity = opacity.max(0.01));
        Scene::new(gaussians, OpacityMode::Default).unwrap()
    })
}

/// Coarser harmonics than ours: its SPZ rounds them to 5 and 4 bits, its palette has fewer rows. Its positions have 12
/// bits after the binary point: half a step is 1.2e-4.
const THEIR_SPZ: Tolerance = Tolerance { sh: 0.07, mean: 1.3e-4, ..SPZ };
/// Its SOG cuts positions to 16 bits, opacities and rotations to 8 where ours rounds: whole steps, 2 · ln 11 / 65,535
/// relative to 1 + |x|, 1 / 255, and twice what ours are off.
const THEIR_SOG: Tolerance = Tolerance { sh: 2.0, mean: 1.5e-4, opacity: 0.00393, radians: 0.04, ..SOG };

#[test]
fn its_files_are_read_as_its_ply() {
    for before in scenes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        save(&before, at("s.ply")).unwrap();
        for (arguments, name, tolerance) in [
            (&["-w", "s.ply", "a.spz"][..], "a.spz", &THEIR_SPZ),
            (&["-w", "--spz-version", "3", "s.ply", "b.spz"], "b.spz", &THEIR_SPZ),
            (&["-w", "s.ply", "c.compressed.ply"], "c.compressed.ply", &COMPRESSED_PLY),
            (&["-w", "s.ply", "d.glb"], "d.glb", &GLB_THERE),
            (&["-w", "-g", "cpu", "s.ply", "e.sog"], "e.sog", &THEIR_SOG),
        ] {
            if !splat_transform(folder.path(), arguments) {
                return;
            }
            // It states no axes.
            let axes = name.ends_with("spz").then_some(Axes::RDF);
            let options = LoadOptions { axes, ..LoadOptions::default() };
            let after = load(at(name), &options, &|_| {}).unwrap();
            compare(&before, &after, tolerance, |i| nearest(&after, before.gaussians().mean(i)));
        }
    }
}

/// Through the PLY's logarithm and logit, and single-precision rotations.
const GLB_THERE: Tolerance =
    Tolerance { mean: 1e-6, scale: 2e-5, radians: 3e-3, opacity: 1e-5, sh0: 1e-5, sh: 1e-5 };

#[test]
fn our_files_are_read_by_it() {
    for before in scenes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (name, tolerance) in [
            ("s.ply", &PLY),
            ("s.spz", &SPZ),
            ("s.compressed.ply", &COMPRESSED_PLY),
            ("s.sog", &SOG),
            ("lod-meta.json", &SOG),
        ] {
            save(&before, at(name)).unwrap();
            if !splat_transform(folder.path(), &["-w", name, "back.ply"]) {
                return;
            }
            let after = read(at("back.ply"));
            let tolerance = Tolerance { mean: tolerance.mean.max(1e-6), ..*tolerance };
            compare(&before, &after, &tolerance, |i| nearest(&after, before.gaussians().mean(i)));
        }
        let old = SaveOptions { spz_version: SpzVersion::Three, ..SaveOptions::default() };
        save_with(&before, at("old.spz"), &old).unwrap();
        // It takes all for right-down-front; version 3 is right-up-back, half a turn about x.
        splat_transform(folder.path(), &["-w", "old.spz", "-r", "180,0,0", "back.ply"]);
        let after = read(at("back.ply"));
        compare(&before, &after, &SPZ, |i| nearest(&after, before.gaussians().mean(i)));
        // It writes GLB and does not read it: ours is held against its own by the reader of both.
        save(&before, at("ours.glb")).unwrap();
        compare(&before, &read(at("ours.glb")), &GLB, |i| i);
    }
}
