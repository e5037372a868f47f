//! Wall-clock time of the stages of a frame.

use std::time::Duration;

use web_time::Instant;

/// A stage of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Gaussians to G-buffer, or to the native image.
    Rasterize,
    /// LR frame to HR frame.
    SuperSample,
    /// Exact pixels where the reconstruction cannot be trusted.
    Refine,
    /// The in-between frames.
    Interpolate,
}

impl Stage {
    /// All stages in the order in which they run.
    pub const ALL: [Self; 4] = [Self::Rasterize, Self::SuperSample, Self::Refine, Self::Interpolate];

    /// The stage's name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rasterize => "rasterize",
            Self::SuperSample => "super_sample",
            Self::Refine => "refine",
            Self::Interpolate => "interpolate",
        }
    }
}

/// How long each stage of a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes([Option<Duration>; Stage::ALL.len()]);

impl StageTimes {
    /// The time of `stage`, if it ran.
    #[must_use]
    pub const fn get(&self, stage: Stage) -> Option<Duration> {
        self.0[stage as usize]
    }

    /// The time of all stages together.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.0.iter().flatten().sum()
    }

    /// Adds `time` to the time of `stage`.
    #[cfg(feature = "gpu")]
    pub(crate) fn add(&mut self, stage: Stage, time: Duration) {
        *self.0[stage as usize].get_or_insert_default() += time;
    }

    /// Awaits `work` and takes its time as the time of `stage`.
    pub(crate) async fn time<T>(&mut self, stage: Stage, work: impl Future<Output = T>) -> T {
        let started = Instant::now();
        let result = work.await;
        self.0[stage as usize] = Some(started.elapsed());
        result
    }
}
