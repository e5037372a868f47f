//! Streamed SOG as it is written: the tree over its data sets, and what is there already.

use std::collections::BTreeSet;
use std::fs;

use glam::{DMat3, DQuat, DVec3};
use gs3_scene::format::{SaveOptions, load, save, save_with};
use gs3_scene::{OpacityMode, Scene};
use serde_json::Value;

use super::round_trip::{SOG, compare_with, nearest, noise, scene, sog_slack};

/// The leaves under `node`: bound, file, offset, count.
fn leaves(node: &Value, into: &mut Vec<(Value, [usize; 3])>) {
    for child in node["children"].as_array().into_iter().flatten() {
        leaves(child, into);
    }
    if let Some(run) = node["lods"].get("0") {
        let field = |name: &str| run[name].as_u64().unwrap() as usize;
        into.push((node["bound"].clone(), [field("file"), field("offset"), field("count")]));
    }
}

#[test]
fn data_sets_hold_neighbours_and_the_tree_has_each_gaussian_once() {
    let before = scene(5, 40_000, 1, OpacityMode::Antialiased);
    let folder = tempfile::tempdir().unwrap();
    let index = folder.path().join("lod-meta.json");
    save_with(&before, &index, &SaveOptions { chunk: Some(30_000), ..SaveOptions::default() }).unwrap();
    let meta: Value = serde_json::from_slice(&fs::read(&index).unwrap()).unwrap();
    assert_eq!((&meta["lodLevels"], &meta["count"]), (&1.into(), &40_000.into()));
    assert_eq!(meta["filenames"].as_array().unwrap().len(), 2);
    let mut found = Vec::new();
    leaves(&meta["tree"], &mut found);
    // 20,000 in each data set is more than a leaf has.
    assert_eq!(found.iter().map(|(_, [file, ..])| *file).collect::<Vec<_>>(), [0, 0, 1, 1]);
    assert_eq!(found.iter().map(|(_, [.., count])| count).sum::<usize>(), 40_000);

    let after = load(folder.path(), &Default::default(), &|_| {}).unwrap();
    assert_eq!(after.opacity_mode(), OpacityMode::Antialiased);
    // A sample of them, each found by its place.
    let part = |of: &Scene, keep: &dyn Fn(usize) -> bool| {
        let mut gaussians = of.clone().into_gaussians();
        gaussians.retain(|_, i| keep(i));
        Scene::new(gaussians, OpacityMode::Antialiased).unwrap()
    };
    let sample = part(&before, &|i| i % 97 == 0);
    let means = (0..sample.gaussians().len()).map(|i| sample.gaussians().mean(i));
    let found_again: BTreeSet<usize> = means.map(|mean| nearest(&after, mean)).collect();
    let again = part(&after, &|i| found_again.contains(&i));
    compare_with(&sample, &again, &SOG, |i| nearest(&again, sample.gaussians().mean(i)), sog_slack(&sample));

    // The reader gives the leaves one after the other. Three standard deviations along an axis, from the covariance matrix;
    // rounding in the file moves the ends by less than a 20th of what the largest Gaussian reaches.
    let gaussians = after.gaussians();
    let mut first = 0;
    for (bound, [.., count]) in &found {
        for axis in 0..3 {
            let (mut low, mut high, mut longest) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
            for i in first..first + count {
                let [w, x, y, z] = gaussians.rotation(i);
                let rotation = DMat3::from_quat(DQuat::from_xyzw(x.into(), y.into(), z.into(), w.into()));
                let variances = DVec3::from(gaussians.scale(i).map(|s| f64::from(s * s)));
                let covariance = rotation * DMat3::from_diagonal(variances) * rotation.transpose();
                let reach = 3.0 * covariance.col(axis)[axis].sqrt();
                let mean = f64::from(gaussians.mean(i)[axis]);
                (low, high, longest) = (low.min(mean - reach), high.max(mean + reach), longest.max(reach));
            }
            let stated = ["min", "max"].map(|end| bound[end][axis].as_f64().unwrap());
            let off = (stated[0] - low).abs().max((stated[1] - high).abs());
            assert!(off < 0.05 * longest, "{stated:?} is not {low}..{high}, {longest} at most");
        }
        first += count;
    }
}

/// Two Gaussians of different harmonics must not share a row while there are rows.
#[test]
fn smaller_data_sets_have_closer_harmonics() {
    let before = scene(6, 140_000, 1, OpacityMode::Default);
    let error = |chunk: Option<usize>| {
        let folder = tempfile::tempdir().unwrap();
        let index = folder.path().join("lod-meta.json");
        save_with(&before, &index, &SaveOptions { chunk, ..SaveOptions::default() }).unwrap();
        let after = load(&index, &Default::default(), &|_| {}).unwrap();
        let sum = |scene: &Scene| {
            let gaussians = scene.gaussians();
            let square = |i: usize| gaussians.sh_of(i)[3..].iter().map(|v| f64::from(v * v)).sum::<f64>();
            (0..gaussians.len()).map(square).sum::<f64>()
        };
        // What rows that stand for several lose: the variance within them.
        1.0 - sum(&after) / sum(&before)
    };
    let (coarse, fine) = (error(Some(140_000)), error(Some(50_000)));
    assert!(fine < 0.2 * coarse, "{fine} with a row each, {coarse} with one for two");
    // By default two data sets, of 70,000.
    let default = error(None);
    assert!(default < coarse && default == error(Some(131_072)), "{default} by default, {coarse} in one");
}

/// Gaussians that came from two data sets, one after the other, everywhere in space.
#[test]
fn data_sets_that_a_scene_came_from_are_kept() {
    let (count, rows) = (160_000, 60_000);
    let mut gaussians = scene(7, count, 1, OpacityMode::Default).into_gaussians();
    for i in 0..count {
        let half = i / (count / 2);
        // 256 values for each codebook of each half: as many as a codebook has.
        let level = |k: usize| (k % 256) as f32 / 256.0 + half as f32 + 1.0;
        let row = i % rows;
        for k in 0..3 {
            // The row's number, so that each Gaussian shows which row it should have.
            gaussians.sh[i * 12 + k] = level(row / 256_usize.pow(k as u32));
            gaussians.scales[k][i] = 0.01 * level(i + 67 * k);
        }
        for k in 0..9 {
            gaussians.sh[i * 12 + 3 + k] = level((noise(7, row, k) * 1e6) as usize);
        }
    }
    let before = Scene::new(gaussians, OpacityMode::Default).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let index = folder.path().join("lod-meta.json");
    save(&before, &index).unwrap();
    let meta: Value = serde_json::from_slice(&fs::read(&index).unwrap()).unwrap();
    assert_eq!(meta["filenames"].as_array().unwrap().len(), 2);
    for part in ["0_0", "0_1"] {
        let meta = fs::read(folder.path().join(part).join("meta.json")).unwrap();
        let meta: Value = serde_json::from_slice(&meta).unwrap();
        assert_eq!(meta["count"], count / 2, "{part}");
    }
    let after = load(&index, &Default::default(), &|_| {}).unwrap();
    let rows = |scene: &Scene| {
        let row = |i| scene.gaussians().sh_of(i).iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        let mut rows: Vec<_> = (0..count).map(row).collect();
        rows.sort_unstable();
        rows
    };
    assert!(rows(&before) == rows(&after), "harmonics have changed");
    // Asked for parts of neighbours, rows are shared by what is near.
    let parts = tempfile::tempdir().unwrap();
    let index = parts.path().join("lod-meta.json");
    save_with(&before, &index, &SaveOptions { chunk: Some(80_000), ..SaveOptions::default() }).unwrap();
    assert!(rows(&before) != rows(&load(&index, &Default::default(), &|_| {}).unwrap()));
}

#[test]
fn a_streamed_scene_that_is_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let index = folder.path().join("lod-meta.json");
    save(&scene(1, 9, 0, OpacityMode::Default), &index).unwrap();
    let files = |at: &std::path::Path| -> BTreeSet<_> {
        fs::read_dir(at).unwrap().map(|entry| entry.unwrap().file_name()).collect()
    };
    let before = (fs::read(&index).unwrap(), files(folder.path()), files(&folder.path().join("0_0")));
    let error = save(&scene(2, 5, 0, OpacityMode::Default), &index).unwrap_err();
    assert!(
        error.to_string().ends_with("lod-meta.json: cannot be written: a streamed scene is there already"),
        "{error}"
    );
    assert_eq!(before, (fs::read(&index).unwrap(), files(folder.path()), files(&folder.path().join("0_0"))));
    // Cut off before its end, it is no scene, and the next one takes its place.
    fs::remove_file(&index).unwrap();
    save(&scene(2, 5, 0, OpacityMode::Default), &index).unwrap();
    assert_eq!(load(&index, &Default::default(), &|_| {}).unwrap().gaussians().len(), 5);
}
