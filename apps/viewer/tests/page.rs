//! The page in a browser. `cargo xtask web` builds the page into `target/web`; node with playwright-core (`GS3_NODE_MODULES` names
//! the folder above `node_modules`) drives Chromium (`GS3_CHROMIUM`, else /usr/bin/chromium) through `page.mjs`. Without them
//! the test says "skipped", and fails where `GS3_REQUIRE_PAGE` is set.
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use gs3::glam::DVec3;
use gs3::scene::format::save;
use gs3::scene::orbit::look_at;
use gs3::scene::{CameraPath, Intrinsics, Size, demo};
use gs3::{Backend, Mode, Session, SessionSettings};
use gs3_test_support::{part_of_demo, psnr_of_bytes, row_of_gaussians};
use gs3_viewer::controls::Rig;
use gs3_viewer::page::CameraPlace;
use gs3_viewer::path_file::{PathFile, PathFormat};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// What a page shows and what the CPU renders natively are told apart by 8 bits and by the order of sums at most.
const LEAST_PSNR: f64 = 50.0;

/// How much farther from the native image bicubic frames are at least: 62 dB with the demo, 29 with a part of it.
const BICUBIC_LOSS: f64 = 20.0;

/// What the test lacks, if it lacks anything.
fn missing() -> Option<String> {
    let page = page();
    if !page.join("gs3_viewer_bg.wasm").is_file() {
        return Some(format!("{}: cargo xtask web builds it", page.display()));
    }
    let chromium = env::var_os("GS3_CHROMIUM").unwrap_or_else(|| "/usr/bin/chromium".into());
    if !Path::new(&chromium).is_file() {
        return Some(format!("{}: a browser", Path::new(&chromium).display()));
    }
    let find = "require('node:module').createRequire(process.env.GS3_NODE_MODULES + '/x')('playwright-core')";
    let found = Command::new("node").args(["-e", find]).output();
    let is_there = found.is_ok_and(|output| output.status.success());
    (!is_there).then(|| "node with playwright-core in GS3_NODE_MODULES, which drives the browser".to_owned())
}

fn page() -> PathBuf {
    env::var_os("GS3_PAGE").map_or_else(|| Path::new(ROOT).join("target/web"), PathBuf::from)
}

/// RGB of a PNG file.
fn rgb(file: &Path) -> ([u32; 2], Vec<u8>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(file).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let channels = info.color_type.samples();
    let rgb = bytes.chunks_exact(channels).flat_map(|pixel| pixel[..3].to_vec()).collect();
    ([info.width, info.height], rgb)
}

/// What the CPU renders natively from the camera that the page tells.
fn native(session: &mut Session, camera: &Path, size: [u32; 2]) -> Vec<u8> {
    let place = CameraPlace::parse(&fs::read_to_string(camera).unwrap()).unwrap();
    let bulk = gs3::scene::orbit::Bulk::of(session.scene());
    let before = Rig { pivot: DVec3::ZERO, rotation: Default::default(), offset: DVec3::Z, fov_y: 1.0 };
    let camera = place.rig(&before, bulk.up, DVec3::ZERO).unwrap().camera(size.into()).unwrap();
    session.reference(Mode::Native, &camera).unwrap().to_rgb8()
}

/// A streamed scene of nine Gaussians, three at its coarser level, and one whose files are not there.
fn streamed(scenes: &Path) {
    for folder in ["streamed", "torn"] {
        fs::create_dir_all(scenes.join(folder)).unwrap();
    }
    for (file, count) in [("fine.sog", 9), ("coarse.sog", 3)] {
        save(&row_of_gaussians(count, 0.3), scenes.join("streamed").join(file)).unwrap();
    }
    let lod = |files: &str, lods: &str| {
        format!(
            r#"{{"version": 1, "lodLevels": 2, "filenames": [{files}],
                "tree": {{"bound": {{"min": [-1, -1, -1], "max": [9, 1, 1]}}, "lods": {{{lods}}}}}}}"#
        )
    };
    let fine = r#""0": {"file": 0, "offset": 0, "count": 9}"#;
    let both = format!(r#"{fine}, "1": {{"file": 1, "offset": 0, "count": 3}}"#);
    let index = |folder: &str| scenes.join(folder).join("lod-meta.json");
    fs::write(index("streamed"), lod(r#""fine.sog", "coarse.sog""#, &both)).unwrap();
    fs::write(index("torn"), lod(r#""none.sog""#, fine)).unwrap();
}

#[test]
fn a_session_in_a_browser() {
    if let Some(missing) = missing() {
        assert!(env::var_os("GS3_REQUIRE_PAGE").is_none(), "missing: {missing}");
        println!("skipped: {missing}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [scenes, out] = ["scenes", "out"].map(|name| folder.path().join(name));
    let out = env::var_os("GS3_PAGE_OUT").map_or(out, PathBuf::from);
    for folder in [&scenes, &out] {
        fs::create_dir_all(folder).unwrap();
    }
    save(&row_of_gaussians(3, 0.3), scenes.join("few.ply")).unwrap();
    streamed(&scenes);
    let part = part_of_demo(50);
    save(&part, scenes.join("part.ply")).unwrap();
    fs::write(scenes.join("bad.ply"), "ply\nformat nonsense").unwrap();
    let camera = |k: u32| {
        let eye = DVec3::new(0.02 * f64::from(k), -1.0, -6.0);
        look_at(eye, DVec3::ZERO, DVec3::NEG_Y, Intrinsics::from_fov_y(400, 240, 0.8)).unwrap()
    };
    let way = CameraPath::new((0..40).map(camera).collect(), 20.0, false).unwrap();
    let cameras = PathFile::new(PathFormat::SuperSplat, &way, Size::new(400, 240), 6.0).unwrap();
    fs::write(scenes.join("cameras.json"), cameras.bytes).unwrap();

    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/page.mjs");
    let output = Command::new("node").arg(script).args([&page(), &scenes, &out]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    // One line, which is what is left of long output.
    let failed: Vec<&str> = said.lines().filter(|line| line.starts_with("not ok")).collect();
    assert!(output.status.success(), "{} {}", failed.join(" "), String::from_utf8_lossy(&output.stderr));

    let settings = SessionSettings { backend: Backend::Cpu, ..SessionSettings::default() };
    let mut whole = Session::new(demo::scene().unwrap(), settings.clone()).unwrap();
    let mut part = Session::new(part, settings).unwrap();
    for name in ["demo", "moved", "shot", "gpu", "taken-over"] {
        let (size, shown) = rgb(&out.join(format!("{name}.png")));
        let session = match size {
            [400, 240] => &mut whole,
            [200, 120] => &mut part,
            other => panic!("{name}: {other:?} pixels"),
        };
        let expected = native(session, &out.join(format!("{name}.json")), size);
        let psnr = psnr_of_bytes(&shown, &expected);
        println!("{name}: {psnr:.1} dB of the native image");
        assert!(psnr >= LEAST_PSNR, "{name}: {psnr} dB");
    }
    // The split screen: bicubic on the left, and the native image of a resting camera on the right.
    let half = |image: &[u8], columns: std::ops::Range<usize>, size: [u32; 2]| -> Vec<u8> {
        let rows = image.chunks_exact(3 * size[0] as usize);
        rows.flat_map(|row| row[3 * columns.start..3 * columns.end].to_vec()).collect()
    };
    for (name, session) in [("split", &mut whole), ("gpu-split", &mut part)] {
        let (size, split) = rgb(&out.join(format!("{name}.png")));
        let expected = native(session, &out.join(format!("{name}.json")), size);
        // The divider and the columns beside it belong to neither side.
        let (middle, end) = (size[0] as usize / 2, size[0] as usize);
        let [left, right] = [0..middle - 4, middle + 4..end]
            .map(|side| psnr_of_bytes(&half(&split, side.clone(), size), &half(&expected, side, size)));
        println!("{name}: {left:.1} and {right:.1} dB of the native image");
        assert!(left + BICUBIC_LOSS < right && right >= LEAST_PSNR, "{name}: {left} and {right} dB");
    }
}
