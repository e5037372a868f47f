//! Files spelled out here, independent of the writers: they are the seeds of the fuzz corpus too.

use std::collections::BTreeMap;
use std::io::Write;

use image_webp::{ColorType, WebPEncoder};

use crate::readers::{TARGETS, pack};
use crate::{cameras, gltf, ksplat, lcc2, rad, sog_1, spz_4};

/// Two Gaussians of degree 1. Properties are out of the trainer's order, of four types; an element with a
/// list stands before them and one after.
pub fn ply_odd() -> Vec<u8> {
    let mut file = b"ply\r\nformat binary_big_endian 1.0\r\ncomment made by hand\r\ncomment antialiased 1\r\n\
        element tag 2\r\nproperty list uchar short ids\r\nproperty uchar flag\r\nelement vertex 2\r\n\
        property double opacity\r\nproperty float z\r\nproperty float y\r\nproperty float x\r\nproperty uchar extra\r\n\
        property float rot_3\r\nproperty float rot_2\r\nproperty float rot_1\r\nproperty float rot_0\r\n\
        property short scale_0\r\nproperty float scale_1\r\nproperty float scale_2\r\n\
        property float f_dc_0\r\nproperty float f_dc_1\r\nproperty float f_dc_2\r\n"
        .to_vec();
    for i in 0..9 {
        file.extend_from_slice(format!("property float f_rest_{i}\r\n").as_bytes());
    }
    file.extend_from_slice(b"element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n");
    // tag: two ids and a flag, then none and a flag.
    file.extend_from_slice(&[2, 0, 7, 0, 8, 1, 0, 1]);
    for sign in [1.0f32, -1.0] {
        file.extend_from_slice(&(f64::from(sign) * 2.0).to_be_bytes());
        for value in [3.0 * sign, 2.0 * sign, 1.0 * sign] {
            file.extend_from_slice(&f32::to_be_bytes(value));
        }
        file.push(9);
        for value in [0.0f32, 0.0, 0.0, 2.0] {
            file.extend_from_slice(&value.to_be_bytes());
        }
        file.extend_from_slice(&(-1i16).to_be_bytes());
        for value in [0.0f32, 1.0, 0.1, 0.2, 0.3] {
            file.extend_from_slice(&value.to_be_bytes());
        }
        for i in 0..9 {
            file.extend_from_slice(&(i as f32).to_be_bytes());
        }
    }
    file.extend_from_slice(&[1, 0, 0, 0, 0]);
    file
}

/// One Gaussian of degree 0 as text.
pub fn ply_text() -> Vec<u8> {
    b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
      property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\n\
      property float scale_0\nproperty float scale_1\nproperty float scale_2\n\
      property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\nend_header\n\
      1 -2.5 3e1\n0.1 0.2 0.3 0\n-1 0 1 1 0 0 0\n"
        .to_vec()
}

/// Three Gaussians of degree 1 in one chunk.
pub fn compressed_ply() -> Vec<u8> {
    let mut file = b"ply\nformat binary_little_endian 1.0\ncomment made by hand\nelement chunk 1\n".to_vec();
    for side in ["min", "max"] {
        for name in ["x", "y", "z", "scale_x", "scale_y", "scale_z"] {
            file.extend_from_slice(format!("property float {side}_{name}\n").as_bytes());
        }
    }
    for side in ["min", "max"] {
        for name in ["r", "g", "b"] {
            file.extend_from_slice(format!("property float {side}_{name}\n").as_bytes());
        }
    }
    file.extend_from_slice(b"element vertex 3\n");
    for name in ["packed_position", "packed_rotation", "packed_scale", "packed_color"] {
        file.extend_from_slice(format!("property uint {name}\n").as_bytes());
    }
    file.extend_from_slice(b"element sh 3\n");
    for i in 0..9 {
        file.extend_from_slice(format!("property uchar f_rest_{i}\n").as_bytes());
    }
    file.extend_from_slice(b"end_header\n");
    let bounds: [f32; 18] = [
        -1.0, -2.0, -3.0, -4.0, -4.0, -4.0, // min position, min log scale
        1.0, 2.0, 3.0, 0.0, 0.0, 0.0, // max of both
        0.0, 0.0, 0.25, 1.0, 0.5, 0.75, // min and max colour
    ];
    file.extend(bounds.iter().flat_map(|value| value.to_le_bytes()));
    // 10-bit code of 0 is not among the codes: 511 and 512 are 0.5 ∓ 1/2046.
    let rotations: [u32; 3] = [
        512 << 20 | 512 << 10 | 512,            // 0, w largest; the others about 0
        3 << 30 | 512 << 20 | 512 << 10 | 512,  // rot_3 (z) largest
        1 << 30 | 1023 << 20 | 512 << 10 | 512, // rot_1 (x) largest, w at +√½
    ];
    let positions: [u32; 3] = [0, u32::MAX, 2047 << 21];
    let colors: [u32; 3] = [0x00ff_0080, 0xff00_ffff, 0x8080_8000];
    for i in 0..3 {
        for word in [positions[i], rotations[i], positions[2 - i], colors[i]] {
            file.extend_from_slice(&word.to_le_bytes());
        }
    }
    for row in [[0u8; 9], [255; 9], [0, 1, 2, 3, 127, 128, 6, 7, 8]] {
        file.extend_from_slice(&row);
    }
    file
}

/// Two Gaussians.
pub fn splat() -> Vec<u8> {
    let mut file = Vec::new();
    for (position, scale, rgba, rotation) in [
        ([1.0f32, -2.0, 3.0], [0.1f32, 0.2, 0.3], [255u8, 0, 128, 255], [255u8, 128, 128, 128]),
        ([0.0, 0.5, 0.25], [1.0, 1.0, 1.0], [0, 0, 0, 51], [128, 128, 128, 0]),
    ] {
        file.extend(position.iter().chain(&scale).flat_map(|value| value.to_le_bytes()));
        file.extend_from_slice(&rgba);
        file.extend_from_slice(&rotation);
    }
    file
}

/// Two Gaussians of degree 1 with 8 bits after the binary point, as the gzip has them.
pub fn spz_payload(version: u32) -> Vec<u8> {
    let mut file = b"NGSP".to_vec();
    file.extend_from_slice(&version.to_le_bytes());
    file.extend_from_slice(&2u32.to_le_bytes());
    file.extend_from_slice(&[1, 8, 1, 0]);
    // Positions: 1, 2, −0.5 and the extremes −32768, 32767.996, 0.
    file.extend_from_slice(&[0, 1, 0, 0, 2, 0, 0x80, 0xff, 0xff]);
    file.extend_from_slice(&[0, 0, 0x80, 0xff, 0xff, 0x7f, 0, 0, 0]);
    file.extend_from_slice(&[255, 51]); // alphas
    file.extend_from_slice(&[0, 255, 128, 1, 2, 3]); // colours
    file.extend_from_slice(&[160, 176, 144, 0, 255, 160]); // log scales 0, 1, −1; −10, 5.9375, 0
    if version == 2 {
        file.extend_from_slice(&[255, 128, 0, 128, 127, 128]); // (1, ~0, −1), (~0, ~0, ~0)
    } else {
        // w largest, x = √½ · 511/511, y = 0, z = 0; then x largest, y = −√½ · 255/511.
        file.extend_from_slice(&(3u32 << 30 | 511 << 20).to_le_bytes());
        file.extend_from_slice(&(512u32 << 20 | 255 << 20).to_le_bytes());
    }
    file.extend_from_slice(&[0, 128, 255, 64, 64, 64, 192, 192, 192]);
    file.extend_from_slice(&[128; 9]);
    file
}

/// The same with the flag of extensions, and two of them.
pub fn spz_extended() -> Vec<u8> {
    let mut file = spz_payload(3);
    file[14] |= 2;
    for (kind, payload) in [(0xadbe_0002_u32, &[1; 12][..]), (0xadbe_0003, &[4, 0, 0, 0])] {
        file.extend_from_slice(&kind.to_le_bytes());
        file.extend_from_slice(&(payload.len() as u32).to_le_bytes());
        file.extend_from_slice(payload);
    }
    file
}

/// As a file.
pub fn spz(version: u32) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gzip.write_all(&spz_payload(version)).unwrap();
    gzip.finish().unwrap()
}

/// A lossless WebP image of `width` pixels a row.
pub fn webp(width: u32, color: ColorType, bytes: &[u8]) -> Vec<u8> {
    let channels = if matches!(color, ColorType::Rgba8) { 4 } else { 3 };
    let mut image = Vec::new();
    let height = bytes.len() as u32 / channels / width;
    WebPEncoder::new(&mut image).encode(bytes, width, height, color).unwrap();
    image
}

/// A codebook with `i · step + first` for byte `i`.
fn codebook(first: f32, step: f32) -> String {
    let values: Vec<String> = (0..256).map(|i| (i as f32 * step + first).to_string()).collect();
    format!("[{}]", values.join(","))
}

/// Four Gaussians of degree 1 in images of 2 × 3 pixels, the last row unused.
pub fn sog() -> BTreeMap<String, Vec<u8>> {
    let meta = format!(
        r#"{{"version":2,"count":4,"antialias":true,
        "means":{{"mins":[-1,-2,0],"maxs":[1,2,3],"files":["means_l.webp","means_u.webp"]}},
        "scales":{{"codebook":{},"files":["scales.webp"]}},"quats":{{"files":["quats.webp"]}},
        "sh0":{{"codebook":{},"files":["sh0.webp"]}},
        "shN":{{"count":2,"bands":1,"codebook":{},"files":["shN_centroids.webp","shN_labels.webp"]}}}}"#,
        codebook(-8.0, 0.03125),
        codebook(-2.0, 0.015625),
        codebook(-1.0, 0.0078125)
    );
    let rgb = ColorType::Rgb8;
    // The palette's first row at columns 0 to 2, its second at columns 3 to 5 of 64 · 3.
    let mut palette = vec![128u8; 64 * 3 * 3];
    palette[..18].copy_from_slice(&[0, 1, 2, 3, 4, 5, 6, 7, 8, 128, 129, 130, 131, 132, 133, 134, 135, 255]);
    let low = [0, 0, 0, 255, 255, 255, 0, 255, 0, 1, 2, 3];
    let high = [0, 0, 0, 255, 255, 255, 128, 127, 0, 0, 0, 0];
    let quats = [128, 128, 128, 252, 255, 128, 128, 253, 128, 0, 128, 254, 128, 128, 128, 255];
    let padded = |bytes: &[u8], channels: usize| [bytes, &vec![0; 2 * channels]].concat();
    BTreeMap::from([
        ("meta.json".to_owned(), meta.into_bytes()),
        ("means_l.webp".to_owned(), webp(2, rgb, &padded(&low, 3))),
        ("means_u.webp".to_owned(), webp(2, rgb, &padded(&high, 3))),
        ("scales.webp".to_owned(), webp(2, rgb, &padded(&[0, 255, 32, 1, 2, 3, 4, 5, 6, 7, 8, 9], 3))),
        ("quats.webp".to_owned(), webp(2, ColorType::Rgba8, &padded(&quats, 4))),
        (
            "sh0.webp".to_owned(),
            webp(2, ColorType::Rgba8, &padded(&[0, 128, 255, 255, 1, 2, 3, 0, 4, 5, 6, 51, 7, 8, 9, 102], 4)),
        ),
        ("shN_centroids.webp".to_owned(), webp(64 * 3, rgb, &palette)),
        ("shN_labels.webp".to_owned(), webp(2, rgb, &padded(&[0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0], 3))),
    ])
}

/// The same as an archive.
pub fn sog_bundle() -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in sog() {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Two chunks. Level 0 takes Gaussians 0, 2, 3 of the first, level 1 Gaussian 1 of the second; the
/// environment is a third.
pub fn streamed_sog() -> BTreeMap<String, Vec<u8>> {
    let index = r#"{"lodLevels":2,"environment":"env/meta.json","filenames":["0_0/meta.json","1_0/meta.json"],
        "tree":{"bound":{"min":[-9,-9,-9],"max":[9,9,9]},"children":[
            {"bound":{"min":[-9,-9,-9],"max":[9,9,9]},
             "lods":{"0":{"file":0,"offset":2,"count":2},"1":{"file":1,"offset":1,"count":1}}},
            {"bound":{"min":[-9,-9,-9],"max":[9,9,9]},"lods":{"0":{"file":0,"offset":0,"count":1}}}]}}"#;
    let mut files = BTreeMap::from([("lod-meta.json".to_owned(), index.as_bytes().to_vec())]);
    for folder in ["0_0", "1_0", "env"] {
        files.extend(sog().into_iter().map(|(name, bytes)| (format!("{folder}/{name}"), bytes)));
    }
    files
}

/// The seeds of each fuzz target.
pub fn seeds(target: &str) -> Vec<(&'static str, Vec<u8>)> {
    match target {
        "ply" => vec![("odd", ply_odd()), ("text", ply_text())],
        "compressed_ply" => vec![("degree_1", compressed_ply())],
        "splat" => vec![("two", splat())],
        "spz" => {
            vec![
                ("version_1", spz_4::spz_1_payload()),
                ("version_2", spz_payload(2)),
                ("version_3", spz_payload(3)),
                ("extended", spz_extended()),
            ]
        }
        "spz_4" => vec![("plain", spz_4::spz_4(&[]))],
        "ksplat" => (0..3)
            .map(|level| (["level_0", "level_1", "level_2"][level], ksplat::ksplat(level as u16)))
            .collect(),
        "gltf" => vec![("two", gltf::gltf()), ("spz", gltf::gltf_spz(true))],
        "rad" => vec![("flat", rad::rad(false)), ("tree", rad::rad(true))],
        "lcc2" => vec![("two_levels", pack(&lcc2::lcc2()))],
        "archive" => vec![("ply", lcc2::archive(&[("text.ply", ply_text())]))],
        "sog" => vec![("degree_1", pack(&sog())), ("version_1", pack(&sog_1::sog_1()))],
        "sog_bundle" => vec![("degree_1", sog_bundle())],
        "streamed_sog" => vec![("two_levels", pack(&streamed_sog()))],
        other => vec![("two", cameras::seed(other).expect("a seed"))],
    }
}

/// The corpus in the repository has the seeds as they are made here. `GS3_WRITE_SEEDS=1` writes it anew.
#[test]
fn the_corpus_of_the_fuzz_targets_has_the_seeds() {
    let corpus = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (target, _) in TARGETS {
        let folder = corpus.join(target);
        for (name, bytes) in seeds(target) {
            let file = folder.join(name);
            if std::env::var_os("GS3_WRITE_SEEDS").is_some() {
                std::fs::create_dir_all(&folder).unwrap();
                std::fs::write(&file, &bytes).unwrap();
            }
            assert!(std::fs::read(&file).is_ok_and(|found| found == bytes), "{}", file.display());
        }
    }
}
