//! Results on their way to the CPU, in memory that is reused.

use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::submission::Submission;
use crate::waiting::answer;

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
        Ok(Self::of(gpu, staging))
    }

    /// `staging`, which was made on the device of `gpu` for this use.
    pub(crate) fn of(gpu: &Gpu, staging: wgpu::Buffer) -> Self {
        let bytes = staging.size();
        Self { staging, device_id: gpu.device_id, bytes }
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

/// What `f` makes of the first `size` bytes of `staging`, once submission `index` is done.
pub async fn mapped<R>(
    gpu: &Gpu,
    staging: &wgpu::Buffer,
    size: u64,
    index: wgpu::SubmissionIndex,
    f: impl FnOnce(&[u8]) -> R,
) -> Result<R, GpuError> {
    let refused = |message: String| GpuError::Refused { what: "reading a buffer".to_owned(), message };
    let (tell, told) = answer();
    // From here on, also if the caller gives up waiting: nothing can be copied to a buffer that is mapped or about to be.
    let _unmapped = Unmapped { gpu, staging };
    staging.map_async(wgpu::MapMode::Read, ..size, tell);
    gpu.poll(wgpu::PollType::Wait { submission_index: Some(index), timeout: None })?;
    let answer = told.await;
    gpu.check()?;
    match answer {
        Some(Ok(())) => {}
        Some(Err(error)) => return Err(refused(error.to_string())),
        None => return Err(refused("expected an answer of the device, found none".to_owned())),
    }
    let view = staging.get_mapped_range(..size).map_err(|e| refused(e.to_string()))?;
    Ok(f(&view))
}

/// Unmaps a buffer at the end.
struct Unmapped<'a> {
    gpu: &'a Gpu,
    staging: &'a wgpu::Buffer,
}

impl Drop for Unmapped<'_> {
    fn drop(&mut self) {
        self.gpu.quietly(|| self.staging.unmap());
    }
}
