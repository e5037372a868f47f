//! The whole pipeline. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod architecture;
#[path = "../../../../fuzz/src/entry.rs"]
mod entry;
#[path = "../../../../fuzz/src/found.rs"]
mod found;
mod frame_pipeline;
#[path = "../../../../fuzz/src/frames.rs"]
mod frames;
#[cfg(feature = "gpu")]
mod gpu_frames;
mod hostile;
mod networks;
mod refine;

use std::sync::{Arc, OnceLock};

use gs3::scene::{Image, Scene, demo};

/// The built-in scene, made once.
fn scene() -> Arc<Scene> {
    static SCENE: OnceLock<Arc<Scene>> = OnceLock::new();
    Arc::clone(SCENE.get_or_init(|| Arc::new(demo::scene().unwrap())))
}

/// PSNR of what is shown of two images of one size, dB.
fn psnr(a: &Image, b: &Image) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let shown = |v: f32| f64::from(v.clamp(0.0, 1.0));
    let pairs = a.pixels().iter().zip(b.pixels());
    let squares = pairs.flat_map(|(a, b)| (0..3).map(move |c| (shown(a[c]) - shown(b[c])).powi(2)));
    -10.0 * (squares.sum::<f64>() / (3 * a.pixels().len()) as f64).max(1e-12).log10()
}
