//! Shows trained 3D Gaussian Splatting scenes sharp and fluid. Few pixels are rasterized, together with data that
//! Gaussians give for free (exact image gradients, depth, normals). The other pixels are reconstructed.
//!
//! [`FramePipeline`] makes whole frames; the command, the benchmark and the evaluation all call it. Open, render,
//! super-sample:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use gs3::{FramePipeline, Mode, PipelineSettings, scene::demo};
//!
//! let scene = demo::scene()?; // or gs3::open("garden.ply")?
//! let path = demo::path().resized(320, 180)?; // or gs3::scene::capture::load("cameras.json")?
//! let settings = PipelineSettings { mode: Mode::Full, ..Default::default() };
//! let mut pipeline = FramePipeline::new(scene, settings)?;
//! for camera in &path.cameras()[..2] {
//!     let frames = pipeline.render(camera)?; // 80×45 pixels rasterized, 320×180 shown
//!     assert_eq!((frames.current.width(), frames.current.height()), (320, 180));
//! }
//! # Ok(())
//! # }
//! ```
//!
//! `gs3 render` does the same by default. [`PipelineSettings::refine`] chooses the pixels that are rasterized exactly
//! besides. For interactive programs, [`Refine::FrameTime`] keeps the time of a frame constant. Networks can refine
//! the frames; [`Networks::shipped`] come with gs3. The interpolation network is left out here, because warping is
//! nearly as good and faster:
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
//! On a GPU ([`compute`], feature `gpu`) each whole frame is one submission. Images are read back, or stay on the GPU
//! for a program that shows them itself (`FramePipeline::render_to_device`, on the program's own device by
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
//! Kernels are closures that must be inlined into functions compiled for wide vectors. A program that embeds gs3
//! should set `lto = "thin"` in its release profile (`docs/performance.md` has the cost of not setting it).
//!
//! The parts can be used alone: [`raster`] makes G-buffers, [`reconstruct`] turns G-buffers of any renderer into
//! high-resolution frames, and [`scene`] holds scenes, cameras and their files.
//!
//! # With a renderer of your own
//!
//! [`Reconstructor`] takes frames of any renderer: colour, depth, and optionally the colour's derivatives per LR
//! pixel. They are sampled at pixel centres plus the jitter that the reconstructor asks for. The reconstructor
//! detects camera cuts, super-samples, interpolates and keeps the history. Planes are read in place
//! ([`reconstruct::GBufferView`]), and depth buffers in their own encoding ([`reconstruct::DepthEncoding`]).
//!
//! Derivatives must be the visible surface's. Exact derivatives are worth most ([`reconstruct::difference`] gives the
//! cost of other derivatives). Filter textures for the HR grid, for example by a LOD bias of −log₂ S.
//!
//! Surfaces are followed by depths and cameras. For objects that move, the renderer must give their motion:
//! [`motion`](reconstruct::GBufferView::motion) are the vectors that FSR and DLSS take. **Without motion vectors
//! everything shown must stand still.** Lights, shadows and reflections that move over a resting surface are seen up
//! to S² frames late.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use gs3::Reconstructor;
//! use gs3::glam::{DAffine3, DVec3};
//! use gs3::reconstruct::{DepthEncoding, GBufferView, PlanesView, ReconstructorSettings};
//! use gs3::scene::{Camera, Intrinsics, Size};
//!
//! // What a renderer has: RGBA and a reversed depth buffer, here of a grey wall five units away.
//! let render = |_lr: &Camera, _jitter: [f32; 2]| (vec![0.5; 16 * 9 * 4], vec![0.1 / 5.0; 16 * 9]);
//!
//! let mut reconstructor = Reconstructor::new(ReconstructorSettings { scale: 4, ..Default::default() })?;
//! for k in 0..3 {
//!     let pose = DAffine3::from_translation(DVec3::new(-0.01 * f64::from(k), 0.0, 0.0));
//!     let camera = Camera::new(pose, Intrinsics::from_fov_y(64, 36, 1.0))?;
//!     let jitter = reconstructor.next_jitter(&camera);
//!     let lr = camera.low_resolution(4);
//!     let (rgba, depth) = render(&lr, jitter);
//!     let color = PlanesView::interleaved(&rgba, lr.size(), 4)?;
//!     let depth = PlanesView::planar(&depth, lr.size())?;
//!     let frame = GBufferView {
//!         encoding: DepthEncoding::Reversed { near: 0.1, far: f32::INFINITY },
//!         ..GBufferView::new(color, depth, jitter)
//!     };
//!     let shown = reconstructor.reconstruct(&camera, &frame)?; // those between, and then this one
//!     assert_eq!(shown.current.size(), Size::new(64, 36));
//!     assert_eq!(shown.in_between.len(), usize::from(k > 0));
//! }
//! # Ok(())
//! # }
//! ```

mod error;
mod frame;
pub mod learned;
mod machine;
mod now;
mod rasterizer;
mod refine;
mod scale;
mod session;
mod settings;
mod stages;

#[cfg(feature = "fs")]
use std::path::Path;

pub use error::{NetworkError, PipelineError};
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
pub use gs3_reconstruct::{
    AdaptiveJitter, DepthLattice, Kriging, Reconstructor, ResetReason, Sampling, is_cut, margin_ahead,
};
pub use gs3_scene as scene;
pub use gs3_scene::glam;
pub use gs3_simd as simd;
pub use learned::Networks;
pub use machine::{Backend, BackendError, Machine};
pub use refine::{Quality, Refine, RefineError};
pub use scale::{Scale, ScaleError};
pub use session::{Session, SessionSettings};
pub use settings::{Dilation, IN_BETWEEN, KEYFRAMES, MAX_IN_BETWEEN, Mode, PipelineSettings};
pub use stages::{Stage, StageTimes};

#[cfg(feature = "fs")]
use gs3_scene::{
    Scene,
    format::{LoadError, LoadOptions},
};

/// Opens a trained scene of any supported format ([`gs3_scene::format`]) at its finest level of detail.
///
/// # Errors
/// [`LoadError`], naming file, field, expected and actual.
#[cfg(feature = "fs")]
pub fn open(path: impl AsRef<Path>) -> Result<Scene, LoadError> {
    gs3_scene::format::load(path, &LoadOptions::default(), &|_| {})
}
