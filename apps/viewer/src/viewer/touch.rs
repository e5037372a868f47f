//! Fingers on a screen: one is the left button, two pan by their middle and approach by their distance.

use std::time::Duration;

use super::Viewer;
use crate::input::{Button, Input, Touch};

/// Fingers on the screen, in the order in which they came.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Fingers {
    down: Vec<(u64, [f32; 2])>,
    /// Whether there were two fingers: then the last one does not turn the view.
    were_two: bool,
}

impl Fingers {
    /// The middle of the first two and their distance, pixels.
    fn pair(&self) -> Option<([f32; 2], f32)> {
        let [(_, a), (_, b), ..] = self.down[..] else { return None };
        Some(([0, 1].map(|axis| 0.5 * (a[axis] + b[axis])), (a[0] - b[0]).hypot(a[1] - b[1])))
    }
}

impl Viewer {
    /// Processes `touch` of `finger` at `at`. Fingers that never began are ignored.
    pub(super) fn touch(&mut self, finger: u64, touch: Touch, at: [f32; 2], now: Duration) {
        let place = self.fingers.down.iter().position(|(number, _)| *number == finger);
        match (touch, place) {
            (Touch::Began, None) => {
                self.fingers.down.push((finger, at));
                if self.fingers.down.len() == 1 {
                    self.fingers.were_two = false;
                    self.handle(Input::PointerMoved(at), now);
                    self.handle(Input::Button(Button::Left, true), now);
                } else if !std::mem::replace(&mut self.fingers.were_two, true) {
                    self.lift(now);
                }
            }
            (Touch::Began | Touch::Moved, Some(place)) => {
                let before = self.fingers.pair();
                self.fingers.down[place].1 = at;
                match (before, self.fingers.pair()) {
                    (Some(before), Some(after)) => self.pinch(before, after),
                    _ if !self.fingers.were_two => self.handle(Input::PointerMoved(at), now),
                    _ => {}
                }
            }
            (Touch::Ended, Some(place)) => {
                self.fingers.down.remove(place);
                if self.fingers.down.is_empty() && !self.fingers.were_two {
                    self.lift(now);
                }
            }
            (Touch::Moved | Touch::Ended, None) => {}
        }
    }

    /// Ends the left button of the finger that had it.
    fn lift(&mut self, now: Duration) {
        self.handle(Input::Button(Button::Left, false), now);
        self.handle(Input::PointerGone, now);
    }

    fn pinch(&mut self, before: ([f32; 2], f32), after: ([f32; 2], f32)) {
        self.tour.stop();
        let delta = [0, 1].map(|axis| f64::from(after.0[axis] - before.0[axis]));
        self.controls.pan(delta, f64::from(self.size.height));
        // Two fingers at one point have no ratio of distances.
        if before.1 > 0.0 && after.1 > 0.0 {
            self.controls.approach(f64::from(before.1) / f64::from(after.1));
        }
    }
}
