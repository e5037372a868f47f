//! The G-buffer of the last frame, for whoever wants to look at it.

use gs3_scene::GBuffer;

use super::{FramePipeline, Machine};
use crate::error::PipelineError;
use crate::now::now;

impl FramePipeline {
    /// The LR G-buffer of the last frame. Empty in [`Mode::Native`](crate::Mode::Native), colour only in
    /// [`Mode::Bicubic`](crate::Mode::Bicubic). If a GPU makes whole frames, this is the G-buffer of the last
    /// [`Self::fetch_gbuffer`]. On a CPU expected depths and normals are empty, unless a network reads them or
    /// [`Self::fetch_normals`] makes them.
    #[must_use]
    pub const fn gbuffer(&self) -> &GBuffer {
        &self.frames.current.gbuffer
    }

    /// Reads back the LR G-buffer of the last frame, if it is on a GPU.
    ///
    /// # Errors
    /// [`PipelineError`] if the device fails; in a browser [`Self::fetch_gbuffer_async`] is for it.
    pub fn fetch_gbuffer(&mut self) -> Result<(), PipelineError> {
        now(self.fetch_gbuffer_async())
    }

    /// Reads back the LR G-buffer, as [`Self::fetch_gbuffer`] does, without blocking a browser.
    ///
    /// # Errors
    /// [`PipelineError`] if the device fails.
    pub async fn fetch_gbuffer_async(&mut self) -> Result<(), PipelineError> {
        #[cfg(feature = "gpu")]
        if let (Machine::Gpu(gpu), Some(camera)) = (&self.machine, &self.frames.current.camera) {
            gpu.read_gbuffer(camera, &mut self.frames.current.gbuffer).await?;
        }
        Ok(())
    }

    /// Makes the expected depths and the normals of [`Self::gbuffer`], if it has depths and no normals. The LR frame is
    /// rasterized again.
    ///
    /// # Errors
    /// [`PipelineError`] if the frame cannot be rasterized.
    pub fn fetch_normals(&mut self) -> Result<(), PipelineError> {
        let Some(camera) = &self.frames.current.camera else { return Ok(()) };
        match &mut self.machine {
            Machine::Cpu(cpu) => cpu.add_normals(camera, &mut self.frames.current.gbuffer),
            #[cfg(feature = "gpu")]
            Machine::Gpu(_) => Ok(()),
        }
    }
}
