//! SOG version 1, spelled out here.

use std::collections::BTreeMap;

use gs3_scene::OpacityMode;
use gs3_scene::format::LoadOptions;

use crate::handmade::sog;
use crate::{assert_close, load_folder};

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
