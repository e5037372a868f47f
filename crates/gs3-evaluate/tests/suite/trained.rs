//! Published networks with weights of gs3's trainer as methods: where they put samples, what they refuse.

use std::sync::Arc;

use crate::common::{gbuffer, image};
use gs3::Culling;
use gs3::neural::model::PublishedNetwork;
use gs3::neural::{Header, Weights};
use gs3_evaluate::methods::{MethodError, MethodSettings, build};
use gs3_evaluate::network::Trained;
use gs3_evaluate::upscale::{UpscaleError, Upscaler};
use gs3_scene::{Image, demo, orbit};

/// Random weights of `peer` at ×4.
fn weights(peer: PublishedNetwork) -> Weights {
    let graph = peer.graph(4).unwrap();
    Weights::random(&graph, Header { tier: peer.size().to_owned(), ..Header::of(&graph, 4) }, 3)
}

/// An ECBSR that has learned nothing repeats each LR pixel. Frames are sampled where it was trained to see them: the
/// pixel of each 4×4 block that the sample is at is that of the native frame.
#[test]
fn samples_are_where_networks_expect_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut nothing = weights(PublishedNetwork::Ecbsr);
    nothing.arrays.values_mut().for_each(|array| array.values_mut().fill(0.0));
    nothing.save(folder.path().join("ecbsr_x4.safetensors")).unwrap();
    let scene = Arc::new(demo::scene().unwrap());
    let camera = orbit::around(&scene, 8, 96, 64).unwrap().cameras()[3];
    let settings = MethodSettings {
        scene,
        scale: 4,
        culling: Culling::AccuTile,
        background: [0.1, 0.2, 0.3],
        training: Vec::new(),
        weights: Some(folder.path().to_owned()),
    };
    let frame = |method: &str| {
        let mut method = build(method.parse().unwrap(), &settings).unwrap();
        method.render(&camera, &[]).unwrap().current.clone()
    };
    let (native, made) = (frame("native"), frame("ecbsr_trained"));
    let sample = PublishedNetwork::Ecbsr.sample(4);
    let mut worst = [0.0_f32; 2];
    for y in (0..64).step_by(4) {
        for x in (0..96).step_by(4) {
            // Neither the neighbouring pixels: the scene is no flat colour.
            for (worst, place) in worst.iter_mut().zip([sample, sample + 1]) {
                let (made, native) = (made.row(y + place)[x + place], native.row(y + place)[x + place]);
                (0..3).for_each(|c| *worst = worst.max((made[c] - native[c].clamp(0.0, 1.0)).abs()));
            }
        }
    }
    eprintln!("largest difference at samples {}, beside them {}", worst[0], worst[1]);
    assert!(worst[0] < 1e-4 && worst[1] > 0.05, "{worst:?}");
}

#[test]
fn images_of_any_size_are_enlarged() {
    let whole = image("coffee_lr.png");
    for peer in PublishedNetwork::ALL {
        let mut network = Trained::new(peer, weights(peer)).unwrap();
        // An odd size is the even one with its last row and column repeated.
        let (odd, even) =
            (crate::common::crop(&whole, 0, 0, 21, 13), crate::common::crop(&whole, 0, 0, 22, 14));
        let mut repeated = gbuffer(&even);
        for c in 0..3 {
            for y in 0..14 {
                for x in 0..22 {
                    let value = odd.row(y.min(12))[x.min(20)][c];
                    repeated.color.data_mut()[(c * 14 + y) * 22 + x] = value;
                }
            }
        }
        let [mut small, mut large] = [Image::new(84, 52), Image::new(88, 56)];
        network.upscale(&gbuffer(&odd), 4, &mut small).unwrap();
        network.upscale(&repeated, 4, &mut large).unwrap();
        for y in 0..52 {
            assert_eq!(small.row(y), &large.row(y)[..84], "{peer:?} {y}");
        }
        let refused = network.upscale(&gbuffer(&odd), 2, &mut small).unwrap_err();
        assert!(matches!(refused, UpscaleError::Scale { expected: 4, actual: 2, .. }), "{refused}");
        let wrong = network.upscale(&gbuffer(&odd), 4, &mut large).unwrap_err();
        assert!(matches!(wrong, UpscaleError::Size { .. }), "{wrong}");
    }
}

/// What comes with the crate is whole, of its network and better than nothing learned: a flat image stays flat.
#[test]
fn shipped_weights_keep_flat_images() {
    let mut count = 0;
    for peer in PublishedNetwork::ALL {
        let Some(bytes) = Trained::shipped(peer, 4) else { continue };
        let mut network = Trained::new(peer, Weights::from_bytes(bytes).unwrap()).unwrap();
        for value in [0.2, 0.7] {
            let flat = Image::from_pixels(20, 16, vec![[value, 0.5 * value, 1.0 - value, 1.0]; 320]).unwrap();
            let mut out = Image::new(80, 64);
            network.upscale(&gbuffer(&flat), 4, &mut out).unwrap();
            // Where the window of all layers sees no border.
            let worst = (32..48)
                .flat_map(|x| (0..3).map(move |c| (x, c)))
                .fold(0.0_f32, |most, (x, c)| most.max((out.row(32)[x][c] - flat.row(8)[x / 4][c]).abs()));
            eprintln!("{peer:?} {value}: {worst}");
            assert!(worst < 0.02, "{peer:?}: {worst}");
        }
        count += 1;
    }
    assert!(count > 0, "no weights");
}

#[test]
fn weights_of_another_network_are_refused() {
    let refused =
        Trained::new(PublishedNetwork::Rt4ksr, weights(PublishedNetwork::Ecbsr)).unwrap_err().to_string();
    assert_eq!(refused, "header, network: expected rt4ksr, found ecbsr");
    let mut other = weights(PublishedNetwork::Ninasr);
    other.header.tier = "b0".to_owned();
    let refused = Trained::new(PublishedNetwork::Ninasr, other).unwrap_err().to_string();
    assert_eq!(refused, "header, tier: expected b1, found b0");
    // No weights for ×2 come with gs3.
    let scene = Arc::new(demo::scene().unwrap());
    let settings = MethodSettings {
        scene,
        scale: 2,
        culling: Culling::AccuTile,
        background: [0.0; 3],
        training: Vec::new(),
        weights: None,
    };
    let refused = build("rt4ksr_trained".parse().unwrap(), &settings).err().unwrap();
    assert!(matches!(refused, MethodError::NoWeights { .. }), "{refused}");
}
