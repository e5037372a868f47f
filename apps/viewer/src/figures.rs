//! How fast frames come: honest figures for the panel.

use std::collections::VecDeque;
use std::time::Duration;

/// Frames that figures are of: two seconds of 30 frames a second.
const REMEMBERED: usize = 60;

/// A picture that was shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Displayed {
    /// When the camera was where the picture shows it.
    pub asked: Duration,
    /// Whether the scene was rendered for it; false for in-between frames.
    pub is_rendered: bool,
}

/// When pictures were shown, and whether they were rendered.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    shown: VecDeque<(Duration, Displayed)>,
    rendered: usize,
    displayed: usize,
}

/// What is known of the frames shown last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// Displayed frames per second.
    pub displayed: f64,
    /// Those for which the scene was rendered, per second.
    pub rendered: f64,
    /// Median of the intervals between displayed frames, milliseconds.
    pub median: f64,
    /// Their 95th percentile, milliseconds.
    pub percentile_95: f64,
    /// Median of the time from the camera's movement to the picture of it, milliseconds.
    pub latency: f64,
}

impl Figures {
    /// A picture was shown at `now`.
    pub fn show(&mut self, now: Duration, displayed: Displayed) {
        if self.shown.len() == REMEMBERED {
            self.shown.pop_front();
        }
        self.shown.push_back((now, displayed));
        self.displayed += 1;
        self.rendered += usize::from(displayed.is_rendered);
    }

    /// Nothing is shown for a while, and no interval spans it.
    pub fn pause(&mut self) {
        self.shown.clear();
    }

    /// Frames for which the scene was rendered, since the beginning.
    #[must_use]
    pub const fn rendered(&self) -> usize {
        self.rendered
    }

    /// Frames displayed since the beginning.
    #[must_use]
    pub const fn displayed(&self) -> usize {
        self.displayed
    }

    /// What is known of the frames shown last; none before there are two.
    #[must_use]
    pub fn rates(&self) -> Option<Rates> {
        let (first, last) = (self.shown.front()?.0, self.shown.back()?.0);
        let span = last.checked_sub(first)?.as_secs_f64();
        if span <= 0.0 {
            return None;
        }
        let mut intervals: Vec<f64> = self
            .shown
            .iter()
            .zip(self.shown.iter().skip(1))
            .map(|(a, b)| b.0.saturating_sub(a.0).as_secs_f64() * 1e3)
            .collect();
        intervals.sort_by(f64::total_cmp);
        let count = intervals.len();
        let at = |share: f64| intervals[((share * count as f64).ceil() as usize).clamp(1, count) - 1];
        let rendered = self.shown.iter().skip(1).filter(|(_, displayed)| displayed.is_rendered).count();
        let since = |(now, displayed): &(Duration, Displayed)| {
            now.saturating_sub(displayed.asked).as_secs_f64() * 1e3
        };
        let mut latencies: Vec<f64> = self.shown.iter().map(since).collect();
        latencies.sort_by(f64::total_cmp);
        Some(Rates {
            displayed: count as f64 / span,
            rendered: rendered as f64 / span,
            median: at(0.5),
            percentile_95: at(0.95),
            latency: latencies[latencies.len() / 2],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_of_the_intervals() {
        let mut figures = Figures::default();
        let at = Duration::from_millis;
        figures.show(at(0), Displayed { asked: at(0), is_rendered: true });
        assert_eq!(figures.rates(), None);
        // 18 intervals of 20 ms, two of 70 ms; every other frame is rendered.
        let mut now = 0;
        for k in 1..=20 {
            now += if k % 10 == 0 { 70 } else { 20 };
            figures.show(at(now), Displayed { asked: at(now - 15), is_rendered: k % 2 == 0 });
        }
        let rates = figures.rates().unwrap();
        assert!((rates.displayed - 40.0).abs() < 1e-9 && (rates.rendered - 20.0).abs() < 1e-9);
        assert!((rates.median - 20.0).abs() < 1e-9 && (rates.percentile_95 - 70.0).abs() < 1e-9);
        assert!((rates.latency - 15.0).abs() < 1e-9);
        assert_eq!((figures.displayed(), figures.rendered()), (21, 11));
        figures.pause();
        assert_eq!(figures.rates(), None);
        assert_eq!(figures.displayed(), 21);
    }
}
