//! What a caller chooses from one frame to the next.

use gs3_reconstruct::ResetReason;

use super::{FramePipeline, Machine};
use crate::error::PipelineError;
use crate::refine::Refine;

impl FramePipeline {
    /// Sets the number of the next frame on its path; later frames count on from there. The first frame has number 0
    /// by default. Keyframes ([`crate::PipelineSettings::keyframes`]) depend on this number.
    pub const fn set_frame_number(&mut self, number: u64) {
        self.frame_number = number;
    }

    /// Chooses the pixels that are rasterized exactly from the next frame on. The history stays. For programs that
    /// change the time a frame may take ([`Refine::FrameTime`]).
    ///
    /// # Errors
    /// [`PipelineError::RefineShare`] if the share is not in `[0, 1]`; the old choice stays.
    pub fn set_refine(&mut self, refine: Refine) -> Result<(), PipelineError> {
        self.plan.set_refine(refine)?;
        match &mut self.machine {
            Machine::Cpu(cpu) => cpu.stages_mut().set_refine(self.plan.refine),
            #[cfg(feature = "gpu")]
            Machine::Gpu(gpu) => gpu.set_refine(&self.plan),
        }
        Ok(())
    }

    /// Chooses how many frames are interpolated before each rendered frame from the next frame on: 0 to
    /// [`crate::PipelineSettings::in_between`], which is the number without this call. The history stays. For programs
    /// that hold a rate of displayed frames.
    ///
    /// # Errors
    /// [`PipelineError::InBetween`] if there are too many; modes other than [`crate::Mode::Full`] take 0 only. The old
    /// choice stays.
    pub const fn set_in_between(&mut self, count: u32) -> Result<(), PipelineError> {
        self.plan.set_in_between(count)
    }

    /// Drops the history: the next frame starts anew, for this reason unless an earlier reason is pending.
    pub fn reset(&mut self, reason: ResetReason) {
        self.sequence.reset(reason);
    }
}
