//! Frames that a device makes and keeps, and the change of machines.

use std::sync::Arc;

use gs3_compute::{Gpu, StageTime};
use gs3_reconstruct::ResetReason;
use gs3_scene::Camera;

use super::cpu::CpuMachine;
use super::gpu::{GpuMachine, GpuPresented, Settled};
use super::inputs::ReadBack;
use super::{FramePipeline, Machine};
use crate::error::PipelineError;
use crate::now::now;

impl FramePipeline {
    /// Renders as [`Self::render_with_poses`] does, on the device, and leaves the images on the device. This is for
    /// programs that show images from their own device ([`Gpu::of`]). The call waits for a few hundred bytes that are
    /// read back. [`Self::presented`] and [`Self::last_image`] are empty until the next [`Self::render`].
    ///
    /// # Errors
    /// [`PipelineError::NotOnDevice`] if [`Self::is_on_device`] is false, else as [`Self::render_with_poses`]; in a browser
    /// [`Self::render_to_device_async`] is for GPUs.
    pub fn render_to_device(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<GpuPresented<'_>, PipelineError> {
        now(self.render_to_device_async(camera, poses))
    }

    /// Renders as [`Self::render_to_device`] does, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::render_to_device`].
    pub async fn render_to_device_async(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<GpuPresented<'_>, PipelineError> {
        self.make_frame_on_device(camera, poses, ReadBack::Counters).await
    }

    /// Renders as [`Self::render_to_device`] does, without waiting for the frame. The call waits for the frame before the
    /// last one, so the device always has a frame to work on. What a frame tells is known one frame late: jitter, margins
    /// and camera cuts are decided from the depths of the frame before the last one. If the splats of a frame overflow the
    /// buffers, this frame and perhaps the next one are incomplete; then the buffers grow, and a frame starts without
    /// history ([`ResetReason::Failure`]).
    ///
    /// # Errors
    /// As [`Self::render_to_device`]. In a browser [`Self::submit_to_device_async`] is for GPUs.
    pub fn submit_to_device(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<GpuPresented<'_>, PipelineError> {
        now(self.submit_to_device_async(camera, poses))
    }

    /// Renders as [`Self::submit_to_device`] does, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::submit_to_device`].
    pub async fn submit_to_device_async(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
    ) -> Result<GpuPresented<'_>, PipelineError> {
        self.make_frame_on_device(camera, poses, ReadBack::Late).await
    }

    /// Waits for the frames of [`Self::submit_to_device`]. Returns whether all frames since the last call are complete. Frames
    /// from before [`Self::set_scene`] do not count. An incomplete frame had more splats than the buffers hold. The buffers have
    /// grown for later frames.
    ///
    /// # Errors
    /// [`PipelineError::NotOnDevice`] without a device, or another [`PipelineError`] if the device fails; the next frame then has
    /// no history. In a browser [`Self::wait_for_device_async`] is for GPUs.
    pub fn wait_for_device(&mut self) -> Result<bool, PipelineError> {
        now(self.wait_for_device_async())
    }

    /// Waits as [`Self::wait_for_device`] does, without blocking a browser.
    ///
    /// # Errors
    /// As [`Self::wait_for_device`].
    pub async fn wait_for_device_async(&mut self) -> Result<bool, PipelineError> {
        let Machine::Gpu(gpu) = &mut self.machine else { return Err(PipelineError::NotOnDevice) };
        let waited = gpu.wait().await;
        let (settled, are_complete) = waited.inspect_err(|_| self.sequence.fail(None))?;
        self.learn(settled);
        Ok(are_complete)
    }

    /// Waits for earlier frames of [`Self::submit_to_device`] as a frame of `camera` with `read_back` needs, and takes what they
    /// tell into account.
    pub(super) async fn settle(&mut self, camera: &Camera, read_back: ReadBack) -> Result<(), PipelineError> {
        if let Machine::Gpu(gpu) = &mut self.machine {
            let settled = gpu.settle(camera, read_back).await;
            let settled = settled.inspect_err(|_| self.sequence.fail(None))?;
            self.learn(settled);
        }
        Ok(())
    }

    fn learn(&mut self, Settled { lattice, is_incomplete }: Settled) {
        if let Some(lattice) = lattice {
            self.sequence.learn_depths(lattice);
        }
        if is_incomplete {
            self.reset(ResetReason::Failure);
        }
    }

    async fn make_frame_on_device(
        &mut self,
        camera: &Camera,
        poses: &[Camera],
        read_back: ReadBack,
    ) -> Result<GpuPresented<'_>, PipelineError> {
        if !self.is_on_device(camera) {
            return Err(PipelineError::NotOnDevice);
        }
        self.make_frame(camera, poses, read_back).await?;
        match &self.machine {
            Machine::Cpu(_) => Err(PipelineError::NotOnDevice),
            Machine::Gpu(gpu) => gpu.presented().ok_or(PipelineError::NotOnDevice),
        }
    }

    /// Renders on `gpu` from the next frame on, without history. In modes with history the GPU makes whole frames,
    /// and only images are read back ([`Self::is_on_device`]). In the other modes the GPU rasterizes and the CPU does
    /// the rest.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene does not fit the device, or if there are networks and the device computes wrong
    /// matrix products. Everything stays unchanged then.
    pub fn render_on(&mut self, gpu: &Gpu) -> Result<(), PipelineError> {
        self.machine = Machine::Gpu(Box::new(GpuMachine::new(gpu, &self.plan, Arc::clone(self.scene()))?));
        self.reset(ResetReason::BackendChange);
        Ok(())
    }

    /// Renders on the CPU from the next frame on, without history. Call it when the device of [`Self::render_on`]
    /// fails.
    ///
    /// # Errors
    /// None beyond the errors of [`Self::with_networks`] with the same settings and networks.
    pub fn render_on_cpu(&mut self) -> Result<(), PipelineError> {
        self.machine = Machine::Cpu(Box::new(CpuMachine::new(&self.plan, Arc::clone(self.scene()))?));
        self.reset(ResetReason::BackendChange);
        Ok(())
    }

    /// Time of each device stage of the last frame that the CPU waited for, in the order in which the stages began.
    /// Empty unless a GPU with a clock made that frame.
    #[must_use]
    pub fn device_times(&self) -> &[StageTime] {
        match &self.machine {
            Machine::Cpu(_) => &[],
            Machine::Gpu(gpu) => gpu.stage_times(),
        }
    }
}
