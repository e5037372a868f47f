//! When pictures are shown: evenly, also where frames come in groups.

use std::collections::VecDeque;
use std::time::Duration;

use super::job::Shown;
use crate::paint::Framebuffer;

/// Pictures that wait to be shown.
#[derive(Debug, Default)]
pub(super) struct Display {
    waiting: VecDeque<Shown>,
    /// The time from one picture to the next.
    pace: Duration,
    /// When the next picture is due.
    due: Duration,
}

impl Display {
    /// Adds `pictures` after those that wait, and shows all at `pace`.
    pub fn add(&mut self, pictures: Vec<Shown>, pace: Duration) {
        self.waiting.extend(pictures);
        self.pace = pace;
    }

    /// Shows `pictures` at once, instead of those that wait: their memory goes to `spare`.
    pub fn replace(&mut self, pictures: Vec<Shown>, now: Duration, spare: &mut Vec<Framebuffer>) {
        spare.extend(self.waiting.drain(..).map(|shown| shown.picture));
        self.waiting.extend(pictures);
        self.due = self.due.min(now);
    }

    /// The picture that is due at `now`, if there is one.
    pub fn take(&mut self, now: Duration) -> Option<Shown> {
        if now < self.due {
            return None;
        }
        let shown = self.waiting.pop_front()?;
        // A late picture is not followed by hurried ones.
        let due = self.due + self.pace;
        self.due = if due < now { now + self.pace } else { due };
        Some(shown)
    }

    /// The newest picture. The others are not shown any more: their memory goes to `spare`.
    pub fn take_newest(&mut self, spare: &mut Vec<Framebuffer>) -> Option<Shown> {
        let newest = self.waiting.pop_back();
        spare.extend(self.waiting.drain(..).map(|shown| shown.picture));
        newest
    }

    /// Whether no picture waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// When the next picture is due.
    pub const fn due(&self) -> Duration {
        self.due
    }

    /// When a picture is due that does not wait yet.
    pub fn runs_dry(&self) -> Duration {
        self.due + self.pace * self.waiting.len() as u32
    }
}

#[cfg(test)]
mod tests {
    use gs3::scene::demo;

    use super::*;

    fn pictures(count: usize) -> Vec<Shown> {
        let camera = demo::path().cameras()[0];
        let one = |k| Shown {
            picture: Framebuffer { size: [k, 1], pixels: vec![0; k] },
            camera,
            asked: Duration::ZERO,
            is_rendered: false,
        };
        (1..=count).map(one).collect()
    }

    const fn at(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn width(shown: Option<Shown>) -> Option<usize> {
        shown.map(|shown| shown.picture.size[0])
    }

    #[test]
    fn groups_are_shown_evenly_and_a_late_picture_hurries_none() {
        let mut display = Display::default();
        display.add(pictures(3), at(30));
        assert_eq!(width(display.take(at(100))), Some(1));
        assert_eq!(width(display.take(at(110))), None, "too early");
        assert_eq!(display.runs_dry(), at(190));
        // A few milliseconds late: the next one keeps to the grid.
        assert_eq!((width(display.take(at(134))), display.due()), (Some(2), at(160)));
        // Late by more than the pace.
        assert_eq!((width(display.take(at(250))), display.due()), (Some(3), at(280)));
        assert_eq!(width(display.take(at(300))), None);
        assert!(display.is_empty());
    }

    #[test]
    fn what_replaces_the_waiting_pictures_is_due_at_once() {
        let (mut display, mut spare) = (Display::default(), Vec::new());
        display.add(pictures(4), at(100));
        assert_eq!(width(display.take(at(10))), Some(1));
        display.replace(pictures(2), at(20), &mut spare);
        assert_eq!((spare.len(), width(display.take(at(20)))), (3, Some(1)));
        assert_eq!((width(display.take(at(30))), width(display.take(at(120)))), (None, Some(2)));
    }

    #[test]
    fn the_newest_is_taken_and_the_memory_of_the_others_is_kept() {
        let mut display = Display::default();
        let mut spare = Vec::new();
        assert_eq!(width(display.take_newest(&mut spare)), None);
        display.add(pictures(3), at(30));
        assert_eq!(width(display.take_newest(&mut spare)), Some(3));
        assert_eq!((spare.len(), display.is_empty()), (2, true));
    }
}
