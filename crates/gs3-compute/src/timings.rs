//! Times of a frame's stages on the device.

use std::time::Duration;

use crate::buffer::mapped;
use crate::error::GpuError;
use crate::gpu::{Gpu, Support};
use crate::recorder::Submission;

/// Passes of a frame that are timed; later ones are not.
const MAX_PASSES: u32 = 256;

/// Bytes of a time.
const TIME_BYTES: u64 = 8;

/// What a stage took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageTime {
    /// Its name, from [`Recorder::stage`](crate::Recorder::stage).
    pub stage: &'static str,
    /// From the start to the end of its kernels, copies between them left out.
    pub time: Duration,
}

/// Times the stages of one frame after the other.
#[derive(Debug)]
pub struct Timings {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    /// Stages of the passes recorded.
    stages: Vec<&'static str>,
    /// Nanoseconds of a tick.
    period: f64,
}

impl Timings {
    /// # Errors
    /// [`GpuError::Unsupported`] if the device has no timestamps.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if gpu.capabilities().timestamps == Support::Absent {
            let (adapter, what) = (gpu.adapter().name.clone(), "timestamps".to_owned());
            let (expected, actual) = ("present".to_owned(), "absent".to_owned());
            return Err(GpuError::Unsupported { adapter, what, expected, actual });
        }
        let size = u64::from(2 * MAX_PASSES) * TIME_BYTES;
        let buffer = |usage| {
            let label = Some("timings");
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label,
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        gpu.checked("timings", size, || Self {
            queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timings"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES,
            }),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            staging: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            stages: Vec::with_capacity(MAX_PASSES as usize),
            period: gpu.queue.get_timestamp_period().into(),
        })
    }

    /// The times of the last recorded frame, which is `submission`, in the order in which stages began. It waits for the
    /// frame.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub fn read(&self, gpu: &Gpu, submission: &Submission) -> Result<Vec<StageTime>, GpuError> {
        let ticks = mapped(gpu, &self.staging, submission.0.clone(), |bytes| {
            let times = bytes.chunks_exact(TIME_BYTES as usize);
            times.map(bytemuck::pod_read_unaligned::<u64>).collect::<Vec<u64>>()
        })?;
        let mut times: Vec<StageTime> = Vec::new();
        for (stage, pair) in self.stages.iter().zip(ticks.chunks_exact(2)) {
            let nanoseconds = pair[1].saturating_sub(pair[0]) as f64 * self.period;
            let time = Duration::from_nanos(nanoseconds as u64);
            match times.iter_mut().find(|t| t.stage == *stage) {
                Some(found) => found.time += time,
                None => times.push(StageTime { stage, time }),
            }
        }
        Ok(times)
    }

    /// Forgets the last frame.
    pub(crate) fn begin(&mut self) {
        self.stages.clear();
    }

    /// Where the next pass, which belongs to `stage`, writes its times.
    pub(crate) fn pass(&mut self, stage: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let pass = u32::try_from(self.stages.len()).ok().filter(|pass| *pass < MAX_PASSES)?;
        self.stages.push(stage);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        })
    }

    /// Brings the times to where they can be read.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        let count = 2 * u32::try_from(self.stages.len()).unwrap_or(MAX_PASSES);
        if count > 0 {
            encoder.resolve_query_set(&self.queries, 0..count, &self.resolved, 0);
            encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, u64::from(count) * TIME_BYTES);
        }
    }
}
