//! Reconstructs high-resolution (HR) frames from low-resolution (LR) G-buffers without learning.
//!
//! Inputs are plain: a [`GBuffer`](gs3_scene::GBuffer) of any renderer, cameras and jitter. This crate knows nothing of
//! Gaussians, devices or networks.

mod error;
mod gather;
mod hermite;
mod interpolate;
mod lattice;
mod middle_depth;
mod neighbor_depth;
mod plausible;
mod reprojection;
mod resample;
mod samples;
mod splat;
mod super_sample;

pub use error::ReconstructError;
pub use hermite::hermite;
pub use interpolate::{Interpolator, Neighbor};
pub use resample::{Kernel, resample};
pub use super_sample::{ResetReason, SuperSampler};

/// Largest scale factor, HR over LR.
pub const MAX_SCALE: u32 = 8;
