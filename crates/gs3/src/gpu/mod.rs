//! The frame on a GPU: rasterized, super-sampled and interpolated in one submission; only what is shown comes back.

mod between;
mod device;
mod frames;
mod learned;
mod sized;

pub(crate) use device::Device;
pub(crate) use frames::Take;
pub use frames::{GpuFrames, GpuPresented, GpuRequest};
