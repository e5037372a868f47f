//! LCC2, archives, and what has no Gaussians.

use std::collections::BTreeMap;
use std::io::Write;

use gs3_scene::format::{LoadOptions, Streamed, streamed};

use crate::handmade::{ply_text, sog, sog_bundle, splat, spz};
use crate::{assert_close, assert_error, load_bytes, load_folder};

/// An octree of two levels over two bundles; the root's own data is not a level.
pub fn lcc2() -> BTreeMap<String, Vec<u8>> {
    let index = r#"{"totalLevels": 2, "totalSplats": 8, "lodSplats": [4, 4], "splatType": ".sog",
        "root": {"splatFiles": ["a.sog", "b.spz"], "data": {"env": {"name": 1}}, "child": {"0": {
            "data": {"3dgs": {"name": 0, "start": 0, "count": 1}},
            "child": [{"data": {"3dgs": {"name": 0, "start": 2, "count": 2}}}, {}, ], }, }, }, }"#;
    BTreeMap::from([
        ("meta.lcc2".to_owned(), index.as_bytes().to_vec()),
        ("a.sog".to_owned(), sog_bundle()),
        ("b.spz".to_owned(), spz(3)),
    ])
}

#[test]
fn lcc2_levels_and_environment() {
    let files = lcc2();
    let options =
        |level_of_detail, environment| LoadOptions { level_of_detail, environment, ..LoadOptions::default() };
    let count =
        |options: &LoadOptions| load_folder("meta.lcc2", &files, options).map(|s| s.gaussians().len());
    assert_eq!(count(&options(None, false)).unwrap(), 2);
    assert_eq!(count(&options(Some(0), false)).unwrap(), 2);
    assert_eq!(count(&options(Some(1), false)).unwrap(), 1);
    assert_eq!(count(&options(None, true)).unwrap(), 4);
    assert!(count(&options(Some(2), false)).is_err());
    // Right-front-up numbers: what is up is −y here, what is in front z.
    let plain = load_folder("meta.json", &sog(), &LoadOptions::default()).unwrap();
    let turned = load_folder("meta.lcc2", &files, &options(Some(1), false)).unwrap();
    let [x, y, z] = plain.gaussians().mean(0);
    assert_close(&turned.gaussians().mean(0), &[x, -z, y], 1e-6);
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in &files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let expected = Streamed { levels: 2, has_environment: true, takes_budget: false };
    assert_eq!(streamed(folder.path()).unwrap(), Some(expected));
}

pub fn archive(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in files {
        zip.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn archives_with_one_scene_are_read() {
    let expected = load_bytes("t.ply", &ply_text()).unwrap();
    let download =
        archive(&[("__MACOSX/._t.ply", vec![0]), ("in/t.ply", ply_text()), ("readme.txt", vec![65])]);
    assert_eq!(load_bytes("d.zip", &download).unwrap(), expected);
    let two = archive(&[("a.ply", ply_text()), ("b.splat", splat())]);
    assert_error(load_bytes("d.zip", &two), &["d.zip", "one scene", "a.ply", "b.splat"]);
    assert_error(load_bytes("d.zip", &archive(&[("a.txt", vec![65])])), &["d.zip", "a.txt"]);
    let nested = archive(&[("a.ply", archive(&[("b.ply", ply_text())]))]);
    assert_error(load_bytes("d.zip", &nested), &["another archive"]);
}

#[test]
fn what_has_no_gaussians_is_recognised() {
    let points =
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nend_header\n0 0 0 255\n";
    assert_error(load_bytes("p.ply", points), &["p.ply", "a point cloud", "3D Gaussians"]);
    let mesh =
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0\n";
    assert_error(load_bytes("m.ply", mesh), &["m.ply", "a mesh"]);
    assert_error(load_bytes("l.las", b"LASF0123456789abcdef"), &["l.las", "a point cloud"]);
    let lcc = br#"{"totalLevel": 5, "attributes": [], "fileType": "Quality"}"#;
    assert_error(load_bytes("s.lcc", lcc), &["s.lcc", "LCC scene of version 1"]);
    assert_error(load_bytes("t.json", br#"{"frames": []}"#), &["cameras", "--path"]);
}
