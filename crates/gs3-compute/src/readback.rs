//! Results on their way to the CPU, in memory that is reused.

use std::sync::{Mutex, PoisonError};

use crate::buffer::mapped;
use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::recorder::Submission;

/// Memory that the CPU reads, for the results of one frame after the other. [`Recorder::read_back`] copies results
/// there in the frame's own submission.
///
/// [`Recorder::read_back`]: crate::Recorder::read_back
#[derive(Debug)]
pub struct Readback {
    pub(crate) staging: wgpu::Buffer,
    pub(crate) device_id: DeviceId,
    bytes: u64,
}

impl Readback {
    /// Memory of `bytes`, rounded up to a multiple of four.
    ///
    /// # Errors
    /// [`GpuError`] if the size exceeds the device's limits or memory.
    pub fn new(gpu: &Gpu, bytes: u64) -> Result<Self, GpuError> {
        let max = gpu.capabilities().limits.buffer_bytes;
        if bytes > max {
            return Err(GpuError::TooLarge { what: "bytes read back".to_owned(), max, actual: bytes });
        }
        let bytes = bytes.max(1).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let descriptor = wgpu::BufferDescriptor {
            label: Some("readback"),
            size: bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        };
        let staging = gpu.checked("memory read back", bytes, || gpu.create_buffer(&descriptor))?;
        Ok(Self { staging, device_id: gpu.device_id, bytes })
    }

    /// Its size.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The result of `f` on all bytes that `submission` copied here, once the submission is done.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub async fn read<R>(
        &self,
        gpu: &Gpu,
        submission: &Submission,
        f: impl FnOnce(&[u8]) -> R,
    ) -> Result<R, GpuError> {
        gpu.device_id.check(self.device_id, "memory that is read back to")?;
        mapped(gpu, &self.staging, self.bytes, submission.index_of(gpu)?, f).await
    }
}

/// Most bytes of memory that are kept for the next read.
const KEPT: u64 = 64 << 20;

/// Memory that was read and can be used again: the memory of the last finished read.
#[derive(Debug, Default)]
pub struct ReadPool(Mutex<Option<Readback>>);

impl ReadPool {
    pub fn take(&self) -> Option<Readback> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    pub fn give_back(&self, readback: Readback) {
        if readback.bytes <= KEPT {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(readback);
        }
    }
}
