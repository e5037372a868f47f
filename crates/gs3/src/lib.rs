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
//! let scene = demo::scene()?; // or gs3::open("garden.ply")?
//! let path = demo::path().resized(320, 180)?; // or gs3::scene::capture::load("cameras.json")?
//! let settings = PipelineSettings { mode: Mode::Full, scale: 4, ..Default::default() };
//! let mut pipeline = FramePipeline::new(scene, settings)?;
//! for camera in &path.cameras()[..2] {
//!     let frames = pipeline.render(camera)?; // 80×45 pixels rasterized, 320×180 shown
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
//! let pipeline = FramePipeline::with_networks(demo::scene()?, PipelineSettings::default(), &networks)?;
//! # Ok(())
//! # }
//! ```
//!
//! On a GPU ([`compute`], feature `gpu`) whole frames are made in one submission each; images come back, or stay there
//! for a program that shows them itself (`FramePipeline::render_to_device`, on a device of its own by
//! `compute::Gpu::of`):
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # use gs3::{FramePipeline, PipelineSettings, scene::demo};
//! # #[cfg(feature = "gpu")] {
//! use gs3::compute::{Gpu, GpuSettings};
//!
//! let camera = demo::path().resized(160, 88)?.cameras()[0];
//! let mut pipeline = FramePipeline::new(demo::scene()?, PipelineSettings::default())?;
//! match Gpu::new(&GpuSettings::default()) {
//!     Ok(gpu) => {
//!         pipeline.render_on(&gpu)?;
//!         if pipeline.render(&camera).is_err() {
//!             pipeline.render_on_cpu()?; // a device may be lost at any time
//!         }
//!     }
//!     Err(error) => println!("{error}; the CPU renders"),
//! }
//! # }
//! # Ok(())
//! # }
//! ```
//!
//! Kernels are closures that must end up in functions compiled for wide vectors: a program that embeds gs3 does well
//! to set `lto = "thin"` in its release profile (`docs/performance.md` has what it loses without).
//!
//! The parts are usable alone: [`raster`] makes G-buffers, [`reconstruct`] turns those of any renderer into
//! high-resolution frames, [`scene`] holds scenes, cameras and their files.
//!
//! # With a renderer of your own
//!
//! Reconstruction reads colour, its derivatives per LR pixel, and median depth (networks, [`learned`], also normals and
//! alpha), sampled at pixel centres plus the jitter. **What is shown must stand still**: surfaces are followed by
//! depths and cameras, and there is no input for other motion, so what moves by itself smears, and comes out worse than
//! enlarged. Derivatives are those of the visible surface: exact ones are worth most (`docs/results.md`, *Parts left
//! out*), and where a silhouette crosses a difference of colours they mislead. Textures are filtered for the HR grid,
//! as by a LOD bias of −log₂ S. The order of a frame:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use gs3::glam::{DAffine3, DVec3};
//! use gs3::reconstruct::{Interpolator, Neighbor, SuperSampler};
//! use gs3::scene::{Camera, GBuffer, Image, Intrinsics, camera_path::pose_between};
//! use gs3::{AdaptiveJitter, DepthLattice, Kriging, ResetReason, Sampling, is_cut};
//!
//! // What the renderer fills; here a grey wall five units away.
//! let render = |lr: &Camera, jitter: [f32; 2]| {
//!     let mut gbuffer = GBuffer::zeroed(lr.width() as usize, lr.height() as usize);
//!     gbuffer.jitter = jitter;
//!     gbuffer.color.data_mut().fill(0.5);
//!     if let Some(geometry) = &mut gbuffer.geometry {
//!         geometry.depth_median.data_mut().fill(5.0);
//!     }
//!     gbuffer
//! };
//! let scale = 4;
//! let mut sampler = SuperSampler::new(scale, Kriging::On)?;
//! let mut interpolator = Interpolator::new(scale)?;
//! let mut jitter = AdaptiveJitter::new(scale, Sampling::Jittered);
//! let mut last: Option<(Camera, GBuffer, Image)> = None;
//! for k in 0..3 {
//!     let pose = DAffine3::from_translation(DVec3::new(-0.01 * f64::from(k), 0.0, 0.0));
//!     let camera = Camera::new(pose, Intrinsics::from_fov_y(64, 36, 1.0))?;
//!     let depths = last.as_ref().map(|(_, gbuffer, _)| DepthLattice::of(gbuffer)).unwrap_or_default();
//!     if last.as_ref().is_some_and(|(before, ..)| is_cut(before, &camera, &depths)) {
//!         sampler.reset(ResetReason::CameraCut);
//!         jitter.reset();
//!         last = None;
//!     }
//!     let offset = jitter.next(&camera, &depths);
//!     let gbuffer = render(&camera.low_resolution(scale), offset);
//!     let mut image = Image::default();
//!     sampler.super_sample(&camera, &gbuffer, &mut image)?;
//!     if let Some((before, before_gbuffer, before_image)) = &last {
//!         let from = Neighbor { camera: before, image: before_image, gbuffer: before_gbuffer };
//!         let to = Neighbor { camera: &camera, image: &image, gbuffer: &gbuffer };
//!         let mut between = Image::default(); // to be shown before `image`
//!         interpolator.interpolate(from, to, 0.5, &pose_between(before, &camera, 0.5), &mut between)?;
//!         assert_eq!((between.width(), between.height()), (64, 36));
//!     }
//!     last = Some((camera, gbuffer, image));
//! }
//! # Ok(())
//! # }
//! ```

mod cut;
mod error;
mod frame;
mod jitter;
mod lattice;
pub mod learned;
mod overscan;
mod rasterizer;
mod refine;
mod settings;
mod stages;

use std::path::Path;

pub use cut::is_cut;
pub use error::PipelineError;
#[cfg(feature = "gpu")]
pub use frame::GpuPresented;
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
pub use gs3_simd as simd;
pub use jitter::AdaptiveJitter;
pub use lattice::DepthLattice;
pub use learned::{NetworkError, Networks};
pub use overscan::margin_ahead;
pub use refine::{Quality, Refine, RefineError};
pub use settings::{Dilation, MAX_GENERATE, Mode, PipelineSettings, Sampling};
pub use stages::{Stage, StageTimes};

use gs3_scene::Scene;
use gs3_scene::format::{LoadError, LoadOptions};

/// Opens a trained scene of any supported format ([`gs3_scene::format`]) at its finest level of detail.
///
/// # Errors
/// [`LoadError`], naming file, field, expected and actual.
pub fn open(path: impl AsRef<Path>) -> Result<Scene, LoadError> {
    gs3_scene::format::load(path, &LoadOptions::default(), &|_| {})
}
