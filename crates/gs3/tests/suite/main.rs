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
#[cfg(feature = "gpu")]
mod gpu_late;
#[cfg(feature = "gpu")]
mod gpu_refine;
mod hostile;
mod networks;
mod refine;

use std::sync::{Arc, OnceLock};

use gs3::scene::{Scene, demo};

/// The built-in scene, made once.
fn scene() -> Arc<Scene> {
    static SCENE: OnceLock<Arc<Scene>> = OnceLock::new();
    Arc::clone(SCENE.get_or_init(|| Arc::new(demo::scene().unwrap())))
}
