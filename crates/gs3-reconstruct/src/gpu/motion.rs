//! The motion of a frame's surfaces from another frame, on a GPU.

use std::fmt;

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Gpu, Kernel, Recorder, Use};
use gs3_scene::{Camera, Size};

use super::error::GpuReconstructError;
use super::frame::rows;
use super::plan::over_samples;
use super::shaders;
use crate::error::check_size;
use crate::reprojection::Reprojection;

/// `MotionView` of `motion.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct MotionUniform {
    rows: [[f32; 4]; 3],
    lr: [u32; 2],
    jitter: [f32; 2],
    before_jitter: [f32; 2],
    _pad: [f32; 2],
}

/// Finds the motion between LR frames of one size in device memory, by the rules of [`crate::Motion`].
pub struct GpuMotion {
    gpu: Gpu,
    lr: Size,
    uniform: Buffer,
    find: Kernel,
}

impl fmt::Debug for GpuMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuMotion").field("lr", &self.lr).finish_non_exhaustive()
    }
}

/// Motion from one frame to another.
#[derive(Clone, Debug)]
pub struct BoundMotion(Bound);

impl GpuMotion {
    /// Motion on grids of `lr` samples.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if the device refuses.
    pub fn new(gpu: &Gpu, lr: Size) -> Result<Self, GpuReconstructError> {
        let uniform = gpu.buffer("motion", Use::Uniform, size_of::<MotionUniform>() as u64)?;
        let find = gpu.module("motion", &[&shaders::motion()])?.kernel(gpu, "find_motion", &[])?;
        Ok(Self { gpu: gpu.clone(), lr, uniform, find })
    }

    /// Binds the motion from `now` to `before`, planes with median depths in the fourth channel. The outputs are
    /// `flow`, two f32 a sample, and `validity`, one f32 a sample.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if the device refuses.
    pub fn bind(
        &self,
        now: &Buffer,
        before: &Buffer,
        flow: &Buffer,
        validity: &Buffer,
    ) -> Result<BoundMotion, GpuReconstructError> {
        let buffers = [
            ("view", self.uniform.slice()),
            ("now_median", now.slice()),
            ("before_median", before.slice()),
            ("flow", flow.slice()),
            ("validity", validity.slice()),
        ];
        Ok(BoundMotion(self.find.bind(&self.gpu, &buffers)?))
    }

    /// Records the motion from the samples of the LR camera `now` to their places in `before`, each with its jitter.
    /// At most once in a submission.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if a camera has another size, or the device is lost.
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        bound: &BoundMotion,
        [now, before]: [(&Camera, [f32; 2]); 2],
    ) -> Result<(), GpuReconstructError> {
        for (camera, _) in [now, before] {
            check_size("low-resolution camera", self.lr, camera.size())?;
        }
        let uniform = MotionUniform {
            rows: rows(&Reprojection::new(now.0, before.0)),
            lr: self.lr.to_array(),
            jitter: now.1,
            before_jitter: before.1,
            _pad: [0.0; 2],
        };
        recorder.write(&self.uniform.slice(), &[uniform])?;
        recorder.dispatch(&bound.0, over_samples(self.lr));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = include_str!("motion.wgsl");
        let source = source.split("@group").next().unwrap();
        assert_layout!(&[source], MotionView, MotionUniform { rows, lr, jitter, before_jitter, _pad });
    }
}
