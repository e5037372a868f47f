//! One frame's work, submitted once.

use bytemuck::Pod;

use crate::buffer::{Buffer, Slice};
use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::kernel::Bound;
use crate::readback::Readback;
use crate::submission::Submission;
use crate::timings::Timings;
use crate::uploads::Uploads;

/// Records work for one submission. What is recorded later sees what was written before.
#[derive(Debug)]
pub struct Recorder<'a> {
    gpu: &'a Gpu,
    uploads: Uploads,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    timings: Option<&'a mut Timings>,
    stage: &'static str,
    /// The stage that first copied or filled something since the last pass.
    moved: Option<&'static str>,
    /// The first recorded object of another device, as an error: nothing is submitted then.
    other_device: Option<GpuError>,
}

impl Gpu {
    /// A recorder of a frame's work. With `timings` its stages are timed.
    #[must_use]
    pub fn recorder<'a>(&'a self, timings: Option<&'a mut Timings>) -> Recorder<'a> {
        Recorder::new(self, timings)
    }
}

impl<'a> Recorder<'a> {
    fn new(gpu: &'a Gpu, timings: Option<&'a mut Timings>) -> Self {
        let encoder =
            gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let other_device =
            timings.as_ref().and_then(|t| gpu.device_id.check(t.device_id, "times of stages").err());
        let mut timings = timings.filter(|_| other_device.is_none());
        if let Some(timings) = &mut timings {
            timings.begin();
        }
        let uploads = Uploads::new(gpu);
        Self { gpu, uploads, encoder, pass: None, timings, stage: "", moved: None, other_device }
    }

    /// Writes `values` to the start of `to`, before all commands recorded here run, whenever it is called: for values
    /// that change from frame to frame. Once frames write alike, no memory is allocated on the device for it.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if `to` is shorter; device loss.
    pub fn write<T: Pod>(&mut self, to: &Slice<'_>, values: &[T]) -> Result<(), GpuError> {
        const { assert!(size_of::<T>().is_multiple_of(4), "copies are of whole words") };
        self.uploads.write(self.gpu, to, bytemuck::cast_slice(values))
    }

    /// Names the stage of the commands recorded from here on, for timing. A name may be used more than once.
    pub fn stage(&mut self, name: &'static str) {
        if self.stage != name {
            // Only clocks need passes of their own.
            if self.timings.is_some() {
                self.pass = None;
            }
            self.stage = name;
        }
    }

    /// Runs `kernel` in `groups` workgroups ([`grid`](crate::grid) for more than 65,535 in a row).
    pub fn dispatch(&mut self, kernel: &Bound, groups: [u32; 3]) {
        if groups.contains(&0) || !self.owns([kernel.device_id], "a kernel") {
            return;
        }
        let pass = self.pass();
        pass.set_pipeline(&kernel.pipeline);
        pass.set_bind_group(0, &kernel.group, &[]);
        pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
    }

    /// Runs `kernel` in as many workgroups as three u32 at byte `offset` of `counts` say, each at most 65,535: kernels
    /// that write them use `grid_of` ([`grid_source`](crate::grid_source)).
    pub fn dispatch_indirect(&mut self, kernel: &Bound, counts: &Buffer, offset: u64) {
        if !self.owns([kernel.device_id, counts.device_id], "a kernel or the count of its workgroups") {
            return;
        }
        let pass = self.pass();
        pass.set_pipeline(&kernel.pipeline);
        pass.set_bind_group(0, &kernel.group, &[]);
        pass.dispatch_workgroups_indirect(&counts.raw, offset);
    }

    /// Copies `from` to the start of `to`, which is not shorter. Starts and lengths are multiples of four bytes.
    pub fn copy(&mut self, from: &Slice<'_>, to: &Slice<'_>) {
        if !self.owns([from.buffer.device_id, to.buffer.device_id], "a buffer that is copied") {
            return;
        }
        self.end_pass();
        let bytes = from.bytes.min(to.bytes);
        self.encoder.copy_buffer_to_buffer(&from.buffer.raw, from.start, &to.buffer.raw, to.start, bytes);
    }

    /// Copies `from` to byte `at` of `to`, cut to the length of `to`. Starts and lengths are multiples of four bytes.
    pub fn read_back(&mut self, from: &Slice<'_>, to: &Readback, at: u64) {
        if !self.owns([from.buffer.device_id, to.device_id], "a buffer that is read back") {
            return;
        }
        self.end_pass();
        let bytes = from.bytes.min(to.bytes().saturating_sub(at));
        self.encoder.copy_buffer_to_buffer(&from.buffer.raw, from.start, &to.staging, at, bytes);
    }

    /// Copies rows of `row_bytes` each, a multiple of [`wgpu::COPY_BYTES_PER_ROW_ALIGNMENT`], from the start of `from` to
    /// all of `texture`, which the submission checks.
    pub fn copy_to_texture(&mut self, from: &Slice<'_>, row_bytes: u32, texture: &wgpu::Texture) {
        if !self.owns([from.buffer.device_id], "a buffer that is copied to a texture") {
            return;
        }
        self.end_pass();
        let layout = wgpu::TexelCopyBufferLayout {
            offset: from.start,
            bytes_per_row: Some(row_bytes),
            rows_per_image: None,
        };
        let from = wgpu::TexelCopyBufferInfo { buffer: &from.buffer.raw, layout };
        self.encoder.copy_buffer_to_texture(from, texture.as_image_copy(), texture.size());
    }

    /// Fills `slice` with zeros.
    pub fn clear(&mut self, slice: &Slice<'_>) {
        if !self.owns([slice.buffer.device_id], "a buffer that is cleared") {
            return;
        }
        self.end_pass();
        self.encoder.clear_buffer(&slice.buffer.raw, slice.start, Some(slice.bytes - slice.bytes % 4));
    }

    /// Submits everything to the device. The call returns while the device works.
    ///
    /// # Errors
    /// [`GpuError`] if something of another device was recorded, or the device refuses it or is lost.
    pub fn submit(mut self) -> Result<Submission, GpuError> {
        self.pass = None;
        let Self { gpu, uploads, mut encoder, timings, other_device, .. } = self;
        other_device.map_or(Ok(()), Err)?;
        gpu.checked("a frame", 0, || {
            if let Some(timings) = timings {
                timings.resolve(&mut encoder);
            }
            Submission { device_id: gpu.device_id, index: uploads.submit(gpu, encoder.finish()) }
        })
    }

    /// Whether all objects with `device_ids` belong to the device.
    fn owns<const N: usize>(&mut self, device_ids: [DeviceId; N], what: &'static str) -> bool {
        let error = device_ids.iter().find_map(|device_id| self.gpu.device_id.check(*device_id, what).err());
        let is_own = error.is_none();
        self.other_device = self.other_device.take().or(error);
        is_own
    }

    /// Ends the pass, for a copy or fill of the stage.
    fn end_pass(&mut self) {
        self.pass = None;
        self.moved.get_or_insert(self.stage);
    }

    fn pass(&mut self) -> &mut wgpu::ComputePass<'static> {
        let Self { encoder, pass, timings, stage, moved, .. } = self;
        pass.get_or_insert_with(|| {
            let gap = moved.take().unwrap_or(stage);
            let timestamp_writes = timings.as_mut().and_then(|timings| timings.pass(stage, gap));
            let descriptor = wgpu::ComputePassDescriptor { label: Some(*stage), timestamp_writes };
            encoder.begin_compute_pass(&descriptor).forget_lifetime()
        })
    }
}
