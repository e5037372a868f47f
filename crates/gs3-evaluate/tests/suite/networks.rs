//! Published networks against PyTorch; `oracle/networks.py` made the values. The weights are not part of the
//! repository.

use std::path::Path;

use crate::common::{data, gbuffer, image};
use gs3_evaluate::network::{PublishedWeightError, PublishedWeights, Rt4ksr, Safmn, Span};
use gs3_evaluate::upscale::{UpscaleError, Upscaler};
use gs3_scene::Image;
use serde_json::Value;

#[test]
fn networks_agree_with_pytorch() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/weights"));
    if !folder.is_dir() {
        eprintln!("skipped: no published weights beside the workspace");
        return;
    }
    let load = |name: &str| PublishedWeights::load(&folder.join(name)).unwrap();
    let oracle: Value = serde_json::from_slice(&std::fs::read(data("networks.json")).unwrap()).unwrap();
    let lr = gbuffer(&image("coffee_lr.png"));
    let mut networks: [(&str, Box<dyn Upscaler>); 3] = [
        ("span", Box::new(Span::new(&load("span28_x4.safetensors")).unwrap())),
        ("safmn", Box::new(Safmn::new(&load("safmnpp_light_x4.safetensors")).unwrap())),
        ("rt4ksr", Box::new(Rt4ksr::new(&load("rt4ksr_x2.safetensors")).unwrap())),
    ];
    for (name, network) in &mut networks {
        let mut out = Image::new(200, 160);
        network.upscale(&lr, 4, &mut out).unwrap();
        for point in oracle[&*name].as_array().unwrap() {
            let [x, y] = ["x", "y"].map(|k| point[k].as_u64().unwrap() as usize);
            for c in 0..3 {
                let (expected, actual) = (point["rgb"][c].as_f64().unwrap() as f32, out.row(y)[x][c]);
                // f32 through some twenty layers, summed in another order.
                assert!((actual - expected).abs() < 2e-4, "{name} ({x}, {y}): {expected}, found {actual}");
            }
        }
        assert!(matches!(network.upscale(&lr, 3, &mut out), Err(UpscaleError::Scale { actual: 3, .. })));
    }
}

#[test]
fn unusable_weights_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    assert!(matches!(PublishedWeights::load(&path), Err(PublishedWeightError::Read(_))));
    std::fs::write(&path, [255; 40]).unwrap();
    let error = PublishedWeights::load(&path).unwrap_err().to_string();
    assert!(error.contains("weights.safetensors: expected safetensors, found"), "{error}");
    let file = |header: &str, values: usize| {
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.as_bytes());
        bytes.resize(bytes.len() + 4 * values, 0);
        std::fs::write(&path, bytes).unwrap();
        PublishedWeights::load(&path)
    };
    let empty = file("{}", 0).unwrap();
    let error = Span::new(&empty).unwrap_err().to_string();
    assert!(error.contains("weights.safetensors: conv_1.eval_conv.weight: expected f32"), "{error}");
    let header = r#"{"module.head.0.weight":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]}}"#;
    let error = Rt4ksr::new(&file(header, 6).unwrap()).unwrap_err();
    assert!(error.to_string().contains("expected f32 [24, 12, 3, 3], found [2, 3]"), "{error}");
}
