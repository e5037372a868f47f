//! Trained 3D Gaussian Splatting scenes, cameras and camera paths, images, and their file formats.
//!
//! This crate knows nothing of devices, rasterization or networks. Everything that enters gs3 from outside is checked
//! here once, at the border; behind it no check is repeated and nothing panics.

pub mod axes;
pub mod camera;
pub mod camera_path;
pub mod capture;
pub mod demo;
mod exact_blocks;
pub mod format;
pub mod gaussians;
pub mod gbuffer;
pub mod image;
pub mod info;
pub mod jitter;
pub mod lens;
pub mod orbit;
mod png_file;
pub mod scene;
mod size;
pub mod transform;

pub use glam;

pub use axes::Axes;
pub use camera::{Camera, CameraError, Intrinsics};
pub use camera_path::CameraPath;
pub use exact_blocks::{BLOCK_SIDE, ExactBlock, ExactBlocks, block_grid};
pub use gaussians::Gaussians;
pub use gbuffer::{GBuffer, Geometry, Gradients, Margin, Planes};
pub use image::Image;
pub use jitter::Jitter;
pub use lens::Lens;
pub use png_file::{PngChannels, write_png, write_png_rows};
pub use scene::{Details, Dropped, OpacityMode, Scene, SceneError};
pub use size::Size;
