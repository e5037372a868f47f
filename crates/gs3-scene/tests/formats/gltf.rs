//! glTF, spelled out here, independent of the writer.

use std::collections::BTreeMap;

use gs3_scene::OpacityMode;
use gs3_scene::format::LoadOptions;

use crate::handmade::spz;
use crate::{assert_close, assert_error, load_bytes, load_folder};

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

/// A primitive with the Gaussians of `spz`.
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
