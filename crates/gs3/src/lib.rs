//! Shows trained 3D Gaussian Splatting scenes sharp and fluid: rasterizes few pixels together with what only Gaussians
//! give for free (exact image gradients, depth, normals) and reconstructs the rest.
//!
//! [`FramePipeline`] is the whole frame; the command, the benchmark and the evaluation all call it. Open, render,
//! super-sample:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use gs3::{FramePipeline, Mode, PipelineSettings, scene::demo};
//!
//! let scene = demo::scene()?; // or gs3::open("garden.ply".as_ref())?
//! let path = demo::path().resized(320, 180)?; // or gs3::scene::capture::load("cameras.json".as_ref())?
//! let settings = PipelineSettings { mode: Mode::Full, scale: 4, ..Default::default() };
//! let mut pipeline = FramePipeline::new(scene.into(), settings)?;
//! for camera in &path.cameras()[..2] {
//!     let frames = pipeline.render(camera, &[])?; // 80×45 pixels rasterized, 320×180 shown
//!     assert_eq!((frames.current.width(), frames.current.height()), (320, 180));
//! }
//! # Ok(())
//! # }
//! ```
//!
//! [`FramePipeline::new`] does without learning. With networks, of which [`Networks::shipped`] are those that come
//! with gs3, it is as `gs3 render` does it by default; theirs for frames between is left out, since warping is nearly
//! as good and faster:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # use gs3::{FramePipeline, PipelineSettings, scene::demo};
//! use gs3::{Networks, Tier};
//!
//! let networks = Networks { interpolate: None, ..Networks::shipped(4, Tier::Balanced)? };
//! let pipeline = FramePipeline::with_networks(demo::scene()?.into(), PipelineSettings::default(), &networks)?;
//! # Ok(())
//! # }
//! ```
//!
//! Kernels are closures that must end up in functions compiled for wide vectors: a program that embeds gs3 does well
//! to set `lto = "thin"` in its release profile (`docs/performance.md` has what it loses without).
//!
//! The parts are usable alone: [`raster`] makes G-buffers, [`reconstruct`] turns those of any renderer into
//! high-resolution frames, [`scene`] holds scenes, cameras and their files.

mod cut;
mod error;
mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
mod jitter;
mod lattice;
pub mod learned;
mod overscan;
mod rasterizer;
mod settings;
mod stages;

use std::path::Path;

pub use cut::is_cut;
pub use error::PipelineError;
pub use frame::{FramePipeline, Presented};
#[cfg(feature = "gpu")]
pub use gs3_compute as compute;
pub use gs3_neural as neural;
pub use gs3_neural::model::Tier;
pub use gs3_raster as raster;
pub use gs3_raster::Culling;
pub use gs3_reconstruct as reconstruct;
pub use gs3_reconstruct::{Kriging, ResetReason};
pub use gs3_scene as scene;
pub use gs3_scene::glam;
pub use jitter::AdaptiveJitter;
pub use lattice::DepthLattice;
pub use learned::{NetworkError, Networks};
pub use overscan::margin_ahead;
pub use settings::{Dilation, MAX_GENERATE, Mode, PipelineSettings, Sampling};
pub use stages::{Stage, StageTimes};

use gs3_scene::Scene;
use gs3_scene::format::{LoadError, LoadOptions};

/// Opens a trained scene of any supported format ([`gs3_scene::format`]) at its finest level of detail.
///
/// # Errors
/// [`LoadError`], naming file, field, expected and actual.
pub fn open(path: &Path) -> Result<Scene, LoadError> {
    gs3_scene::format::load(path, &LoadOptions::default(), &|_| {})
}
