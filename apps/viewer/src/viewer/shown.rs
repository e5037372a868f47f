//! The contents of the panels.

use std::time::Duration;

use gs3::Stage;
use gs3::scene::Size;

use super::desk::Status;
use super::{Rest, Viewer};
use crate::panels::{Action, Facts};

impl Viewer {
    /// Puts the panels over the frame.
    pub(super) fn paint(&mut self, now: Duration, is_new: bool) -> Vec<Action> {
        self.picture.clone_from(&self.frame);
        if !self.has_panels {
            return Vec::new();
        }
        let facts = self.facts(is_new);
        self.panels.paint(&facts, self.scale, now, &mut self.picture)
    }

    pub(super) fn facts(&self, is_new: bool) -> Facts {
        Facts {
            figures: self.lines(is_new),
            message: self.message.clone(),
            note: self.note.as_ref().map(|(note, _)| note.clone()),
            opening: self.opening.clone(),
            has_videos: self.has_videos,
            video: self.video,
            is_hovering: self.is_hovering,
            view: self.view,
            compare: self.compare,
            dividers: self.dividers.columns(self.compare, self.size.width as usize).collect(),
            fps: 1.0 / self.interval.as_secs_f64(),
            fov: self.controls.fov(),
            up: self.controls.up(),
            keys: self.tour.keys(),
            tour_seconds: self.tour.seconds(),
            is_playing: self.tour.playing().is_some(),
            tour_time: self.tour.time(),
        }
    }

    /// The figures, a line each. `is_new` says whether they come with another picture of the scene.
    pub(super) fn lines(&self, is_new: bool) -> Vec<String> {
        let status = self.desk.status();
        let count = thousands(status.scene.gaussians().len());
        // Counted for reconstructed frames only.
        let visible = status.visible.filter(|_| !self.is_native_alone());
        let visible = visible.map(|n| format!(", {} visible", thousands(n))).unwrap_or_default();
        let mut lines = vec![format!("{}: {count} Gaussians{visible}", self.name)];
        let is_resting = !(is_new || self.is_rendering_due());
        lines.push(match (is_resting, self.figures.rates()) {
            (false, Some(rates)) => format!(
                "{:.1} frames a second displayed, {:.1} rendered; interval {:.0} ms, 95 % within {:.0} ms; latency {:.0} ms",
                rates.displayed, rates.rendered, rates.median, rates.percentile_95, rates.latency
            ),
            (false, None) => "the first frame".to_owned(),
            (true, _) => "no more frames are made until something happens".to_owned(),
        });
        if self.is_native_alone() {
            let time = self.frame_time().as_secs_f64() * 1e3;
            let Size { width, height } = self.size;
            lines.push(format!("{time:.1} ms a frame: native, {width}×{height}, as this is fast enough"));
        } else {
            self.add_stages(&status, &mut lines);
        }
        let machine = status.adapter.unwrap_or_else(|| "CPU".to_owned());
        let memory = self.memory.map(|bytes| format!(", {} MB of memory", bytes >> 20)).unwrap_or_default();
        lines.push(format!("{machine}{memory}"));
        let frames = status.period;
        lines.push(match self.rest {
            _ if self.controls.is_moving() || self.tour.playing().is_some() => "moving".to_owned(),
            Rest { is_native: true, .. } => "at rest: the native image".to_owned(),
            rest => format!("at rest: {} of {frames} frames of the native image", rest.frames.min(frames)),
        });
        lines
    }

    /// The stages of a reconstructed frame, and what it is made from.
    fn add_stages(&self, status: &Status, lines: &mut Vec<String>) {
        let times = status.times;
        let stages = Stage::ALL.iter().filter_map(|stage| {
            let time = times.get(*stage)?;
            Some(format!("{} {:.1}", stage.name().replace('_', " "), time.as_secs_f64() * 1e3))
        });
        let stages: Vec<String> = stages.collect();
        if !stages.is_empty() {
            let total = times.total().as_secs_f64() * 1e3;
            lines.push(format!("{total:.1} ms a frame: {}", stages.join(", ")));
        }
        let scale = status.scale.max(1);
        let Size { width, height } = self.size;
        lines.push(format!(
            "{width}×{height} from {}×{}, {:.1} % exact besides",
            width.div_ceil(scale),
            height.div_ceil(scale),
            status.exact_share * 100.0
        ));
    }
}

/// A number with commas between its thousands.
fn thousands(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
