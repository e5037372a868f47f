//! Memory of a device.

use bytemuck::Pod;

use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::readback::{Readback, mapped};
use crate::waiting::now;

/// What a buffer is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// `var<storage>` in kernels.
    Storage,
    /// The same, and counts of indirect dispatches.
    Indirect,
    /// `var<uniform>` in kernels, written once per frame.
    Uniform,
}

/// Memory of a device. Clones are the same memory.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Buffer {
    pub(crate) raw: wgpu::Buffer,
    pub(crate) device_id: DeviceId,
    bytes: u64,
}

/// A range of a buffer.
#[derive(Clone, Copy, Debug)]
pub struct Slice<'a> {
    pub(crate) buffer: &'a Buffer,
    pub(crate) start: u64,
    pub(crate) bytes: u64,
}

/// Memory that writes hold on the way to the device: more is sent in steps.
const STAGING_BYTES: usize = 64 << 20;

/// Sizes of copies are multiples of four.
const WORD: u64 = wgpu::COPY_BUFFER_ALIGNMENT;

impl Buffer {
    pub(crate) fn new(gpu: &Gpu, label: &str, usage: Use, bytes: u64) -> Result<Self, GpuError> {
        let max = gpu.capabilities().limits.buffer_bytes;
        if bytes > max {
            return Err(GpuError::TooLarge { what: format!("bytes of buffer {label}"), max, actual: bytes });
        }
        // Bindings are not empty, and uniform structs are multiples of 16.
        let size = bytes.max(1).next_multiple_of(16).min(max);
        let copies = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let usage = copies
            | match usage {
                Use::Storage => wgpu::BufferUsages::STORAGE,
                Use::Indirect => wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT,
                Use::Uniform => wgpu::BufferUsages::UNIFORM,
            };
        let descriptor =
            wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        let raw = gpu.checked(&format!("buffer {label}"), size, || gpu.create_buffer(&descriptor))?;
        Ok(Self { raw, device_id: gpu.device_id, bytes: size })
    }

    /// A buffer that the caller made on the device of `gpu` ([`Gpu::of`]), as a buffer of gs3.
    ///
    /// # Errors
    /// [`GpuError::Refused`] if it cannot be a storage buffer and be copied from and to.
    pub fn of(gpu: &Gpu, raw: wgpu::Buffer) -> Result<Self, GpuError> {
        let expected =
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        if !raw.usage().contains(expected) {
            let message = format!("expected usages {expected:?}, found {:?}", raw.usage());
            return Err(GpuError::Refused { what: "a buffer".to_owned(), message });
        }
        let bytes = raw.size();
        Ok(Self { raw, device_id: gpu.device_id, bytes })
    }

    /// wgpu's own handle of it.
    #[must_use]
    pub const fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// Its size, at least what was asked for.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// All of it.
    #[must_use]
    pub fn slice(&self) -> Slice<'_> {
        Slice { buffer: self, start: 0, bytes: self.bytes }
    }

    /// `bytes` of the buffer from `start`, cut to its length. Bindings start at multiples of
    /// [`Limits::binding_alignment`](crate::Limits::binding_alignment).
    #[must_use]
    pub fn part(&self, start: u64, bytes: u64) -> Slice<'_> {
        let start = start.min(self.bytes);
        Slice { buffer: self, start, bytes: bytes.min(self.bytes - start) }
    }
}

impl Slice<'_> {
    /// Its length.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The first `bytes` of the buffer, cut to its length.
    #[must_use]
    pub fn first(self, bytes: u64) -> Self {
        Self { bytes: self.bytes.min(bytes), ..self }
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &self.buffer.raw,
            offset: self.start,
            size: wgpu::BufferSize::new(self.bytes),
        })
    }
}

impl<'a> From<&'a Buffer> for Slice<'a> {
    fn from(buffer: &'a Buffer) -> Self {
        buffer.slice()
    }
}

impl Gpu {
    /// A buffer of zeros.
    ///
    /// # Errors
    /// [`GpuError`] if the size exceeds the device's limits or memory.
    pub fn buffer(&self, label: &str, usage: Use, bytes: u64) -> Result<Buffer, GpuError> {
        Buffer::new(self, label, usage, bytes)
    }

    /// A buffer that holds `values`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn buffer_with<T: Pod>(&self, label: &str, usage: Use, values: &[T]) -> Result<Buffer, GpuError> {
        let buffer = self.buffer(label, usage, size_of_val(values) as u64)?;
        self.write(&buffer.slice(), values)?;
        Ok(buffer)
    }

    /// Writes `values` to the start of `slice`, before the next submission. Bytes are padded with zeros to a multiple
    /// of four.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if `slice` is shorter; device loss.
    pub fn write<T: Pod>(&self, slice: &Slice<'_>, values: &[T]) -> Result<(), GpuError> {
        write(self, slice, bytemuck::cast_slice(values))
    }

    /// The numbers in `slice`, after everything submitted before. The call waits for the device: for tests and final
    /// results, not for data within a frame.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails; in a browser [`Self::read_async`] is for it.
    pub fn read<T: Pod>(&self, slice: &Slice<'_>) -> Result<Vec<T>, GpuError> {
        now(self.read_async(slice))
    }

    /// The numbers in `slice`, as [`Self::read`] has them, without blocking a browser.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub async fn read_async<T: Pod>(&self, slice: &Slice<'_>) -> Result<Vec<T>, GpuError> {
        read(self, slice).await
    }
}

/// Writes `bytes` to the start of `slice`.
fn write(gpu: &Gpu, slice: &Slice<'_>, bytes: &[u8]) -> Result<(), GpuError> {
    let actual = bytes.len() as u64;
    if actual > slice.bytes {
        return Err(GpuError::TooLarge {
            what: "bytes written to a buffer".to_owned(),
            max: slice.bytes,
            actual,
        });
    }
    gpu.device_id.check(slice.buffer.device_id, "a buffer that is written")?;
    let write = |offset: usize, bytes: &[u8]| {
        gpu.checked("writing a buffer", bytes.len() as u64, || {
            gpu.queue.write_buffer(&slice.buffer.raw, slice.start + offset as u64, bytes);
        })
    };
    let (whole, rest) = bytes.split_at(bytes.len() - bytes.len() % WORD as usize);
    for (k, step) in whole.chunks(STAGING_BYTES).enumerate() {
        write(k * STAGING_BYTES, step)?;
        if step.len() == STAGING_BYTES {
            let index = gpu.submit([]);
            gpu.poll(wgpu::PollType::Wait { submission_index: Some(index), timeout: None })?;
        }
    }
    if !rest.is_empty() {
        let mut word = [0; WORD as usize];
        word[..rest.len()].copy_from_slice(rest);
        write(whole.len(), &word)?;
    }
    Ok(())
}

/// The numbers in `slice`.
async fn read<T: Pod>(gpu: &Gpu, slice: &Slice<'_>) -> Result<Vec<T>, GpuError> {
    gpu.device_id.check(slice.buffer.device_id, "a buffer that is read")?;
    let size = slice.bytes - slice.bytes % WORD;
    if size == 0 {
        return gpu.check().map(|()| Vec::new());
    }
    let kept = gpu.reads.take().filter(|staging| staging.size() >= size);
    let readback = kept.map_or_else(|| Readback::new(gpu, size), |staging| Ok(Readback::of(gpu, staging)))?;
    let index = gpu.checked("reading a buffer", size, || {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&slice.buffer.raw, slice.start, &readback.staging, 0, size);
        gpu.submit([encoder.finish()])
    })?;
    let values = mapped(gpu, &readback.staging, size, index, |bytes| {
        let count = bytes.len() / size_of::<T>().max(1);
        let mut values = vec![T::zeroed(); count];
        let target: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        let length = target.len();
        target.copy_from_slice(&bytes[..length]);
        values
    })
    .await;
    gpu.reads.give_back(readback.staging);
    values
}
