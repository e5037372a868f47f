//! Reconstructs high-resolution (HR) frames from low-resolution (LR) G-buffers without learning.
//!
//! Inputs are plain: a [`GBuffer`](gs3_scene::GBuffer) of any renderer, cameras and jitter. Surfaces are followed by
//! their depths and the cameras. Moving objects are followed by motion vectors, and only by the [`Reconstructor`].
//! This crate knows nothing of Gaussians or networks, and nothing of devices outside feature `gpu`. Results do not
//! depend on the number of threads.
//!
//! * [`resample()`]: nearest, bilinear, bicubic; the baselines.
//! * [`hermite()`]: one frame, with its exact gradients.
//! * [`Reconstructor`]: a sequence of frames, with everything needed in one object.
//! * [`SuperSampler`]: one frame with its history.
//! * [`Interpolator`]: an in-between frame of two reconstructed frames, or both of them warped to its pose; one frame
//!   as another camera sees it.
//! * [`Motion`]: where the surfaces of an LR frame were in another one.
//!
//! ```
//! use gs3_reconstruct::{Interpolator, Kriging, Neighbor, SuperSampler};
//! use gs3_scene::{Camera, GBuffer, Image, Intrinsics};
//!
//! // A renderer fills these; here everything is black and infinitely far.
//! let render = |camera: &Camera, jitter: [f32; 2]| {
//!     GBuffer { jitter, ..GBuffer::zeroed(camera.width() as usize, camera.height() as usize) }
//! };
//! let camera = Camera::new(glam::DAffine3::IDENTITY, Intrinsics::from_fov_y(64, 36, 1.0))?;
//!
//! let mut sampler = SuperSampler::new(4, Kriging::On)?;
//! let (mut before, mut after, mut between) = (Image::default(), Image::default(), Image::default());
//! let earlier = render(&camera.low_resolution(4), [-0.125, 0.125]);
//! sampler.super_sample(&camera, &earlier, &mut before)?;
//! let later = render(&camera.low_resolution(4), [0.125, -0.125]);
//! sampler.super_sample(&camera, &later, &mut after)?;
//!
//! let from = Neighbor { camera: &camera, image: &before, gbuffer: &earlier, gradients: None };
//! let to = Neighbor { camera: &camera, image: &after, gbuffer: &later, gradients: None };
//! Interpolator::new(4)?.interpolate(from, to, 0.5, &camera, &mut between)?;
//! assert_eq!((between.width(), between.height()), (64, 36));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cpu;
mod cut;
mod depth_lattice;
mod difference;
mod error;
#[cfg(feature = "gpu")]
pub mod gpu;
mod jitter;
mod margin;
mod reconstructor;
mod reprojection;
mod sample_grid;
mod sequence;
mod settings;
mod staleness;
mod view;

pub use cpu::block_gradients::BlockGradients;
pub use cpu::hermite::hermite;
pub use cpu::interpolate::{Interpolator, Neighbor, Reprojected, Warped};
pub use cpu::motion::{Depth, DepthView, Motion};
pub use cpu::resample::{ResampleKernel, resample};
pub use cpu::select::{BlockBudget, select_blocks, write_blocks};
pub use cpu::super_sample::SuperSampler;
pub use cut::is_cut;
pub use depth_lattice::DepthLattice;
pub use difference::difference;
pub use error::ReconstructError;
pub use jitter::{AdaptiveJitter, Sampling};
pub use margin::margin_ahead;
pub use reconstructor::{Reconstructed, Reconstructor, ReconstructorSettings};
pub use reprojection::{NEAREST_DEPTH, inverse_depth};
pub use sequence::{FrameSequence, FrameStart, ResetReason};
pub use settings::Kriging;
pub use view::{DepthEncoding, GBufferView, PlanesView, Strides};

/// Largest scale factor, HR over LR.
pub const MAX_SCALE: u32 = 8;

#[cfg(test)]
mod tests {
    /// Runs every kernel test again on each other SIMD level of this CPU.
    #[test]
    fn all_of_this_on_every_simd_level() {
        gs3_simd::repeat_tests_on_levels("all_of_this_on_every_simd_level", &["gpu::"]);
    }
}
