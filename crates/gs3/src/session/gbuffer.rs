//! The G-buffer of the last frame, for whoever wants to look at it.

use super::Session;
use crate::error::PipelineError;
use crate::now::now;

impl Session {
    /// Reads back the LR G-buffer of the last frame, if it is on a GPU. [`FramePipeline::gbuffer`](crate::FramePipeline::gbuffer) of
    /// [`Self::pipeline`] then has it.
    ///
    /// # Errors
    /// [`PipelineError`] if the device fails; in a browser [`Self::fetch_gbuffer_async`] is for it.
    pub fn fetch_gbuffer(&mut self) -> Result<(), PipelineError> {
        now(self.fetch_gbuffer_async())
    }

    /// Reads back the LR G-buffer, as [`Self::fetch_gbuffer`] does, without blocking a browser. If a GPU fails that was found
    /// and not asked for, the CPU takes over, and there is no G-buffer before its first frame.
    ///
    /// # Errors
    /// [`PipelineError`] if a GPU that was asked for fails.
    pub async fn fetch_gbuffer_async(&mut self) -> Result<(), PipelineError> {
        match self.pipeline.fetch_gbuffer_async().await {
            Ok(()) => Ok(()),
            Err(error) => self.take_over(error),
        }
    }

    /// Makes the expected depths and the normals of the G-buffer ([`FramePipeline::fetch_normals`](crate::FramePipeline::fetch_normals)).
    ///
    /// # Errors
    /// As [`FramePipeline::fetch_normals`](crate::FramePipeline::fetch_normals).
    pub fn fetch_normals(&mut self) -> Result<(), PipelineError> {
        self.pipeline.fetch_normals()
    }
}
