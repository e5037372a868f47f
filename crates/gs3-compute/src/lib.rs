//! GPU devices, and work on them: buffers, kernels, one submission per frame with its stages timed.
//!
//! [`Gpu`] is an open device. A [`Module`] is a WGSL source, a [`Kernel`] is one of its entry points, and a [`Bound`]
//! kernel has its buffers; these are made once. A frame is a [`Recorder`], into which stages write dispatches, and is
//! submitted once. Every failure is a [`GpuError`]; nothing here panics because of a device.
//!
//! This crate knows nothing of what is computed.

mod adapter;
mod allocations;
mod arena;
mod buffer;
mod capabilities;
mod ceilings;
mod chunks;
mod device_id;
mod error;
mod for_tests;
mod gpu;
mod grid;
mod kernel;
mod pools;
mod readback;
mod recorder;
mod scan;
mod scopes;
mod sort;
mod submission;
mod timings;
mod uploads;
mod waiting;
mod wgsl;

pub use adapter::{AdapterChoice, AdapterKind, AdapterReport, Api, adapters, choose};
pub use allocations::Allocations;
pub use arena::{Arena, Fit, Need};
pub use buffer::{Buffer, Slice, Use};
pub use capabilities::{Capabilities, Limits, OptionalFeatures, Subgroups};
pub use ceilings::Ceilings;
pub use chunks::ChunkPlan;
pub use error::GpuError;
#[doc(hidden)]
pub use for_tests::{device_for_tests, skip_without_gpu};
pub use gpu::{Gpu, GpuSettings};
pub use grid::{GRID_ROW, grid, grid_source};
pub use kernel::{Bound, Kernel, Module};
pub use readback::Readback;
pub use recorder::Recorder;
pub use scan::{BoundScan, Scan};
pub use sort::{BoundSort, MAX_PAIRS, Pairs, Sort, SortPlan};
pub use submission::Submission;
pub use timings::{StageTime, Timings};
pub use waiting::now;
pub use wgpu;
pub use wgsl::{Number, StructLayout, constants, storage_bindings, struct_layout, validate};
