//! The inputs of a frame's kernels, on their way to the device.

use crate::allocations::count;
use crate::buffer::Slice;
use crate::error::GpuError;
use crate::gpu::Gpu;

/// Bytes of a piece of memory on the way: the uniforms of a frame, a dozen structs of up to 256 B, fit into one.
const CHUNK_BYTES: u64 = 4 << 10;

/// Writes of one submission, which come before everything else in it.
#[derive(Debug)]
pub struct Uploads {
    belt: wgpu::util::StagingBelt,
    /// Copies from the staging memory; none if nothing was written.
    encoder: Option<wgpu::CommandEncoder>,
}

impl Uploads {
    pub fn new(gpu: &Gpu) -> Self {
        let belt = gpu.uploads.take();
        let new = || {
            count(&gpu.counts.buffers);
            wgpu::util::StagingBelt::new(gpu.device.clone(), CHUNK_BYTES)
        };
        let belt = belt.unwrap_or_else(new);
        Self { belt, encoder: None }
    }

    /// Writes `bytes`, a multiple of four, to the start of `to`.
    pub fn write(&mut self, gpu: &Gpu, to: &Slice<'_>, bytes: &[u8]) -> Result<(), GpuError> {
        const WORD: wgpu::BufferSize = wgpu::BufferSize::new(wgpu::COPY_BUFFER_ALIGNMENT).unwrap();
        let what = "bytes written in a frame";
        let (max, actual) = (to.bytes, bytes.len() as u64);
        if actual > max {
            return Err(GpuError::TooLarge { what: what.to_owned(), max, actual });
        }
        gpu.device_id.check(to.buffer.device_id, "a buffer that a frame writes")?;
        let Some(size) = wgpu::BufferSize::new(actual) else { return gpu.check() };
        let Self { belt, encoder } = self;
        gpu.checked(what, actual, || {
            let from = belt.allocate(size, WORD);
            // The memory of a lost device cannot be written; the surrounding check reports the loss.
            if let Ok(mut view) = from.get_mapped_range_mut() {
                view.copy_from_slice(bytes);
            }
            let new = || gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let encoder = encoder.get_or_insert_with(new);
            encoder.copy_buffer_to_buffer(from.buffer(), from.offset(), &to.buffer.raw, to.start, actual);
        })
    }

    /// Submits what was written, and `frame` after it.
    pub fn submit(self, gpu: &Gpu, frame: wgpu::CommandBuffer) -> wgpu::SubmissionIndex {
        let Self { mut belt, encoder } = self;
        belt.finish();
        let index = gpu.submit(encoder.map(wgpu::CommandEncoder::finish).into_iter().chain([frame]));
        belt.recall();
        gpu.uploads.give_back(belt);
        index
    }
}
