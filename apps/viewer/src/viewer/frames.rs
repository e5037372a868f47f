//! The choice of the next frame, and of the part of it that is shown.

use std::time::Duration;

use gs3::{Mode, Refine};

use super::{Rest, Viewer, ViewerError};
use crate::compare::{Compare, Method};
use crate::views::{View, show_difference, show_image, show_view};

/// Least share of the interval for rendering, however long the rest takes.
const LEAST_SHARE: f64 = 0.25;

/// Largest share of the interval that a native frame of a moving camera may take; and once frames are native, for as long as
/// they stay so. The difference keeps the choice from changing to and fro.
const NATIVE_SHARES: [f64; 2] = [0.5, 0.9];

/// Factor on the differences to native, so that one step of 8 bits is visible.
const DIFFERENCE_GAIN: f32 = 8.0;

/// How long frames take, for the choice between native and reconstructed ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// The last native frame; none before the first of this scene and size.
    native: Option<Duration>,
    /// The last reconstructed frame.
    reconstructed: Option<Duration>,
}

impl Viewer {
    /// Frames that a resting camera takes until its history holds every pixel.
    pub(super) fn frames_to_rest(&self) -> usize {
        self.session.pipeline().jitter_period()
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

    /// Whether the next frame is native though the camera may move: what is exact and fast needs no reconstruction.
    fn is_native_fast(&self) -> bool {
        let Pace { native: Some(native), reconstructed } = self.pace else { return false };
        let share = NATIVE_SHARES[usize::from(self.is_native_alone())];
        self.native_when_fast
            && matches!(self.session.settings().pipeline.refine, Refine::FrameTime(_))
            && (self.view, self.compare) == (View::Picture, Compare::Off)
            && (native.as_secs_f64() <= share * self.interval.as_secs_f64()
                || reconstructed.is_some_and(|reconstructed| native < reconstructed))
    }

    /// How long the last frame took: its stages, or all of a native frame.
    pub(super) fn frame_time(&self) -> Duration {
        match self.pace.native {
            Some(native) if self.is_native_alone() => native,
            _ => self.session.pipeline().times().total(),
        }
    }

    /// Renders at most one frame. Returns whether it did, and how long the session took.
    pub(super) async fn render(&mut self, clock: &dyn Fn() -> Duration) -> (bool, Duration) {
        if !self.is_rendering_due() {
            return (false, Duration::ZERO);
        }
        let started = clock();
        let made = self.make_frame(clock).await;
        for notice in self.session.take_notices() {
            self.tell(notice, started);
        }
        if let Err(error) = made {
            self.rest = Rest::default();
            self.has_failed = true;
            self.message = Some(error.to_string());
            self.is_woken = true;
            return (false, Duration::ZERO);
        }
        self.is_stale = true;
        (true, clock().saturating_sub(started))
    }

    async fn make_frame(&mut self, clock: &dyn Fn() -> Duration) -> Result<(), ViewerError> {
        let camera = self.controls.shown().camera(self.size)?;
        let is_native_fast = self.is_native_fast();
        if self.rest.camera != Some(camera) {
            self.rest = Rest { camera: Some(camera), frames: 0, is_native: false };
        }
        let begun = clock();
        if self.rest.frames < self.frames_to_rest() && !is_native_fast {
            if matches!(self.session.settings().pipeline.refine, Refine::FrameTime(_)) {
                let interval = self.interval.as_secs_f64();
                let budget = (interval - self.overhead).max(LEAST_SHARE * interval);
                self.session.set_refine(Refine::FrameTime(Duration::from_secs_f64(budget)))?;
            }
            self.session.render_async(&camera).await?;
            self.rest.frames += 1;
            self.pace.reconstructed = Some(clock().saturating_sub(begun));
            if self.view.reads_gbuffer() {
                self.session.fetch_gbuffer_async().await?;
            }
        } else {
            self.session.reference_async(Mode::Native, &camera).await?;
            self.rest.is_native = true;
            self.pace.native = Some(clock().saturating_sub(begun));
        }
        for method in self.compare.methods() {
            if let Method::Reference(mode) = method {
                self.session.reference_async(*mode, &camera).await?;
            }
        }
        if self.compare == Compare::Difference {
            self.session.reference_async(Mode::Native, &camera).await?;
        }
        Ok(())
    }

    /// Composes the shown part of the last frame in `frame`.
    pub(super) fn compose(&mut self) {
        if !std::mem::take(&mut self.is_stale) {
            return;
        }
        let pipeline = self.session.pipeline();
        let native = self.session.last_reference(Mode::Native);
        let shown = native.filter(|_| self.rest.is_native).unwrap_or_else(|| pipeline.last_image());
        let size = [shown.width(), shown.height()];
        if size != self.size.map(|side| side as usize) {
            // A frame of the new size is on its way; until then there is no frame to show.
            self.frame.resize(self.size.map(|side| side as usize));
            self.frame.pixels.fill(0);
            return;
        }
        self.frame.resize(size);
        if self.view != View::Picture {
            return show_view(self.view, pipeline, &mut self.frame);
        }
        if let (Compare::Difference, Some(native)) = (self.compare, native) {
            return show_difference(shown, native, DIFFERENCE_GAIN, &mut self.frame);
        }
        let mut from = 0;
        let mut ends = self.dividers.columns(self.compare, size[0]);
        for method in self.compare.methods() {
            let end = ends.next().unwrap_or(size[0]);
            let image = match method {
                Method::Reference(mode) => self.session.last_reference(*mode).unwrap_or(shown),
                Method::Gs3 => shown,
            };
            show_image(image, from..end, &mut self.frame);
            from = end;
        }
    }
}
