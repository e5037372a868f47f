//! Reconstruction on GPUs: the same frames as the CPU's, in device memory, through wgpu on any adapter.
//!
//! | stage | shaders beside the CPU's stems | what |
//! |---|---|---|
//! | samples | `samples`, `rectification` | the current LR frame into the history, and what it says about the past |
//! | splat | `cells`, `splat` | every remembered sample to where it is now, counted by its first pixel |
//! | order | `order`, `copy` | the samples into the order of their first pixels |
//! | tile | `hermite`, `ordered`, `tile` | a workgroup a tile: the surface, then the samples over it, in three runs a pixel |
//! | select | `expected_errors`, `select` | the blocks with the largest expected errors, to be rasterized exactly |
//! | blocks | `block_corners`, `blocks` | exact blocks into the history |
//! | depth | `neighbor_depth`, `middle_depth` | depths of both neighbours at the pose between, nearest wins, holes filled |
//! | warp | `gather`, `warp`, `separate` | an invocation four pixels: both neighbours, blended, or the first alone |
//! | | `motion` | where the surfaces of an LR frame were, for what networks remember |
//!
//! No floats are added atomically, and samples with one first pixel are ordered by their numbers, so the same frames give
//! the same bits on a device. Sizes follow from the picture's size alone (`plan`): buffers cannot overflow under any motion. Images
//! and colours of the history are halves; sums and positions are f32.

mod blocks;
mod error;
mod frame;
mod image;
mod interpolate;
mod kriging;
mod motion;
mod plan;
mod select;
mod shaders;
mod side_output;
mod super_sample;

pub use blocks::BoundBlocks;
pub use error::GpuReconstructError;
pub use image::{GpuImage, GpuPlanes};
pub use interpolate::{BoundInterpolator, GpuInterpolator, GpuNeighbor, NeighborView};
pub use motion::{BoundMotion, GpuMotion};
pub use select::GpuBlockSelector;
pub use side_output::SideOutput;
pub use super_sample::{BoundSuperSampler, GpuSuperSampler};
