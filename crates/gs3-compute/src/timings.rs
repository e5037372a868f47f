//! Times of a frame's stages on the device.

use std::time::Duration;

use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::gpu::Gpu;
use crate::readback::mapped;
use crate::submission::Submission;
use crate::waiting::now;

/// Most passes of a frame that are timed.
const MAX_PASSES: u32 = 256;

/// Bytes of a time.
const TIME_BYTES: u64 = 8;

/// The time of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageTime {
    /// Its name, from [`Recorder::stage`](crate::Recorder::stage).
    pub stage: &'static str,
    /// Time of its kernels, and the time between these and the kernels before: copies and fills that the stage
    /// recorded, and waiting. So the times of all stages add up to the time from the start of the first kernel to the
    /// end of the last.
    pub time: Duration,
}

/// Kernels without a clock reading between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pass {
    stage: &'static str,
    /// The stage that the time since the pass before belongs to.
    gap: &'static str,
}

/// Times the stages of one frame after the other.
#[derive(Debug)]
pub struct Timings {
    pub(crate) device_id: DeviceId,
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    /// The passes recorded.
    passes: Vec<Pass>,
    /// Nanoseconds of a tick.
    period: f64,
}

impl Timings {
    /// # Errors
    /// [`GpuError::Unsupported`] if the device has no timestamps.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if !gpu.capabilities().timestamps {
            let (adapter, what) = (gpu.adapter().name.clone(), "timestamps".to_owned());
            let (expected, actual) = ("present".to_owned(), "absent".to_owned());
            return Err(GpuError::Unsupported { adapter, what, expected, actual });
        }
        let size = u64::from(2 * MAX_PASSES) * TIME_BYTES;
        let buffer = |usage| {
            let label = Some("timings");
            gpu.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
        };
        gpu.checked("timings", size, || Self {
            device_id: gpu.device_id,
            queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timings"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES,
            }),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            staging: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            passes: Vec::with_capacity(MAX_PASSES as usize),
            period: gpu.queue.get_timestamp_period().into(),
        })
    }

    /// The times of the last recorded frame, which is `submission`, in the order in which stages began. It waits for
    /// the frame.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails; in a browser [`Self::read_async`] is for it.
    pub fn read(&self, gpu: &Gpu, submission: &Submission) -> Result<Vec<StageTime>, GpuError> {
        now(self.read_async(gpu, submission))
    }

    /// The times of the last recorded frame, as [`Self::read`] has them, without blocking a browser.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub async fn read_async(&self, gpu: &Gpu, submission: &Submission) -> Result<Vec<StageTime>, GpuError> {
        gpu.device_id.check(self.device_id, "times of stages")?;
        let index = submission.index_of(gpu)?;
        let ticks = mapped(gpu, &self.staging, self.staging.size(), index, |bytes| {
            let times = bytes.chunks_exact(TIME_BYTES as usize);
            times.map(bytemuck::pod_read_unaligned::<u64>).collect::<Vec<u64>>()
        })
        .await?;
        Ok(stage_times(&self.passes, &ticks, self.period))
    }

    /// Drops the last frame's times.
    pub(crate) fn begin(&mut self) {
        self.passes.clear();
    }

    /// Where the next pass, which belongs to `stage`, writes its times. The time before the pass belongs to stage
    /// `gap`.
    pub(crate) fn pass(
        &mut self,
        stage: &'static str,
        gap: &'static str,
    ) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let pass = u32::try_from(self.passes.len()).ok().filter(|pass| *pass < MAX_PASSES)?;
        self.passes.push(Pass { stage, gap });
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        })
    }

    /// Brings the times to where they can be read.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        let count = 2 * u32::try_from(self.passes.len()).unwrap_or(MAX_PASSES);
        if count > 0 {
            encoder.resolve_query_set(&self.queries, 0..count, &self.resolved, 0);
            encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, u64::from(count) * TIME_BYTES);
        }
    }
}

/// Times of the stages of `passes`, in the order in which the stages began. `ticks` are the beginnings and ends of
/// the passes, in units of `period` nanoseconds.
fn stage_times(passes: &[Pass], ticks: &[u64], period: f64) -> Vec<StageTime> {
    let mut sums: Vec<(&'static str, u64)> = Vec::new();
    let mut add = |stage, ticks| match sums.iter_mut().find(|(name, _)| *name == stage) {
        Some((_, sum)) => *sum += ticks,
        None => sums.push((stage, ticks)),
    };
    let mut now = ticks.first().copied().unwrap_or(0);
    for (pass, times) in passes.iter().zip(ticks.chunks_exact(2)) {
        // A pass may begin before the pass before has ended, and clocks may step back: no moment counts twice, and no
        // time is negative.
        let begin = times[0].max(now);
        let end = times[1].max(begin);
        if begin > now {
            add(pass.gap, begin - now);
        }
        add(pass.stage, end - begin);
        now = end;
    }
    let time = |ticks: u64| Duration::from_nanos((ticks as f64 * period) as u64);
    sums.into_iter().map(|(stage, ticks)| StageTime { stage, time: time(ticks) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stages and nanoseconds, by a clock of two nanoseconds.
    fn times(passes: &[[&'static str; 2]], ticks: &[u64]) -> Vec<(&'static str, u128)> {
        let passes: Vec<Pass> = passes.iter().map(|[gap, stage]| Pass { stage, gap }).collect();
        let found = stage_times(&passes, ticks, 2.0);
        found.iter().map(|found| (found.stage, found.time.as_nanos())).collect()
    }

    #[test]
    fn what_passes_between_kernels_is_counted_once() {
        // `a` fills something after its kernel, `b` copies something before its second one.
        let passes = [["a", "a"], ["a", "b"], ["b", "b"], ["a", "a"]];
        let ticks = [100, 110, 113, 120, 170, 175, 175, 176];
        let found = times(&passes, &ticks);
        assert_eq!(found, [("a", 2 * (10 + 3 + 1)), ("b", 2 * (7 + 50 + 5))]);
        assert_eq!(found.iter().map(|(_, time)| time).sum::<u128>(), 2 * (176 - 100));
    }

    #[test]
    fn clocks_that_step_back_make_no_negative_times() {
        let passes = [["a", "a"], ["b", "b"], ["c", "c"]];
        // The second begins before the first ends; the third ends before it begins.
        assert_eq!(times(&passes, &[100, 110, 105, 120, 130, 90]), [("a", 20), ("b", 20), ("c", 20)]);
        assert_eq!(times(&passes, &[100, 110, 50, 60, 60, 115]), [("a", 20), ("b", 0), ("c", 10)]);
        assert_eq!(times(&[], &[]), []);
    }
}
