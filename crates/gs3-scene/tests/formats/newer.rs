//! SPZ version 4, glTF, `.ksplat`, `.rad`, LCC2 and archives, spelled out here, independent of the writers.

use std::collections::BTreeMap;
use std::io::Write;

use gs3_scene::format::{LoadOptions, Source, Streamed, load_source, streamed};
use gs3_scene::scene::AxesKnownBy;
use gs3_scene::{Axes, OpacityMode};
use half::f16;

use crate::handmade::{ply_text, sog, sog_bundle, splat, spz, spz_payload};
use crate::{assert_close, assert_error, load_bytes, load_folder};

/// A Zstandard frame of one raw block.
fn zstd_frame(bytes: &[u8]) -> Vec<u8> {
    let mut frame = 0xfd2f_b528_u32.to_le_bytes().to_vec();
    // A single segment whose size is stated in 4 bytes; no checksum.
    frame.push(0b1010_0000);
    frame.extend((bytes.len() as u32).to_le_bytes());
    // The last block, raw.
    let header = (bytes.len() as u32) << 3 | 1;
    frame.extend(&header.to_le_bytes()[..3]);
    frame.extend_from_slice(bytes);
    frame
}

/// The Gaussians of [`spz_payload`] of version 3 in version 4, with `extensions`.
pub fn spz_4(extensions: &[u8]) -> Vec<u8> {
    let payload = spz_payload(3);
    let mut file = payload[..15].to_vec();
    file[4] = 4;
    if !extensions.is_empty() {
        file[14] |= 2;
    }
    file.push(6);
    file.extend((32 + extensions.len() as u32).to_le_bytes());
    file.resize(32, 0);
    file.extend_from_slice(extensions);
    let mut rest = &payload[16..];
    let frames: Vec<(usize, Vec<u8>)> = [9, 1, 3, 3, 4, 9]
        .into_iter()
        .map(|size| {
            let (array, others) = rest.split_at(2 * size);
            rest = others;
            (array.len(), zstd_frame(array))
        })
        .collect();
    for (size, frame) in &frames {
        file.extend((frame.len() as u64).to_le_bytes());
        file.extend((*size as u64).to_le_bytes());
    }
    file.extend(frames.iter().flat_map(|(_, frame)| frame));
    file
}

/// An extension that states axes by their number.
fn axes_extension(code: u32) -> Vec<u8> {
    [0xadbe_0003, 4, code].into_iter().flat_map(u32::to_le_bytes).collect()
}

/// Two Gaussians of version 1: positions as halves.
pub fn spz_1_payload() -> Vec<u8> {
    let mut file = spz_payload(2);
    file[4] = 1;
    let rest = file.split_off(16 + 18);
    file.truncate(16);
    for value in [1.0, 2.0, -0.5, -32768.0, 65504.0, 0.0] {
        file.extend(f16::from_f32(value).to_le_bytes());
    }
    [file, rest].concat()
}

fn gzip(payload: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gzip.write_all(payload).unwrap();
    gzip.finish().unwrap()
}

#[test]
fn spz_version_4_is_version_3_in_frames() {
    let expected = load_bytes("s.spz", &spz(3)).unwrap();
    assert_eq!(load_bytes("s.spz", &spz_4(&[])).unwrap(), expected);
    let stated = load_bytes("s.spz", &spz_4(&axes_extension(4))).unwrap();
    assert_eq!(stated.gaussians(), expected.gaussians());
    assert_eq!(stated.details().axes.known_by, AxesKnownBy::File);

    let whole = spz_4(&[]);
    for length in 0..whole.len() {
        assert!(load_bytes("cut.spz", &whole[..length]).is_err(), "{length}");
    }
    let with = |at: usize, value: u8| {
        let mut file = spz_4(&[]);
        file[at] = value;
        load_bytes("v.spz", &file)
    };
    assert_error(with(4, 3), &["v.spz", "version", "4 outside of gzip", "3"]);
    assert_error(with(12, 5), &["v.spz", "shDegree", "at most 4", "5"]);
    assert_error(with(12, 0), &["v.spz", "numStreams", "5 streams", "6"]);
    assert_error(with(16, 31), &["v.spz", "tocByteOffset", "31"]);
    assert_error(with(32, 1), &["v.spz", "table of streams"]);
    assert_error(with(40, 17), &["v.spz", "positions", "18", "17"]);
    assert_error(with(11, 255), &["v.spz", "numPoints", "at most"]);
    // The first frame's block says that it is longer than the stream.
    assert_error(with(32 + 96 + 9, 0xf9), &["v.spz", "positions", "Zstandard"]);
}

#[test]
fn spz_version_1_has_halves() {
    let scene = load_bytes("s.spz", &gzip(&spz_1_payload())).unwrap();
    assert_eq!(scene.gaussians().mean(0), [1.0, -2.0, 0.5]);
    assert_eq!(scene.gaussians().mean(1), [-32768.0, -65504.0, 0.0]);
    let second = load_bytes("s.spz", &spz(2)).unwrap();
    assert_eq!(scene.gaussians().rotations, second.gaussians().rotations);
    assert_eq!(scene.gaussians().sh, second.gaussians().sh);
}

/// Axes are those of the caller, else of the file, else of the format, and scenes in memory always right-down-front.
#[test]
fn spz_axes_are_honoured() {
    let file = |code: u32| {
        let mut payload = spz_payload(3);
        payload[14] |= 2;
        gzip(&[payload, axes_extension(code)].concat())
    };
    let load = |bytes: &[u8], axes: Option<Axes>| {
        let options = LoadOptions { axes, ..LoadOptions::default() };
        load_source(&Source::memory("a.spz", bytes), &BTreeMap::new(), &options, &|_| {}).unwrap()
    };
    // As stored: 1, 2, −0.5.
    assert_eq!(load(&file(6), None).gaussians().mean(0), [1.0, 2.0, -0.5]);
    assert_eq!(load(&file(4), None).gaussians().mean(0), [1.0, -2.0, 0.5]);
    // Left, front, down: x is left, y forward, z down.
    assert_eq!(load(&file(9), None).gaussians().mean(0), [-1.0, -0.5, 2.0]);
    let told = load(&file(4), Some(Axes::RDF));
    assert_eq!(told.gaussians().mean(0), [1.0, 2.0, -0.5]);
    assert_eq!(told.details().axes.known_by, AxesKnownBy::Caller);
    assert!(told.details().notes[0].contains("right-up-back"), "{:?}", told.details().notes);
    assert_eq!(load(&spz(3), Some(Axes::RDF)).gaussians().mean(0), [1.0, 2.0, -0.5]);
    // A mirrored scene has mirrored harmonics: y changes sign, z and x do not.
    let [plain, mirrored] = [load(&file(6), None), load(&file(8), None)];
    let (a, b) = (plain.gaussians().sh_of(0), mirrored.gaussians().sh_of(0));
    assert_close(&b[3..6], &[-a[3], -a[4], -a[5]], 1e-6);
    assert_close(&b[6..12], &a[6..12], 1e-6);
    let other = load_bytes("o.spz", &spz_4(&[7u32.to_le_bytes(), [0; 4]].concat())).unwrap();
    assert!(other.details().notes[0].contains("0x00000007"), "{:?}", other.details().notes);
}

/// A binary glTF of `json` and `bytes`.
fn glb(json: &str, bytes: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF".to_vec();
    for word in [2, (28 + json.len() + bytes.len()) as u32, json.len() as u32] {
        file.extend(word.to_le_bytes());
    }
    file.extend_from_slice(b"JSON");
    file.extend_from_slice(&json);
    file.extend((bytes.len() as u32).to_le_bytes());
    file.extend_from_slice(b"BIN\0");
    file.extend_from_slice(bytes);
    file
}

const GLTF: &str = r#"{"asset":{"version":"2.0"},"extensionsUsed":["KHR_gaussian_splatting"],
"scenes":[{"nodes":[0]}],"nodes":[{"children":[1],"translation":[10,0,0]},
{"mesh":0,"rotation":[0,0,0.7071067811865476,0.7071067811865476],"scale":[2,2,2]}],
"meshes":[{"primitives":[{"mode":0,"attributes":{"POSITION":0,"KHR_gaussian_splatting:ROTATION":1,
"KHR_gaussian_splatting:SCALE":2,"KHR_gaussian_splatting:OPACITY":3,"KHR_gaussian_splatting:SH_DEGREE_0_COEF_0":4,
"KHR_gaussian_splatting:SH_DEGREE_1_COEF_0":5,"KHR_gaussian_splatting:SH_DEGREE_1_COEF_1":6,
"KHR_gaussian_splatting:SH_DEGREE_1_COEF_2":7,"COLOR_0":4,"_MASK":3},
"extensions":{"KHR_gaussian_splatting":{"kernel":"ellipse","colorSpace":"lin_rec709_display"}}}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":2,"type":"VEC3"},
{"bufferView":1,"componentType":5122,"normalized":true,"count":2,"type":"VEC4"},
{"bufferView":2,"componentType":5121,"normalized":true,"count":2,"type":"VEC3"},
{"bufferView":3,"componentType":5123,"normalized":true,"count":2,"type":"SCALAR"},
{"bufferView":4,"componentType":5126,"count":2,"type":"VEC3"},
{"bufferView":4,"componentType":5126,"count":2,"type":"VEC3"},
{"bufferView":4,"byteOffset":12,"componentType":5126,"count":2,"type":"VEC3"},
{"bufferView":4,"componentType":5126,"count":2,"type":"VEC3"}],
"bufferViews":[{"buffer":0,"byteLength":24},{"buffer":0,"byteOffset":24,"byteLength":16},
{"buffer":0,"byteOffset":40,"byteLength":8,"byteStride":4},{"buffer":0,"byteOffset":48,"byteLength":4},
{"buffer":0,"byteOffset":52,"byteLength":36,"byteStride":12}],"buffers":[{"byteLength":88}]}"#;

/// Two Gaussians under two nodes, with values of four types.
pub fn gltf_bytes() -> Vec<u8> {
    let mut bytes: Vec<u8> = [1.0f32, 2.0, 3.0, 0.0, 0.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    // No turn, and half a turn about x.
    for q in [[0i16, 0, 0, 32767], [32767, 0, 0, 0]] {
        bytes.extend(q.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes.extend_from_slice(&[255, 51, 102, 9, 51, 51, 51, 9]);
    bytes.extend([65535u16, 13107].iter().flat_map(|v| v.to_le_bytes()));
    let sh: [f32; 9] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
    bytes.extend(sh.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

pub fn gltf() -> Vec<u8> {
    glb(GLTF, &gltf_bytes())
}

#[test]
fn gltf_nodes_move_turn_and_grow_gaussians() {
    let scene = load_bytes("s.glb", &gltf()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (2, 1));
    // A quarter turn about z makes (1, 2, 3) (−2, 1, 3); twice that beside 10 is (6, 2, 6); half a turn about z leads
    // from left-up-front to right-down-front.
    let origin = scene.details().origin;
    let mean = gaussians.mean(0);
    let place: Vec<f64> = (0..3).map(|axis| f64::from(mean[axis]) + origin[axis]).collect();
    assert!(place.iter().zip([-6.0, -2.0, 6.0]).all(|(a, b)| (a - b).abs() < 1e-5), "{place:?}");
    assert_close(&gaussians.scale(0), &[2.0, 0.4, 0.8], 1e-5);
    assert_close(&gaussians.opacities, &[1.0, 0.2], 1e-6);
    // 90° and 180° about z: 270°, or 90°, which has the same axes but for signs.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let [w, x, y, z] = gaussians.rotation(0);
    assert_close(&[w.abs(), x, y, z.abs()], &[half, 0.0, 0.0, half], 1e-5);
    assert_close(&gaussians.sh_of(0)[..3], &[0.1, 0.2, 0.3], 1e-6);
    // Functions −y, z, −x: of the direction turned back by 270° about z, which makes y x and x −y.
    let sh = gaussians.sh_of(0);
    assert_close(&sh[3..12], &[-0.1, -0.2, -0.3, 0.4, 0.5, 0.6, 0.1, 0.2, 0.3], 1e-5);
    let notes = scene.details().notes.join("; ");
    assert!(
        notes.contains("lin_rec709_display") && notes.contains("_MASK") && !notes.contains("COLOR"),
        "{notes}"
    );
}

#[test]
fn gltf_without_gaussians_or_with_broken_parts_is_refused() {
    let with = |from: &str, to: &str| {
        assert!(GLTF.contains(from));
        load_bytes("s.glb", &glb(&GLTF.replace(from, to), &gltf_bytes()))
    };
    assert_error(
        with("\"KHR_gaussian_splatting\":{", "\"other\":{"),
        &["s.glb", "a mesh", "KHR_gaussian_splatting"],
    );
    assert_error(with("\"ellipse\"", "\"cube\""), &["kernel", "ellipse", "cube"]);
    assert_error(with("\"children\":[1]", "\"children\":[1,0]"), &["nodes[0]", "tree"]);
    assert_error(with("\"children\":[1]", "\"children\":[7]"), &["nodes", "7"]);
    assert_error(with("[2,2,2]", "[2,1,2]"), &["nodes[1]", "uniform scale"]);
    assert_error(
        with("\"count\":2,\"type\":\"SCALAR\"", "\"count\":3,\"type\":\"SCALAR\""),
        &["OPACITY", "count"],
    );
    assert_error(with("\"type\":\"SCALAR\"", "\"type\":\"VEC3\""), &["OPACITY", "type", "SCALAR"]);
    assert_error(with("\"componentType\":5123", "\"componentType\":5125"), &["componentType", "5125"]);
    assert_error(with("\"KHR_gaussian_splatting:SCALE\":2,", ""), &["SCALE", "none"]);
    // A degree that is not whole is not there, and what there is of it is told.
    let scene = with("\"KHR_gaussian_splatting:SH_DEGREE_1_COEF_1\":6,", "").unwrap();
    assert_eq!(scene.gaussians().sh_degree, 0);
    assert!(scene.details().notes.join("; ").contains("SH_DEGREE_1_COEF_0"));
    // As text with its buffer beside it.
    let text = GLTF.replace("{\"byteLength\":88}", "{\"byteLength\":88,\"uri\":\"a%20b.bin\"}");
    let files =
        BTreeMap::from([("s.gltf".to_owned(), text.into_bytes()), ("a b.bin".to_owned(), gltf_bytes())]);
    let scene = load_folder("s.gltf", &files, &LoadOptions::default()).unwrap();
    assert_eq!(scene.gaussians(), load_bytes("s.glb", &gltf()).unwrap().gaussians());
}

/// A primitive whose Gaussians are those of `spz`.
pub fn gltf_spz(has_kernel: bool) -> Vec<u8> {
    let bytes = spz(3);
    let inner = r#""extensions":{"KHR_gaussian_splatting_compression_spz_2":{"bufferView":0}}"#;
    let extension = match has_kernel {
        true => format!(
            r#""KHR_gaussian_splatting":{{"kernel":"ellipse","colorSpace":"srgb_rec709_display",{inner}}}"#
        ),
        false => r#""KHR_spz_gaussian_splats_compression":{"bufferView":0}"#.to_owned(),
    };
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"mode":0,"attributes":{{}},
        "extensions":{{{extension}}}}}]}}],"bufferViews":[{{"buffer":0,"byteLength":{}}}],
        "buffers":[{{"byteLength":{}}}]}}"#,
        bytes.len(),
        bytes.len()
    );
    glb(&json, &bytes)
}

#[test]
fn gltf_may_hold_spz() {
    let expected = load_bytes("s.spz", &spz(3)).unwrap();
    // Stated to be left-up-front after unpacking right-up-back: the scene is where the SPZ's own is.
    let stated = load_bytes("s.glb", &gltf_spz(true)).unwrap();
    assert_eq!(stated.gaussians().means, expected.gaussians().means);
    assert_eq!(stated.opacity_mode(), OpacityMode::Antialiased);
    // The older profile keeps the numbers: x is left.
    let kept = load_bytes("s.glb", &gltf_spz(false)).unwrap();
    assert_eq!(kept.gaussians().mean(0), [-1.0, -2.0, -0.5]);
}

/// Three Gaussians of degree 1 in two buckets, at the given level of compression; a second section is empty.
pub fn ksplat(level: u16) -> Vec<u8> {
    let mut file = vec![0; 4096 + 2 * 1024];
    file[1] = 1;
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    for (at, value) in [(4, 2u32), (8, 2), (12, 3), (16, 3)] {
        put(at, &value.to_le_bytes());
    }
    put(20, &level.to_le_bytes());
    put(36, &(-2.0f32).to_le_bytes());
    put(40, &2.0f32.to_le_bytes());
    let is_bucketed = level > 0;
    // Room for four, two a bucket, one of them full.
    let fields = [
        (0, 3u32),
        (4, 4),
        (8, 2),
        (12, if is_bucketed { 2 } else { 0 }),
        (32, 1),
        (36, u32::from(is_bucketed)),
    ];
    for (at, value) in fields {
        put(4096 + at, &value.to_le_bytes());
    }
    put(4096 + 16, &5.0f32.to_le_bytes());
    put(4096 + 20, &12u16.to_le_bytes());
    put(4096 + 40, &1u16.to_le_bytes());
    if is_bucketed {
        file.extend(1u32.to_le_bytes());
        for center in [[10.0f32, 0.0, 0.0], [-10.0, 1.0, 0.0]] {
            file.extend(center.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    for i in 0..4 {
        match level {
            0 => file.extend([i as f32, 2.0, 3.0].iter().flat_map(|v| v.to_le_bytes())),
            // The centre, and half a block to the right of it.
            _ => file.extend(
                [32767u16 + 32767 * (i % 2) as u16, 32767, 32767].iter().flat_map(|v| v.to_le_bytes()),
            ),
        }
        let scale_and_rotation = [0.5f32, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0];
        let sh = [0.1f32, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
        let half = |v: &f32| f16::from_f32(*v).to_le_bytes();
        match level {
            0 => file.extend(scale_and_rotation.iter().flat_map(|v| v.to_le_bytes())),
            _ => file.extend(scale_and_rotation.iter().flat_map(half)),
        }
        file.extend_from_slice(&[255, 0, 128, 51]);
        match level {
            0 => file.extend(sh.iter().flat_map(|v| v.to_le_bytes())),
            1 => file.extend(sh.iter().flat_map(half)),
            _ => file.extend(sh.iter().map(|v| ((v + 2.0) / 4.0 * 255.0).round() as u8)),
        }
    }
    file
}

#[test]
fn ksplat_at_all_levels_of_compression() {
    for level in 0..3 {
        let scene = load_bytes("s.ksplat", &ksplat(level)).unwrap();
        let gaussians = scene.gaussians();
        assert_eq!((gaussians.len(), gaussians.sh_degree), (3, 1));
        let means = [0, 1, 2].map(|i| gaussians.mean(i));
        match level {
            0 => assert_eq!(means, [[0.0, 2.0, 3.0], [1.0, 2.0, 3.0], [2.0, 2.0, 3.0]]),
            _ => assert_eq!(means, [[10.0, 0.0, 0.0], [12.5, 0.0, 0.0], [-10.0, 1.0, 0.0]]),
        }
        assert_eq!(gaussians.scale(2), [0.5, 1.0, 2.0]);
        assert_eq!(gaussians.rotation(1), [1.0, 0.0, 0.0, 0.0]);
        assert_close(&gaussians.opacities, &[0.2; 3], 1e-6);
        assert_close(&gaussians.sh_of(0)[..3], &[1.772_453_9, -1.772_453_9, 0.006_950_8], 1e-5);
        // Red of all functions of the degree first, then green, then blue.
        let expected = [0.1, 0.4, 0.7, 0.2, 0.5, 0.8, 0.3, 0.6, 0.9];
        assert_close(&gaussians.sh_of(2)[3..], &expected, if level == 2 { 0.008 } else { 1e-3 });
    }
    let with = |at: usize, value: u8| {
        let mut file = ksplat(1);
        file[at] = value;
        load_bytes("s.ksplat", &file)
    };
    assert_error(with(0, 1), &["s.ksplat", "version", "1.1"]);
    assert_error(with(20, 3), &["compression level", "3"]);
    assert_error(with(16, 4), &["splat count", "3", "4"]);
    assert_error(with(4096, 5), &["section 0 splat count", "at most 4", "5"]);
    assert_error(with(4096 + 40, 9), &["section 0 SH degree", "9"]);
    assert_error(load_bytes("s.bin", &ksplat(1)), &["s.bin", "format"]);
    let whole = ksplat(1);
    // The room of the last record may be missing.
    for length in 0..whole.len() - 42 {
        assert!(load_bytes("cut.ksplat", &whole[..length]).is_err(), "{length}");
    }
}

/// A chunk of `.rad`.
fn rad_chunk(base: u64, count: u64, properties: &[(&str, &str, Vec<u8>)], is_packed: bool) -> Vec<u8> {
    let (mut payload, mut described) = (Vec::new(), Vec::new());
    for (name, encoding, bytes) in properties {
        let packed = match is_packed {
            true => {
                let mut deflate = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
                deflate.write_all(bytes).unwrap();
                deflate.finish().unwrap()
            }
            false => bytes.clone(),
        };
        let compression = if is_packed { r#","compression":"gz""# } else { "" };
        described.push(format!(
            r#"{{"offset":{},"bytes":{},"property":"{name}","encoding":"{encoding}","min":0,"max":1{compression}}}"#,
            payload.len(),
            packed.len()
        ));
        payload.extend(packed);
        payload.resize(payload.len().next_multiple_of(8), 0);
    }
    let json = format!(
        r#"{{"version":1,"base":{base},"count":{count},"payloadBytes":{},"properties":[{}]}}"#,
        payload.len(),
        described.join(",")
    );
    let mut chunk = b"RADC".to_vec();
    chunk.extend((json.len() as u32).to_le_bytes());
    chunk.extend(json.bytes());
    chunk.resize(chunk.len().next_multiple_of(8), 0);
    chunk.extend((payload.len() as u64).to_le_bytes());
    chunk.extend(payload);
    chunk
}

/// Three Gaussians of degree 1 in two chunks; with a tree, the first is an inner node.
pub fn rad(has_tree: bool) -> Vec<u8> {
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut first = vec![
        ("center", "f32", floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
        ("alpha", "r8", vec![255, 51]),
        ("rgb", "r8_delta", vec![255, 1, 0, 51, 51, 0]),
        ("scales", "f32", floats(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6])),
        ("orientation", "oct88r8", vec![128, 128, 255, 128, 128, 0]),
        ("sh1", "s8", vec![127; 18]),
    ];
    let mut second = vec![
        ("center", "f32", floats(&[7.0, 8.0, 9.0])),
        ("alpha", "f32", floats(&[0.5])),
        ("rgb", "f32", floats(&[0.5, 0.5, 0.5])),
        ("scales", "f32", floats(&[1.0, 1.0, 1.0])),
        ("orientation", "f32", floats(&[0.0, 0.0, 0.0, 1.0])),
        ("sh1", "f32", floats(&[0.25; 9])),
    ];
    if has_tree {
        first.push(("child_count", "u16", vec![1, 0, 0, 0]));
        second.push(("child_count", "u16", vec![0, 0]));
    }
    let chunks = [rad_chunk(0, 2, &first, true), rad_chunk(2, 1, &second, false)];
    let json = format!(
        r#"{{"version":1,"type":"gsplat","count":3,"maxSh":1,"lodTree":{has_tree},"chunkSize":2,"allChunkBytes":{},
        "chunks":[{{"offset":0,"bytes":{}}},{{"offset":{},"bytes":{}}}]}}"#,
        chunks[0].len() + chunks[1].len(),
        chunks[0].len(),
        chunks[0].len(),
        chunks[1].len()
    );
    let mut file = b"RAD0".to_vec();
    file.extend((json.len() as u32).to_le_bytes());
    file.extend(json.bytes());
    file.resize(file.len().next_multiple_of(8), 0);
    [file, chunks.concat()].concat()
}

#[test]
fn rad_chunks_and_leaves() {
    let scene = load_bytes("s.rad", &rad(false)).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (3, 1));
    assert_eq!([0, 1, 2].map(|i| gaussians.mean(i)), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0], [7.0, 8.0, 9.0]]);
    assert_close(&gaussians.opacities, &[1.0, 0.2, 0.5], 1e-6);
    assert_close(&gaussians.sh_of(0)[..3], &[1.772_453_9, -1.772_453_9, -1.063_472_3], 1e-5);
    assert_close(&gaussians.sh_of(1)[..2], &[-1.772_453_9, -1.063_472_3], 1e-5);
    assert_eq!((gaussians.sh_of(0)[3], gaussians.sh_of(2)[11]), (1.0, 0.25));
    assert_close(&gaussians.rotation(0), &[0.0, 0.0, 0.0, 1.0], 0.01);
    assert_eq!(gaussians.rotation(2), [1.0, 0.0, 0.0, 0.0]);

    let tree = load_bytes("s.rad", &rad(true)).unwrap();
    assert_eq!(tree.gaussians().means[0], [2.0, 7.0]);
    assert!(tree.details().notes[0].contains("leaves"), "{:?}", tree.details().notes);
    let whole = rad(false);
    for length in 0..whole.len() {
        assert!(load_bytes("cut.rad", &whole[..length]).is_err(), "{length}");
    }
    assert_error(load_bytes("c.bin", b"RADC        "), &["c.bin", "one chunk"]);
}

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
    let options = |level_of_detail, environment| LoadOptions { level_of_detail, environment, axes: None };
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
    let expected = Streamed { levels: 2, has_environment: true };
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

/// A PNG image of `width` pixels a row and 4 channels.
fn png(width: u32, bytes: &[u8]) -> Vec<u8> {
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, width, bytes.len() as u32 / 4 / width);
    encoder.set_color(png::ColorType::Rgba);
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    image
}

/// Two Gaussians of degree 1 of version 1, in PNG images.
pub fn sog_1() -> BTreeMap<String, Vec<u8>> {
    let meta = r#"{"means":{"shape":[2,3],"mins":[-1,-2,0],"maxs":[1,2,3],"files":["l.png","u.png"]},
        "scales":{"shape":[2,3],"mins":[-4,-3,-2],"maxs":[0,0,0],"files":["scales.png"]},
        "quats":{"shape":[2,4],"encoding":"quaternion_packed","files":["quats.png"]},
        "sh0":{"shape":[2,1,4],"mins":[-1,-2,-3,-5],"maxs":[1,2,3,5],"files":["sh0.png"]},
        "shN":{"shape":[2,9],"mins":-1,"maxs":1,"quantization":8,"files":["centroids.png","labels.png"]}}"#;
    let mut palette = vec![0; 64 * 3 * 4];
    palette[12..24].copy_from_slice(&[255, 0, 51, 255, 255, 255, 255, 255, 0, 0, 0, 255]);
    BTreeMap::from([
        ("meta.json".to_owned(), meta.as_bytes().to_vec()),
        ("l.png".to_owned(), png(2, &[0, 0, 0, 255, 255, 255, 255, 255])),
        ("u.png".to_owned(), png(2, &[0, 0, 0, 255, 255, 255, 255, 255])),
        ("scales.png".to_owned(), png(2, &[0, 0, 0, 255, 255, 51, 255, 255])),
        ("quats.png".to_owned(), png(2, &[128, 128, 128, 252, 128, 128, 128, 255])),
        ("sh0.png".to_owned(), png(2, &[0, 0, 0, 0, 255, 255, 51, 255])),
        ("centroids.png".to_owned(), png(192, &palette)),
        ("labels.png".to_owned(), png(2, &[1, 0, 0, 255, 0, 0, 0, 255])),
    ])
}

#[test]
fn sog_version_1_has_bounds_for_codebooks_and_any_image() {
    let scene = load_folder("meta.json", &sog_1(), &LoadOptions::default()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (2, 1));
    let position = |log: f64| (log.abs().exp_m1() * log.signum()) as f32;
    assert_close(&gaussians.mean(0), &[position(-1.0), position(-2.0), 0.0], 1e-5);
    assert_close(&gaussians.mean(1), &[position(1.0), position(2.0), position(3.0)], 1e-4);
    assert_close(&gaussians.scale(0), &[(-4f32).exp(), (-3f32).exp(), (-2f32).exp()], 1e-6);
    assert_close(&gaussians.scale(1), &[1.0, (-2.4f32).exp(), 1.0], 1e-6);
    let sigmoid = |v: f32| 1.0 / (1.0 + (-v).exp());
    assert_close(&gaussians.opacities, &[sigmoid(-5.0), sigmoid(5.0)], 1e-6);
    assert_close(&gaussians.sh_of(1)[..3], &[1.0, 2.0, -1.8], 1e-5);
    assert_close(&gaussians.sh_of(0)[3..], &[1.0, -1.0, -0.6, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0], 1e-5);
}

#[test]
fn sog_says_its_mode_by_either_name() {
    let with = |from: &str, to: &str| {
        let mut files = sog();
        let meta = String::from_utf8(files["meta.json"].clone()).unwrap();
        assert!(meta.contains(from));
        files.insert("meta.json".to_owned(), meta.replacen(from, to, 1).into_bytes());
        load_folder("meta.json", &files, &LoadOptions::default()).unwrap()
    };
    let (stated, none) = ("\"antialias\":true", "\"antialias\":false");
    assert_eq!(with(stated, stated).opacity_mode(), OpacityMode::Antialiased);
    assert_eq!(with(stated, none).opacity_mode(), OpacityMode::Default);
    assert_eq!(with(stated, "\"model\":\"antialiased\"").opacity_mode(), OpacityMode::Antialiased);
    let flat = with(stated, "\"model\":\"2dgs\",\"extra\":1");
    assert_eq!(flat.opacity_mode(), OpacityMode::Default);
    let notes = flat.details().notes.join("; ");
    assert!(notes.contains("2dgs") && notes.contains("extra"), "{notes}");
}
