//! Frames in numbers: `--aov` and FILE.exr.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use exr::prelude::{ReadChannels, ReadLayers, read};

use super::chunks::{cameras, few_gaussians};
use super::scenes::npz;
use super::{gs3, json, names, png, refused, stderr, succeed};

/// The planes of an EXR file by their names, each 96 × 54.
fn exr(file: &Path) -> BTreeMap<String, Vec<f32>> {
    let layer = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let image = layer.all_attributes().non_parallel().from_file(file).unwrap();
    assert_eq!((image.layer_data.size.width(), image.layer_data.size.height()), (96, 54));
    let channels = image.layer_data.channel_data.list;
    channels.iter().map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect())).collect()
}

fn render(at: &Path, options: &str) {
    succeed(at, &format!("render few.ply --path path.json --backend cpu {options}"));
}

/// Eight bits of linear light, as sRGB encodes them.
fn encoded(light: f32) -> i32 {
    let light = f64::from(light);
    let value = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
    (value.min(1.0) * 255.0).round() as i32
}

/// Asserts that an EXR file has the colours of the picture. Values between two codes may round to either.
fn assert_same_colors(planes: &BTreeMap<String, Vec<f32>>, picture: &[u8]) {
    let mut off = 0;
    for (i, pixel) in picture.chunks_exact(3).enumerate() {
        for (name, code) in ["R", "G", "B"].into_iter().zip(pixel) {
            let difference = (encoded(planes[name][i]) - i32::from(*code)).abs();
            assert!(difference <= 1, "{name} of pixel {i}");
            off += difference;
        }
    }
    assert!(off < 20, "{off} of {} values are another code", picture.len());
}

/// Where the point at `depth` under the middle of `pixel` of frame `k` of [`cameras`] was one frame before, in pixels.
/// Without a depth it is infinitely far.
fn place_before(k: usize, [x, y]: [f64; 2], depth: Option<f64>) -> [f64; 2] {
    let pose = |k: usize| {
        let (s, c) = (0.02 * k as f64).sin_cos();
        (s, c, [7.0 * s, -1.0, 7.0 * c])
    };
    let focal = 27.0 / 25.0_f64.to_radians().tan();
    // Axes of OpenGL: right, up, back.
    let ray = [(x - 48.0) / focal, -(y - 27.0) / focal, -1.0];
    let (s, c, center) = pose(k);
    let turned = [c * ray[0] + s * ray[2], ray[1], -s * ray[0] + c * ray[2]];
    let (s, c, before) = pose(k - 1);
    let point = [0, 1, 2].map(|a| match depth {
        Some(depth) => center[a] + depth * turned[a] - before[a],
        None => turned[a],
    });
    let seen = [c * point[0] - s * point[2], point[1], s * point[0] + c * point[2]];
    [48.0 + focal * seen[0] / -seen[2], 27.0 - focal * seen[1] / -seen[2]]
}

#[test]
fn depth_normals_and_motion_lie_beside_each_frame() {
    let folder = few_gaussians();
    let at = folder.path();
    render(at, "--mode native --frames 0..3 --aov depth,normal,motion --out out --json r.json");
    let expected = (0..3).flat_map(|k| ["exr", "png"].map(|kind| format!("frame_{k:06}.{kind}")));
    assert_eq!(names(&at.join("out")), expected.collect::<Vec<_>>());
    assert_eq!(json(&at.join("r.json"))["aov"], serde_json::json!(["depth", "normal", "motion"]));
    let planes: Vec<_> = (0..3).map(|k| exr(&at.join(format!("out/frame_{k:06}.exr")))).collect();
    let channels: Vec<&str> = planes[1].keys().map(String::as_str).collect();
    assert_eq!(channels, ["B", "G", "N.X", "N.Y", "N.Z", "R", "Z", "motion.X", "motion.Y"]);
    assert_same_colors(&planes[1], &png(&at.join("out/frame_000001.png")).2);

    // Depth and normals equal the G-buffer's. The first camera differs from the world's axes by OpenGL's convention alone.
    succeed(at, "gbuffer few.ply --path path.json --backend cpu --scale 1 --out g.npz");
    let arrays = npz(&at.join("g.npz"));
    let (mut hits, mut misses) = (0, 0);
    for (i, median) in arrays["depth_median"].1.iter().enumerate() {
        let normal = ["N.X", "N.Y", "N.Z"].map(|name| planes[0][name][i]);
        if *median == 0.0 {
            assert_eq!((planes[0]["Z"][i], normal), (f32::INFINITY, [0.0; 3]));
            misses += 1;
            continue;
        }
        hits += 1;
        assert_eq!(planes[0]["Z"][i], *median);
        let view = &arrays["normal"].1[3 * i..][..3];
        let length = view.iter().map(|v| v * v).sum::<f32>().sqrt();
        for (found, expected) in normal.into_iter().zip([view[0], -view[1], -view[2]]) {
            assert!((found - expected / length).abs() < 1e-5, "pixel {i}: {normal:?}, {view:?}");
        }
    }
    assert!(hits > 1000 && misses > 10, "{hits} hits, {misses} misses");

    assert!(["motion.X", "motion.Y"].iter().all(|name| planes[0][*name].iter().all(|v| *v == 0.0)));
    let mut largest = 0.0_f64;
    for i in 0..96 * 54 {
        let pixel = [(i % 96) as f64 + 0.5, (i / 96) as f64 + 0.5];
        let depth = planes[2]["Z"][i];
        let place = place_before(2, pixel, depth.is_finite().then_some(f64::from(depth)));
        for (a, name) in ["motion.X", "motion.Y"].into_iter().enumerate() {
            let motion = f64::from(planes[2][name][i]);
            assert!((pixel[a] + motion - place[a]).abs() < 1e-3, "{name} of pixel {i}: {motion}, {place:?}");
            largest = largest.max(motion.abs());
        }
    }
    assert!(largest > 0.5, "{largest}: the camera moves");
}

#[test]
fn frames_between_have_numbers_too() {
    let folder = few_gaussians();
    let at = folder.path();
    render(at, "--mode native --frames 0..3 --aov depth,motion --out native");
    render(at, "--in-between 1 --frames 0..3 --aov motion --aov depth --out full");
    assert_eq!(names(&at.join("full")).len(), 10);
    let planes = |name: &str, k: usize| exr(&at.join(format!("{name}/frame_{k:06}.exr")));
    let [native, whole, between] = [planes("native", 2), planes("full", 4), planes("full", 3)];
    assert!(native["Z"] == whole["Z"] && native["Z"] != between["Z"] && !whole.contains_key("N.X"));
    assert_same_colors(&between, &png(&at.join("full/frame_000003.png")).2);
    // Frames are shown twice as often, so the camera moves half as far from one to the next.
    let mean = |planes: &BTreeMap<String, Vec<f32>>| {
        planes["motion.X"].iter().map(|v| f64::from(v.abs())).sum::<f64>() / (96.0 * 54.0)
    };
    for half in [&whole, &between] {
        let ratio = mean(half) / mean(&native);
        assert!((ratio - 0.5).abs() < 0.05, "{ratio}");
    }
    // A part of the path has the bits of the whole, and a video's frames have theirs.
    render(at, "--in-between 1 --frames 2..3 --aov depth,motion --out part");
    render(at, "--in-between 1 --frames 0..2 --aov depth,motion --out v.mp4");
    assert_eq!(names(&at.join("part")).len(), 4);
    for (part, whole) in [("part", "full"), ("v", "full")] {
        for name in names(&at.join(part)) {
            let [part, whole] = [part, whole].map(|folder| fs::read(at.join(folder).join(&name)).unwrap());
            assert!(part == whole, "{name}");
        }
    }
}

#[test]
fn a_frame_is_there_if_its_numbers_are() {
    let folder = few_gaussians();
    let at = folder.path();
    let made = |options: &str| {
        render(
            at,
            &format!("--mode bicubic --frames 0..4 --skip-existing --out out --json r.json {options}"),
        );
        json(&at.join("r.json"))["frames_rendered"].as_u64().unwrap()
    };
    assert_eq!(made("--aov depth"), 4);
    let files =
        || names(&at.join("out")).into_iter().map(|name| fs::read(at.join("out").join(name)).unwrap());
    let before: Vec<Vec<u8>> = files().collect();
    assert_eq!(made("--aov depth"), 0);
    fs::remove_file(at.join("out/frame_000002.exr")).unwrap();
    fs::remove_file(at.join("out/frame_000003.png")).unwrap();
    assert_eq!(made("--aov depth"), 2);
    assert!(files().eq(before));
    let manifest = json(&at.join("out/manifest.json"));
    assert_eq!((&manifest["aov"], &manifest["aov_format"]), (&"depth".into(), &"exr".into()));
    for (options, expected) in [
        ("", "expected frames of aov none, found those of aov depth"),
        ("--aov motion,depth", "expected frames of aov depth,motion, found those of aov depth"),
        ("--aov depth --aov-format npz", "expected frames of aov_format npz, found those of aov_format exr"),
    ] {
        let command =
            format!("render few.ply --path path.json --mode bicubic --frames 4..5 --out out {options}");
        let output = gs3(at, &format!("{command} --backend cpu")).output().unwrap();
        let said = stderr(&output);
        assert!(output.status.code() == Some(2) && said.contains(expected), "{options}: {said}");
    }
}

#[test]
fn one_frame_in_numbers() {
    let folder = few_gaussians();
    let at = folder.path();
    let render = |options: &str| render(at, &format!("--mode native --frames 1..2 {options}"));
    render("--out a.png --aov normal --aov-format npz");
    render("--out b.exr");
    render("--out c.exr --aov depth --alpha");
    render("--out d.png --alpha");
    let arrays = npz(&at.join("a.npz"));
    assert_eq!(arrays.keys().collect::<Vec<_>>(), ["color_linear", "normal"]);
    assert_eq!(
        (arrays["color_linear"].0.as_str(), arrays["normal"].0.as_str()),
        ("(54,96,3,)", "(54,96,3,)")
    );
    let planes = exr(&at.join("b.exr"));
    assert_eq!(planes.keys().collect::<Vec<_>>(), ["B", "G", "R"]);
    assert_same_colors(&planes, &png(&at.join("a.png")).2);
    let interleaved = (0..96 * 54).flat_map(|i| ["R", "G", "B"].map(|name| planes[name][i]));
    assert!(interleaved.eq(arrays["color_linear"].1.iter().copied()));
    // Alpha is associated: the colour without it is the picture's.
    let planes = exr(&at.join("c.exr"));
    assert_eq!(planes.keys().collect::<Vec<_>>(), ["A", "B", "G", "R", "Z"]);
    let mut part = 0;
    for (i, pixel) in png(&at.join("d.png")).2.chunks_exact(4).enumerate() {
        let alpha = planes["A"][i];
        assert!((alpha * 255.0 - f32::from(pixel[3])).abs() <= 0.51, "alpha of pixel {i}");
        part += usize::from((0.1..0.9).contains(&alpha));
        if pixel[3] > 0 {
            for (name, code) in ["R", "G", "B"].into_iter().zip(pixel) {
                let code_found = encoded(planes[name][i] / alpha);
                assert!((code_found - i32::from(*code)).abs() <= 1, "{name} of pixel {i}");
            }
        }
    }
    assert!(part > 50, "{part} pixels are covered in part");
    assert_eq!(
        names(at),
        ["a.npz", "a.png", "b.exr", "c.exr", "d.png", "few.ply", "path.json"],
        "nothing else is written"
    );
}

#[test]
fn what_does_not_fit_is_refused() {
    let folder = few_gaussians();
    let at = folder.path();
    fs::write(
        at.join("round.json"),
        cameras(2).replace("\"fps\"", "\"camera_type\": \"equirectangular\", \"fps\""),
    )
    .unwrap();
    fs::create_dir(at.join("taken.exr")).unwrap();
    let before = names(at);
    for (options, expected) in [
        ("--aov depth,colour --out o", "--aov: expected depth, normal or motion, found colour"),
        ("--aov --out o", "--aov: expected depth, normal or motion, found none"),
        ("--aov-format npz --out o", "not provided: --aov"),
        ("--aov depth --aov-format tiff --out o", "--aov-format: expected exr or npz, found tiff"),
        (
            "--aov depth --aov-format npz --out o.exr",
            "--aov-format: expected exr, as all of the frame is in o.exr, found npz",
        ),
        ("--aov depth --out taken.png", "--aov: expected a file, found taken.exr, a folder"),
        ("--out taken.exr/x.exr --frames 0..2", "--out: expected a folder or FILE.mp4 for 2 frames"),
        ("--path round.json --aov depth --out o", "--aov: expected a path of perspective cameras"),
    ] {
        let path = if options.contains("--path") { "" } else { "--path path.json" };
        let said = refused(&mut gs3(at, &format!("render few.ply {path} --backend cpu {options}")));
        assert!(said.contains(expected), "{options}: {said}");
        assert_eq!(names(at), before, "{options} leaves nothing");
    }
}
