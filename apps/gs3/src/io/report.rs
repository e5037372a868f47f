//! Figures of a run.

use std::ops::Range;
use std::time::Duration;

use gs3::{Machine, PipelineSettings, Stage, StageTimes};
use serde_json::{Map, Value, json};

use crate::cli::options::View;

/// Times of the frames of one pipeline.
#[derive(Clone, Debug, Default)]
pub struct Times {
    frames: Vec<StageTimes>,
    displayed: usize,
}

impl Times {
    /// Adds a rendered frame that gave `displayed` frames to show.
    pub fn add(&mut self, times: StageTimes, displayed: usize) {
        self.frames.push(times);
        self.displayed += displayed;
    }

    /// Frames shown.
    pub const fn displayed(&self) -> usize {
        self.displayed
    }

    /// Frames shown per second of rendering.
    pub fn displayed_fps(&self) -> f64 {
        per_second(self.displayed, self.frames.iter().map(|t| t.total().as_secs_f64()).sum())
    }

    /// Median time of `stage` over the frames in which it ran.
    pub fn median_ms(&self, stage: Stage) -> Option<f64> {
        median_ms(self.frames.iter().filter_map(|t| t.get(stage)).collect())
    }

    /// Median time of all stages of a rendered frame together.
    pub fn median_frame_ms(&self) -> Option<f64> {
        median_ms(self.frames.iter().map(StageTimes::total).collect())
    }

    /// `stage_ms` of reports: the median of every stage that ran.
    pub fn stage_ms(&self) -> Value {
        let stages =
            Stage::ALL.iter().filter_map(|s| Some((s.name().to_owned(), json!(self.median_ms(*s)?))));
        Value::Object(stages.collect::<Map<_, _>>())
    }
}

/// Frames per second; 0 of no time.
pub fn per_second(frames: usize, seconds: f64) -> f64 {
    if seconds > 0.0 { frames as f64 / seconds } else { 0.0 }
}

/// The settings of a run: everything that changes pictures or speed, so that figures of different runs can be
/// distinguished.
pub fn asked(view: &View, frames: &Range<usize>, settings: &PipelineSettings) -> Value {
    let path = view.path.as_ref().map_or_else(|| "orbit".to_owned(), |path| path.display().to_string());
    let mut asked = json!({
        "command": command_line(),
        "version": env!("CARGO_PKG_VERSION"),
        "scene": view.scene.display().to_string(),
        "path": path,
        "frames": [frames.start, frames.end],
        "culling": settings.culling.name(),
        "dilation": settings.dilation.to_string(),
        "background": settings.background,
    });
    if settings.mode.has_history() {
        asked["sampling"] = json!(settings.sampling.name());
        asked["kriging"] = json!(settings.kriging.name());
        asked["overscan"] = json!(settings.overscan);
    }
    asked
}

/// The command as given; parts that are not valid text are shown approximately.
pub fn command_line() -> String {
    std::env::args_os().map(|arg| arg.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}

/// The median in milliseconds; none of no times.
pub fn median_ms(mut times: Vec<Duration>) -> Option<f64> {
    times.sort_unstable();
    let middle = times.len() / 2;
    let upper = times.get(middle)?.as_secs_f64() * 1e3;
    let lower = if times.len().is_multiple_of(2) { times[middle - 1].as_secs_f64() * 1e3 } else { upper };
    Some(0.5 * (lower + upper))
}

/// The most memory that the process ever held, in MB (10⁶ bytes), where the system says so (Linux).
pub fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024.0 / 1e6)
}

/// What every report says about the machine's side: `machine` rasterized.
pub fn machine(machine: &Machine) -> Value {
    let figures = json!({
        "backend": machine.backend().name(),
        "simd": gs3::simd::name(gs3::simd::level()),
        "threads": rayon::current_num_threads(),
        "peak_rss_mb": peak_rss_mb(),
    });
    match machine.adapter() {
        Some(adapter) => join(figures, json!({ "adapter": adapter })),
        None => figures,
    }
}

/// `report` with the fields of `more`.
pub fn join(mut report: Value, more: Value) -> Value {
    if let (Value::Object(report), Value::Object(more)) = (&mut report, more) {
        report.extend(more);
    }
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_odd_and_even_counts() {
        let ms = |values: &[u64]| median_ms(values.iter().map(|v| Duration::from_millis(*v)).collect());
        assert_eq!(ms(&[]), None);
        assert_eq!(ms(&[9, 1, 5]), Some(5.0));
        assert_eq!(ms(&[9, 1, 5, 7]), Some(6.0));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn peak_memory_is_that_of_a_process() {
        let before = peak_rss_mb().unwrap();
        let block = vec![1_u8; 64 << 20];
        let after = peak_rss_mb().unwrap();
        assert!(before > 1.0 && after > 60.0 && after < 10_000.0, "{before} MB, {after} MB, {}", block[77]);
    }
}
