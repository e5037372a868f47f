//! Rasterizes 3D Gaussians to a G-buffer: colour, exact image gradients, depth, normals, alpha.
//!
//! The stages of a frame are [`cpu`]'s modules, one file each: `project` (Gaussians to splats), `bin` (splats to
//! tiles), `blend` (tiles to pixels). Gaussians nearer than the scene's near plane `near` (view-space z, in the
//! scene's details; [`NEAR`] by default) are culled. This crate knows nothing of reconstruction, networks or files.
//!
//! ```
//! use std::sync::Arc;
//! use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
//! use gs3_scene::{Camera, GBuffer, Gaussians, Intrinsics, OpacityMode, Scene};
//!
//! let mut gaussians = Gaussians::zeroed(1, 0);
//! gaussians.scales = [vec![0.1], vec![0.1], vec![0.1]];
//! gaussians.rotations[0][0] = 1.0;
//! gaussians.opacities[0] = 0.9;
//! let scene = Arc::new(Scene::new(gaussians, OpacityMode::Default)?);
//! let pose = glam::DAffine3::from_translation(glam::DVec3::new(0.0, 0.0, 2.0));
//! let camera = Camera::new(pose, Intrinsics::from_fov_y(64, 48, 1.0))?;
//!
//! let mut rasterizer = Rasterizer::new(scene, Culling::Exact);
//! let settings = RasterSettings { dilation: matched_dilation(4), ..RasterSettings::new(Outputs::GBuffer) };
//! let mut gbuffer = GBuffer::default();
//! rasterizer.rasterize(&camera, &settings, &mut gbuffer)?;
//! assert!(gbuffer.alpha.row(0, 24)[32] > 0.8);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chunk;
pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
mod settings;
mod view;

pub use cpu::{Importance, LIST_MEMORY, RasterTimes, Rasterizer};
pub use fearless_simd::Level;
#[cfg(feature = "gpu")]
pub use gpu::{
    BLOCKS_STAGE, CapacityCheck, EXACT_BLOCK_BYTES, GpuBlocks, GpuGBuffer, GpuRasterError, GpuRasterizer,
    LowResolution, ScenePrecision,
};
pub use settings::{
    Culling, ExpectedDepth, KERBL_DILATION, MAX_MARGIN, Outputs, RasterError, RasterSettings, Rules, Window,
    matched_dilation,
};
pub use view::NEAR;
