//! Exclusive scan of u32.

use crate::buffer::{Buffer, Slice, Use};
use crate::capabilities::Subgroups;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::kernel::{Bound, Kernel};
use crate::recorder::Recorder;
use crate::wgsl::constants;

/// Workgroups at most, each with a range of its own: enough for the largest devices, few enough that each sums up what
/// all others found.
const BLOCKS: u32 = 1024;

/// Invocations of a workgroup.
const THREADS: u32 = 256;

/// Neighbouring values that an invocation takes at once.
const ITEMS: u32 = 4;

/// Bytes that a workgroup scans at a time: `STEP` of `scan.wgsl`, values of four bytes.
const STEP_BYTES: u64 = (THREADS * ITEMS) as u64 * 4;

/// Replaces numbers by the sums of those before them, modulo 2³².
#[derive(Clone, Debug)]
pub struct Scan {
    sum: Kernel,
    scan: Kernel,
    /// The sum of each block.
    sums: Buffer,
}

/// A scan with its buffers.
#[derive(Clone, Debug)]
pub struct BoundScan {
    sum: Bound,
    scan: Bound,
    blocks: u32,
}

/// Workgroups for values of `bytes`.
fn blocks(bytes: u64) -> u32 {
    (bytes / 4 * 4).div_ceil(STEP_BYTES).clamp(1, BLOCKS.into()) as u32
}

/// The WGSL for devices with such subgroups.
pub(crate) fn source(subgroups: Subgroups) -> Vec<String> {
    let numbers = constants(&[("THREADS", THREADS), ("BLOCKS", BLOCKS), ("ITEMS", ITEMS)]);
    let common = include_str!("scan.wgsl").to_owned();
    match subgroups {
        Subgroups::Present { min, .. } => vec![
            numbers + &constants(&[("MIN_SUBGROUP", min)]),
            include_str!("../prefix_subgroups.wgsl").to_owned(),
            common,
            include_str!("entry_subgroups.wgsl").to_owned(),
        ],
        Subgroups::Absent => vec![
            numbers,
            include_str!("../prefix_shared.wgsl").to_owned(),
            common,
            include_str!("entry_shared.wgsl").to_owned(),
        ],
    }
}

impl Scan {
    /// Compiles the kernels. One scan serves any number of bindings, but not two at once in different submissions.
    ///
    /// # Errors
    /// [`GpuError`] if the device refuses.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let source = source(gpu.capabilities().subgroups);
        let module = gpu.module("scan", &source.iter().map(String::as_str).collect::<Vec<_>>())?;
        let sums = gpu.buffer("scan sums", Use::Storage, u64::from(BLOCKS) * 4)?;
        Ok(Self { sum: module.kernel(gpu, "sum", &[])?, scan: module.kernel(gpu, "scan", &[])?, sums })
    }

    /// Will scan `values[..count]` in place; `count` is the first u32 of a buffer, at most the length of `values`.
    /// The sum of all goes to the first u32 of `total`.
    ///
    /// # Errors
    /// [`GpuError`] if the device refuses.
    pub fn bind(
        &self,
        gpu: &Gpu,
        count: Slice<'_>,
        values: Slice<'_>,
        total: Slice<'_>,
    ) -> Result<BoundScan, GpuError> {
        let blocks = blocks(values.bytes());
        let buffers = [("count", count), ("values", values), ("sums", self.sums.slice()), ("total", total)];
        Ok(BoundScan { sum: self.sum.bind(gpu, &buffers)?, scan: self.scan.bind(gpu, &buffers)?, blocks })
    }
}

impl BoundScan {
    /// Records the scan: two dispatches.
    pub fn record(&self, recorder: &mut Recorder<'_>) {
        recorder.dispatch(&self.sum, [self.blocks, 1, 1]);
        recorder.dispatch(&self.scan, [self.blocks, 1, 1]);
    }
}
