//! Work that a device has.

use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;

/// Work that was handed to a device.
#[derive(Clone, Debug)]
pub struct Submission {
    pub(crate) device_id: DeviceId,
    pub(crate) index: wgpu::SubmissionIndex,
}

impl Submission {
    /// wgpu's index of the submission on the device of `gpu`.
    pub(crate) fn index_of(&self, gpu: &Gpu) -> Result<wgpu::SubmissionIndex, GpuError> {
        gpu.device_id.check(self.device_id, "a submission")?;
        Ok(self.index.clone())
    }
}

impl Gpu {
    /// Waits until `submission` is done. In a browser, which paces submissions itself, the call returns at once.
    ///
    /// # Errors
    /// [`GpuError`] if the device failed meanwhile.
    pub fn wait(&self, submission: &Submission) -> Result<(), GpuError> {
        self.poll(wgpu::PollType::Wait { submission_index: Some(submission.index_of(self)?), timeout: None })
    }
}
