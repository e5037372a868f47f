//! Synthetic clips: a moving pattern, seen at low resolution, and a blurred history.

use std::path::Path;

use gs3::scene::Jitter;
use gs3_neural::model::Tier;
use gs3_neural::{Random, Shape};
use gs3_train::clip::{HIDDEN, to_unorm};
use gs3_train::{Clip, ClipFrame, ClipPlane, Length, Network, Settings, TrainedNetwork};
use half::f16;

pub const SCALE: u32 = 2;

/// Small and quick.
pub fn settings(network: Network, steps: u64) -> Settings {
    Settings {
        batch: 3,
        window: 3,
        crop: 12,
        warm_up: 5,
        ..Settings::new(TrainedNetwork::Own { network, tier: Tier::Fast }, SCALE, Length::Steps(steps))
    }
}

/// A clip of a pattern of two waves that moves. Images that the network refines are the truth minus half of
/// its high wave, with an uncertainty of 1; `color` is the truth at the jittered LR grid. Everything else is noise.
pub fn clip(network: Network, frames: usize, lr: [usize; 2], seed: u64) -> Clip {
    let mut random = Random::new(seed);
    let [phase, speed] = [6.0 * random.unit(), 0.3 * random.signed()];
    let graph = network.graph(SCALE, Tier::Fast).unwrap();
    let shapes = graph.shapes(lr).unwrap();
    let wave = |x: f32, y: f32, c: usize, frame: usize, detail: f32| {
        let x = x + speed * frame as f32 + phase;
        0.5 + 0.2 * (0.9 * x + 0.5 * y + c as f32).sin() + 0.2 * detail * (2.3 * x - 1.9 * y).sin()
    };
    // Sampled at pixel centres, moved by `offset`, in LR pixels.
    let image_at = |shape: Shape, channels: usize, frame: usize, detail: f32, offset: [f32; 2]| {
        let factor = (shape.height / lr[0]) as f32;
        let mut values = Vec::new();
        for y in 0..shape.height {
            for x in 0..shape.width {
                let [x, y] = [(x, 0), (y, 1)].map(|(v, axis)| (v as f32 + 0.5) / factor + offset[axis]);
                values.extend((0..channels).map(|c| if c < 3 { wave(x, y, c, frame, detail) } else { 1.0 }));
            }
        }
        values
    };
    let image = |shape, channels, frame, detail| image_at(shape, channels, frame, detail, [0.0; 2]);
    let jitter = Jitter::grid(SCALE);
    let mut all = Vec::new();
    for frame in 0..frames {
        let offset = jitter.offset(frame as u64);
        let mut inputs = Vec::new();
        for (tensor, layer) in graph.inputs().filter(|(_, layer)| layer.name != HIDDEN) {
            let shape = shapes[tensor.index()];
            let values = match layer.name.as_str() {
                "history" | "previous" | "before" | "after" => image(shape, 4, frame, 0.5),
                "color" => image_at(shape, 3, frame, 1.0, offset),
                "jitter" => offset.repeat(shape.pixels()),
                "validity" => vec![1.0; shape.len()],
                "share" => vec![0.5; shape.len()],
                "drift" => vec![0.0; shape.len()],
                _ => (0..shape.len()).map(|_| 0.3 * random.signed()).collect(),
            };
            let values = values.into_iter().map(f16::from_f32).collect();
            inputs.push(ClipPlane { name: layer.name.clone(), channels: shape.channels, values });
        }
        let [height, width] = lr.map(|side| side * SCALE as usize);
        let target = image(Shape { height, width, channels: 3 }, 3, frame, 1.0);
        all.push(ClipFrame { inputs, target: target.into_iter().map(to_unorm).collect() });
    }
    Clip { network, scene: format!("waves {seed}"), scale: SCALE, lr, frames: all }
}

/// A folder of clips to train on and to validate on.
pub fn write_clips(folder: &Path, network: Network) {
    for seed in 0..3 {
        clip(network, 5, [18, 16], seed).save(&folder.join(format!("waves-{seed}.clip"))).unwrap();
    }
    clip(network, 4, [14, 20], 9).save(&folder.join("held-waves.clip")).unwrap();
}
