//! What the fuzz targets call, and what the replay of their corpus calls on stable Rust: bytes in, no panic, and either
//! an error in one line or a scene or camera path that keeps its promises.

use std::collections::BTreeMap;
use std::io::Write;

use gs3_scene::camera_path::Pace;
use gs3_scene::capture::{CaptureFault, ColmapEncoding, parse_colmap, parse_csv, parse_json};
use gs3_scene::format::{Budget, LoadError, LoadOptions, Source, load_source};
use gs3_scene::gaussians::MAX_SH;
use gs3_scene::{CameraPath, Scene, Size};

use crate::entry::{Entry, check_message};

/// The targets by name.
pub const TARGETS: [(&str, Entry); 20] = [
    ("ply", ply),
    ("compressed_ply", ply),
    ("splat", splat),
    ("spz", spz),
    ("spz_4", spz_4),
    ("ksplat", ksplat),
    ("gltf", gltf),
    ("rad", rad),
    ("lcc2", lcc2),
    ("archive", archive),
    ("sog", sog),
    ("sog_bundle", sog_bundle),
    ("streamed_sog", streamed_sog),
    ("colmap_binary", colmap_binary),
    ("colmap_text", colmap_text),
    ("transforms", cameras_json),
    ("cameras", cameras_json),
    ("camera_path", cameras_json),
    ("supersplat", cameras_json),
    ("realityscan", realityscan),
];

/// A PLY file of either kind.
pub fn ply(data: &[u8]) {
    check(load("fuzz.ply", data));
}

/// A `.splat` file.
pub fn splat(data: &[u8]) {
    check(load("fuzz.splat", data));
}

/// What an SPZ file has within its gzip, so that changes reach the reader instead of the checksum.
pub fn spz(data: &[u8]) {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    gzip.write_all(data).expect("writing to memory");
    check(load("fuzz.spz", &gzip.finish().expect("writing to memory")));
}

/// An SPZ file of version 4. Its frames are mutated without unpacking.
pub fn spz_4(data: &[u8]) {
    check(load("fuzz.spz", data));
}

/// A `.ksplat` file.
pub fn ksplat(data: &[u8]) {
    check(load("fuzz.ksplat", data));
}

/// A GLB file.
pub fn gltf(data: &[u8]) {
    check(load("fuzz.glb", data));
}

/// A `.rad` file.
pub fn rad(data: &[u8]) {
    check(load("fuzz.rad", data));
}

/// The files of an LCC2 folder, packed by [`pack`].
pub fn lcc2(data: &[u8]) {
    check(load_files("meta.lcc2", &unpack(data)));
}

/// An archive with a scene in it.
pub fn archive(data: &[u8]) {
    check(load("fuzz.zip", data));
}

/// A table of cameras of RealityScan.
pub fn realityscan(data: &[u8]) {
    check_path(parse_csv(data, Size::new(64, 48)));
}

/// The files of a SOG folder, packed by [`pack`].
pub fn sog(data: &[u8]) {
    check(load_files("meta.json", &unpack(data)));
}

/// A SOG bundle.
pub fn sog_bundle(data: &[u8]) {
    check(load("fuzz.sog", data));
}

/// The files of a streamed SOG folder, packed by [`pack`]: the finest levels, and levels by a budget.
pub fn streamed_sog(data: &[u8]) {
    let files = unpack(data);
    for gaussians in [None, Some(2)] {
        let budget = gaussians.map(|gaussians| Budget { gaussians, cameras: Vec::new() });
        let source =
            Source::memory("lod-meta.json", files.get("lod-meta.json").map_or(&[][..], Vec::as_slice));
        check(load_source(&source, &files, &LoadOptions { budget, ..LoadOptions::default() }, &|_| {}));
    }
}

/// The files `cameras` and `images` of a binary COLMAP model, packed by [`pack`].
pub fn colmap_binary(data: &[u8]) {
    colmap(ColmapEncoding::Binary, data);
}

/// The files `cameras` and `images` of a COLMAP model in text, packed by [`pack`].
pub fn colmap_text(data: &[u8]) {
    colmap(ColmapEncoding::Text, data);
}

/// A JSON file of cameras of any kind.
pub fn cameras_json(data: &[u8]) {
    check_path(parse_json(data));
}

fn colmap(encoding: ColmapEncoding, data: &[u8]) {
    let files = unpack(data);
    let file = |name: &str| files.get(name).map_or(&[][..], Vec::as_slice);
    check_path(parse_colmap(encoding, file("cameras"), file("images")));
}

fn load(name: &str, data: &[u8]) -> Result<Scene, LoadError> {
    load_source(&Source::memory(name, data), &BTreeMap::new(), &LoadOptions::default(), &|_| {})
}

fn load_files(index: &str, files: &BTreeMap<String, Vec<u8>>) -> Result<Scene, LoadError> {
    let empty = Vec::new();
    let source = Source::memory(index, files.get(index).unwrap_or(&empty));
    load_source(&source, files, &LoadOptions::default(), &|_| {})
}

fn check(result: Result<Scene, LoadError>) {
    match result {
        Err(error) => check_message(&error.to_string()),
        Ok(scene) => {
            let gaussians = scene.gaussians();
            assert!(!gaussians.is_empty());
            let planes = gaussians.means.iter().chain(&gaussians.scales).chain(&gaussians.rotations);
            assert!(planes.flatten().all(|value| value.is_finite()));
            assert!(gaussians.sh.iter().all(|value| value.abs() <= MAX_SH));
            assert!(gaussians.opacities.iter().all(|opacity| (0.0..=1.0).contains(opacity)));
        }
    }
}

fn check_path(result: Result<CameraPath, CaptureFault>) {
    match result {
        Err(fault) => check_message(&fault.to_string()),
        Ok(path) => {
            assert!(!path.cameras().is_empty() && path.frames_per_second() > 0.0);
            // Also between the cameras, wherever they are.
            for camera in path.cameras().iter().chain(path.smoothed(3, Pace::Speed).cameras()) {
                assert!(camera.position().is_finite() && camera.view_from_world().is_finite());
                assert!(camera.intrinsics().fx > 0.0 && camera.intrinsics().fy > 0.0);
            }
        }
    }
}

/// Files as one piece: for each the length of its name (1 byte), its name, its length (4 bytes, little endian), itself.
pub fn pack(files: &BTreeMap<String, Vec<u8>>) -> Vec<u8> {
    let mut packed = Vec::new();
    for (name, bytes) in files {
        packed.push(name.len() as u8);
        packed.extend_from_slice(name.as_bytes());
        packed.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        packed.extend_from_slice(bytes);
    }
    packed
}

/// The inverse of [`pack`]; what is cut off is shorter or missing.
pub fn unpack(mut data: &[u8]) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    while let Some((length, rest)) = data.split_first() {
        let Some((name, rest)) = rest.split_at_checked(usize::from(*length)) else { break };
        let Some((length, rest)) = rest.split_first_chunk::<4>() else { break };
        let length = (u32::from_le_bytes(*length) as usize).min(rest.len());
        let (bytes, rest) = rest.split_at(length);
        files.insert(String::from_utf8_lossy(name).into_owned(), bytes.to_vec());
        data = rest;
    }
    files
}
