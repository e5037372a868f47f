//! A pipeline's frames on a device, with their times.

use std::time::Instant;

use gs3_compute::{Gpu, StageTime, Support, Timings};
use gs3_neural::MatrixUnit;
use gs3_raster::GpuRasterizer;
use gs3_reconstruct::ResetReason;
use gs3_scene::Image;

use super::frames::{GpuFrames, GpuRequest};
use crate::error::PipelineError;
use crate::lattice::DepthLattice;
use crate::learned::Networks;
use crate::settings::PipelineSettings;
use crate::stages::{Stage, StageTimes};

/// Frames, and the device's clock if it has one.
pub(crate) struct Device {
    gpu: Gpu,
    pub frames: GpuFrames,
    timings: Option<Timings>,
}

/// What a frame gives besides its images.
pub(crate) struct DeviceFrame {
    pub lattice: DepthLattice,
    pub times: StageTimes,
}

impl Device {
    pub fn new(gpu: &Gpu, settings: &PipelineSettings, networks: &Networks) -> Result<Self, PipelineError> {
        // Where they err a wrong picture would follow, without a word.
        if (networks.super_sample.is_some() || networks.interpolate.is_some())
            && let Some(unit) = MatrixUnit::of(gpu.capabilities())
        {
            unit.check(gpu)?;
        }
        let has_clock = gpu.capabilities().timestamps == Support::Present;
        let timings = if has_clock { Some(Timings::new(gpu)?) } else { None };
        Ok(Self { gpu: gpu.clone(), frames: GpuFrames::new(gpu, settings, networks), timings })
    }

    pub fn reset(&mut self, reason: ResetReason) {
        self.frames.reset(reason);
    }

    /// Makes a frame and reads what is shown back into `out`, if there is one: the image and those between. Times are
    /// the device's, without the way back; where it has no clock, all of the frame and its way back count as
    /// rasterization.
    pub fn render(
        &mut self,
        rasterizer: &mut GpuRasterizer,
        request: &GpuRequest<'_>,
        out: Option<(&mut Image, &mut [Image])>,
    ) -> Result<DeviceFrame, PipelineError> {
        let started = Instant::now();
        let rendered = self.frames.render(rasterizer, request, self.timings.as_mut(), out)?;
        let mut times = StageTimes::default();
        match &self.timings {
            Some(timings) => {
                for StageTime { stage, time } in timings.read(&self.gpu, &rendered.submission)? {
                    times.add(stage_of(stage), time);
                }
            }
            None => times.add(Stage::Rasterize, started.elapsed()),
        }
        Ok(DeviceFrame { lattice: rendered.lattice, times })
    }
}

/// The stage of the frame that a stage of the device belongs to, by the first part of its name.
fn stage_of(name: &str) -> Stage {
    let named = |stage: &Stage| name.split('.').next() == Some(stage.name());
    Stage::ALL.into_iter().find(named).unwrap_or(Stage::Rasterize)
}
