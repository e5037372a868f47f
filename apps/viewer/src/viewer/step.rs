//! A step: inputs, the camera, a frame, the picture.

use std::time::Duration;

use super::pace::NEWEST;
use super::{Next, Step, Viewer};
use crate::heap::give_back;
use crate::input::Input;

/// Longest time that a movement advances in one step, in seconds: no jumps after a slow frame.
const LONGEST_STEP: f64 = 0.1;

impl Viewer {
    /// Takes an input, which takes effect in the next step.
    pub fn input(&mut self, input: Input) {
        self.inputs.push(input);
        self.is_idle = false;
    }

    /// Advances to the current time. `clock` is the time since any fixed moment. In a browser [`Self::step_async`] is
    /// for sessions on GPUs.
    pub fn step(&mut self, clock: &dyn Fn() -> Duration) -> Step {
        pollster::block_on(self.step_async(clock))
    }

    /// Advances to the current time, as [`Self::step`] does, without blocking a browser.
    pub async fn step_async(&mut self, clock: &dyn Fn() -> Duration) -> Step {
        let started = clock();
        let seconds = match self.last_step {
            Some(last) if !self.figures_paused() => started.saturating_sub(last).as_secs_f64(),
            _ => self.interval.as_secs_f64(),
        };
        self.last_step = Some(started);
        let inputs = std::mem::take(&mut self.inputs);
        let mut is_due = std::mem::take(&mut self.is_woken) || !self.shots.is_empty();
        self.is_unpainted |= !inputs.is_empty() || self.panels.due().is_some_and(|due| due <= started);
        // Pictures that follow each other bring the panels along. Between them, panels are painted as often.
        is_due |= self.is_unpainted && !(self.is_displaying() && started < self.painted + self.interval);
        is_due |= self.note.take_if(|(_, until)| *until <= started).is_some();
        self.has_failed &= inputs.is_empty();
        for input in inputs {
            self.handle(input, started);
        }
        if let Some(at) = self.pivot_at.take() {
            self.set_pivot(at, started).await;
        }
        self.move_camera(seconds.min(LONGEST_STEP));
        self.follow_camera(started);
        self.collect(started);
        let rendering = self.render(started, clock).await;
        let shown = self.show_next(started);
        is_due |= shown.is_some();
        if is_due {
            let actions = self.paint(started, shown.is_some());
            (self.is_unpainted, self.painted) = (false, started);
            if let Some(displayed) = shown {
                self.figures.show(clock(), displayed);
            }
            actions.into_iter().for_each(|action| self.act(action, started));
            self.take_shots(started).await;
            let rest = clock().saturating_sub(started).saturating_sub(rendering).as_secs_f64();
            self.overhead += NEWEST * (rest - self.overhead);
        }
        // After the frame: natively this waits for the GPU.
        self.change_over(started);
        self.next = self.next(started);
        Step { is_new: is_due, next: self.next }
    }

    /// When the next step is due: as the last step said, or at once after an input or another request.
    #[must_use]
    pub const fn next_step(&self) -> Next {
        if self.is_woken || !self.inputs.is_empty() || !self.shots.is_empty() {
            Next::At(Duration::ZERO)
        } else {
            self.next
        }
    }

    /// Reports how long the picture took to reach the screen after a step.
    pub fn presented(&mut self, took: Duration) {
        // The step's own part has been measured already; this time is added to it.
        self.overhead += NEWEST * took.as_secs_f64();
    }

    fn next(&mut self, started: Duration) -> Next {
        let is_active = self.is_woken
            || self.is_unpainted
            || self.is_stale
            || !self.inputs.is_empty()
            || !self.shots.is_empty()
            || self.controls.is_moving()
            || self.tour.playing().is_some()
            || self.is_rendering_due()
            || self.is_displaying();
        let due = self.due + self.interval;
        // A late step is not followed by hurried steps.
        self.due = if due + self.interval < started || due > started + self.interval {
            started + self.interval
        } else {
            due
        };
        if is_active {
            self.is_idle = false;
            return Next::At(if self.desk.is_apart() { self.next_apart(started) } else { self.due });
        }
        let begins_rest = !std::mem::replace(&mut self.is_idle, true);
        if begins_rest {
            self.figures.pause();
            self.track.clear();
        }
        if self.is_warming_up() {
            // More frames are to come, without an event.
            self.is_idle = false;
            return Next::At(self.due);
        }
        if begins_rest {
            give_back();
        }
        let note = self.note.as_ref().map(|(_, until)| *until);
        match [self.panels.due(), note].into_iter().flatten().min() {
            Some(due) => Next::At(due.max(self.due)),
            None => Next::Idle,
        }
    }

    fn figures_paused(&self) -> bool {
        self.is_idle
    }
}
