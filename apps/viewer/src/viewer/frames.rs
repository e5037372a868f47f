//! The choice of the next frame, and what is done with the frames that come back.

use std::time::Duration;

use gs3::scene::Camera;
use gs3::scene::camera_path::pose_between;
use gs3::{MAX_IN_BETWEEN, Mode, Refine};

use super::display::Display;
use super::job::{Finished, Job, Make, Shown};
use super::pace::Pace;
use super::{Rest, Viewer};
use crate::compare::Compare;
use crate::figures::Displayed;
use crate::views::View;

/// Least share of the interval for rendering, however long the rest takes.
const LEAST_SHARE: f64 = 0.25;

/// How much earlier than expected a frame is asked for, as a share of the interval: frames differ by as much.
const EARLY: f64 = 0.5;

/// Share of its intervals that a frame rendered apart may take. The rest is for frames that take longer than expected: a late
/// frame is a visible stop among evenly shown ones.
const APART: f64 = 0.95;

/// Pictures whose memory is kept: a rendered frame and the most in-between frames before it.
const SPARE: usize = MAX_IN_BETWEEN as usize + 1;

/// Where the camera has been since the last frame was asked for, and when: the way that in-between frames follow.
#[derive(Clone, Debug, Default)]
pub(super) struct Track {
    /// In order of time. The first one is the camera of the last frame.
    cameras: Vec<(Duration, Camera)>,
}

impl Track {
    pub fn push(&mut self, now: Duration, camera: Camera) {
        if self.cameras.last().is_some_and(|(_, last)| last.size() != camera.size()) {
            self.cameras.clear();
        }
        self.cameras.push((now, camera));
    }

    /// Begins anew with the newest camera.
    pub fn restart(&mut self) {
        self.cameras.drain(..self.cameras.len().saturating_sub(1));
    }

    pub fn clear(&mut self) {
        self.cameras.clear();
    }

    /// The cameras at `count` moments that part the time from the first to the last one evenly. None of a track that stands
    /// still.
    pub fn between(&self, count: u32) -> Vec<(Duration, Camera)> {
        let (Some((first, from)), Some((last, to))) = (self.cameras.first(), self.cameras.last()) else {
            return Vec::new();
        };
        if from == to || first >= last {
            return Vec::new();
        }
        let at = |k: u32| {
            let at = *first + (*last - *first) * k / (count + 1);
            let next = self.cameras.partition_point(|(time, _)| *time < at).max(1);
            let ((before, a), (after, b)) = (self.cameras[next - 1], self.cameras[next]);
            let span = (after - before).as_secs_f64();
            let t = if span > 0.0 { (at - before).as_secs_f64() / span } else { 1.0 };
            (at, pose_between(&a, &b, t))
        };
        (1..=count).map(at).collect()
    }
}

impl Viewer {
    /// Frames that a resting camera takes until its history holds every pixel.
    pub(super) fn frames_to_rest(&self) -> usize {
        self.desk.status().period
    }

    pub(super) fn is_rendering_due(&self) -> bool {
        let camera = self.controls.shown().camera(self.size).ok();
        // After a failure, the frame is not tried again until something changes.
        camera.is_some() && !self.has_failed && (self.rest.camera != camera || !self.is_complete())
    }

    /// Whether a resting camera needs no more frames: the native image is shown, and whatever else is shown has its
    /// history.
    fn is_complete(&self) -> bool {
        let has_history = self.rest.frames >= self.frames_to_rest();
        match self.view {
            View::Picture => self.rest.is_native && (has_history || self.compare == Compare::Off),
            _ => has_history,
        }
    }

    /// Whether the last frame was native without a history before it.
    pub(super) const fn is_native_alone(&self) -> bool {
        self.rest.is_native && self.rest.frames == 0
    }

    const fn has_frame_time(&self) -> bool {
        matches!(self.settings.pipeline.refine, Refine::FrameTime(_))
    }

    const fn shows_plain_frames(&self) -> bool {
        matches!((self.view, self.compare), (View::Picture, Compare::Off))
    }

    /// Whether the next frame is native though the camera may move: what is exact and fast needs no reconstruction.
    fn is_native_fast(&self) -> bool {
        self.native_when_fast
            && self.has_frame_time()
            && self.shows_plain_frames()
            && self.pace.is_native_fast(self.interval.as_secs_f64(), self.is_native_alone())
    }

    /// How long the last frame took: its stages, or all of a native frame.
    pub(super) fn frame_time(&self) -> Duration {
        match self.pace.native() {
            Some(native) if self.is_native_alone() => native,
            _ => self.desk.status().times.total(),
        }
    }

    /// Largest number of in-between frames.
    const fn most_in_between(&self) -> u32 {
        match self.settings.pipeline.mode {
            // Only frames that are rendered apart leave time to show frames in between.
            Mode::Full if self.desk.is_apart() && self.shows_plain_frames() => {
                self.settings.pipeline.in_between
            }
            _ => 0,
        }
    }

    /// The frame that is due: the next one of a moving or resting camera, or the last one shown in another way.
    fn next_frame(&mut self, now: Duration) -> Option<Job> {
        let camera = self.controls.shown().camera(self.size).ok()?;
        let make = if !self.is_rendering_due() {
            if !self.is_stale {
                return None;
            }
            Make::Nothing
        } else if self.is_native_fast()
            || (self.rest.camera == Some(camera) && self.rest.frames >= self.frames_to_rest())
        {
            self.track.clear();
            Make::Native
        } else {
            let most = self.most_in_between();
            let count = self.pace.choose_in_between(most, self.interval.as_secs_f64());
            self.track.push(now, camera);
            let between = self.track.between(count);
            self.track.restart();
            let refine = self.has_frame_time().then(|| self.frame_time_left(between.len()));
            Make::Reconstructed { refine, between }
        };
        let camera = if make == Make::Nothing { self.rest.camera.unwrap_or(camera) } else { camera };
        Some(Job {
            camera,
            asked: now,
            shows_native: make == Make::Native || (self.rest.is_native && self.rest.camera == Some(camera)),
            make,
            view: self.view,
            compare: self.compare,
            columns: self.dividers.columns(self.compare, self.size.width as usize).collect(),
            spare: std::mem::take(&mut self.spare),
        })
    }

    /// The time for the stages of a frame with `in_between` frames before it.
    fn frame_time_left(&self, in_between: usize) -> Refine {
        let intervals = self.interval.as_secs_f64() * (in_between + 1) as f64;
        // What else the viewer does takes no time of a frame that is rendered apart.
        let left = match self.desk.is_apart() {
            true => APART * intervals - self.pace.beside(),
            false => intervals - self.overhead,
        };
        Refine::FrameTime(Duration::from_secs_f64(left.max(LEAST_SHARE * intervals)))
    }

    /// When the next frame is to be asked for: so that it comes when the pictures before it have been shown.
    fn begins(&self) -> Duration {
        let expected = match self.is_native_fast() || self.rest.frames >= self.frames_to_rest() {
            true => self.pace.native().unwrap_or_default(),
            false => self.pace.expected(self.pace.in_between()),
        };
        self.display.runs_dry().saturating_sub(expected + self.interval.mul_f64(EARLY))
    }

    /// Begins the frame that is due, unless another one is under way. Returns how long the session rendered meanwhile.
    pub(super) async fn render(&mut self, now: Duration, clock: &dyn Fn() -> Duration) -> Duration {
        let is_early = self.desk.is_apart() && self.is_rendering_due() && self.begins() > now;
        if self.desk.is_busy() || is_early || self.waits_for_gpu() {
            return Duration::ZERO;
        }
        let Some(job) = self.next_frame(now) else { return Duration::ZERO };
        self.is_stale = false;
        self.is_followed = matches!(job.make, Make::Reconstructed { .. });
        self.desk.begin(job, clock).await;
        self.collect(now)
    }

    /// Takes the frame that has been finished. Returns how long the session rendered.
    pub(super) fn collect(&mut self, now: Duration) -> Duration {
        let Some(finished) = self.desk.finished() else { return Duration::ZERO };
        let is_current = finished.camera.size() == self.size;
        if is_current {
            self.pace.learn(&finished);
        }
        let Finished { camera, make, view, compare, pictures, rendering, took, notices, spare, .. } =
            finished;
        notices.into_iter().for_each(|notice| self.tell(notice, now));
        self.spare.extend(spare);
        self.spare.truncate(SPARE);
        let mut pictures = match pictures {
            Ok(pictures) => pictures,
            Err(error) => {
                self.rest = Rest::default();
                // The failure of a frame that nobody wants any more says nothing about the next one.
                self.has_failed = self.controls.shown().camera(self.size).ok() == Some(camera);
                self.is_stale |= self.frame.size != self.size.to_usize();
                (self.message, self.is_woken) = (Some(error.to_string()), true);
                return Duration::ZERO;
            }
        };
        if !is_current {
            return rendering;
        }
        if make != Make::Nothing && self.rest.camera != Some(camera) {
            self.rest = Rest { camera: Some(camera), frames: 0, is_native: false };
        }
        match make {
            Make::Nothing => {}
            Make::Reconstructed { .. } => self.rest.frames += 1,
            // What a comparison shows beside it comes with the next frame.
            Make::Native => self.rest.is_native = compare == self.compare,
        }
        if (view, compare) != (self.view, self.compare) {
            self.spare.extend(pictures.drain(..).map(|shown| shown.picture));
            self.is_stale = true;
        }
        let count = pictures.len().max(1) as u32;
        match make {
            Make::Nothing => self.display.replace(pictures, now, &mut self.spare),
            Make::Native => self.display.add(pictures, self.interval.max(took)),
            Make::Reconstructed { .. } => {
                let pace = self.interval.max(self.pace.expected(count - 1) / count);
                self.display.add(pictures, pace);
            }
        }
        rendering
    }

    /// Waits for the frame under way, so that the session is free.
    pub(super) fn wait_for_frame(&mut self, now: Duration) {
        _ = self.desk.session();
        self.collect(now);
    }

    /// Shows the picture that is due.
    pub(super) fn show_next(&mut self, now: Duration) -> Option<Displayed> {
        let shown = match self.desk.is_apart() {
            true => self.display.take(now),
            false => self.display.take_newest(&mut self.spare),
        };
        let Shown { picture, camera, asked, is_rendered } = shown?;
        self.spare.push(std::mem::replace(&mut self.frame, picture));
        self.camera = Some(camera);
        Some(Displayed { asked, is_rendered })
    }

    /// Forgets the pictures and the way of the camera: what comes is of another scene.
    pub(super) fn forget_frames(&mut self) {
        (self.display, self.track) = (Display::default(), Track::default());
        (self.rest, self.pace, self.has_failed) = (Rest::default(), Pace::default(), false);
    }

    /// Forgets the pictures that wait, as something else is to be shown.
    pub(super) fn drop_pictures(&mut self, now: Duration) {
        self.display.replace(Vec::new(), now, &mut self.spare);
    }

    /// Notes where the camera is, for frames in between.
    pub(super) fn follow_camera(&mut self, now: Duration) {
        // In-between frames need a reconstructed frame before them.
        if self.is_followed
            && self.is_displaying()
            && let Ok(camera) = self.controls.shown().camera(self.size)
        {
            self.track.push(now, camera);
        }
    }

    /// Whether pictures follow each other by themselves: nothing else needs to be shown between them.
    pub(super) fn is_displaying(&self) -> bool {
        self.desk.is_apart() && (self.desk.is_busy() || !self.display.is_empty())
    }

    /// When a viewer that renders apart is to step next, while something happens.
    pub(super) fn next_apart(&self, now: Duration) -> Duration {
        // The end of a frame under way wakes the viewer.
        let begins = (!self.desk.is_busy() && self.is_rendering_due()).then(|| self.begins());
        let shows = (!self.display.is_empty()).then(|| self.display.due());
        let next = begins.into_iter().chain(shows).min().unwrap_or(now + self.interval);
        next.clamp(now, now + self.interval)
    }
}

#[cfg(test)]
mod tests {
    use gs3::scene::demo;

    use super::*;

    const fn at(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    #[test]
    fn frames_in_between_follow_the_way_of_the_camera() {
        let cameras = demo::path();
        let mut track = Track::default();
        assert_eq!(track.between(3), []);
        track.push(at(100), cameras.cameras()[0]);
        assert_eq!(track.between(3), []);
        // It stands still for a while, and then moves: a straight line would be another way.
        for (time, camera) in [(120, 0), (140, 0), (160, 1), (180, 2)] {
            track.push(at(time), cameras.cameras()[camera]);
        }
        let between = track.between(3);
        let times: Vec<Duration> = between.iter().map(|(time, _)| *time).collect();
        assert_eq!(times, [at(120), at(140), at(160)]);
        for ((_, camera), expected) in between.iter().zip([0, 0, 1]) {
            let apart = (camera.position() - cameras.cameras()[expected].position()).length();
            assert!(apart < 1e-9, "{apart}");
        }
        track.restart();
        assert_eq!(track.between(1), []);
        track.push(at(220), cameras.cameras()[3]);
        assert_eq!(track.between(1)[0].0, at(200));
        // Frames of another size have none in between.
        track.push(at(240), cameras.cameras()[4].resized(64, 36).unwrap());
        assert_eq!(track.between(1), []);
    }
}
