//! How long frames take, and what follows: native or reconstructed frames, and how many frames in between.

use std::time::Duration;

use gs3::Stage;

use super::job::{Finished, Make};

/// Largest share of the interval that a native frame of a moving camera may take; and once frames are native, for as long as
/// they stay so. The difference keeps the choice from changing to and fro.
const NATIVE_SHARES: [f64; 2] = [0.5, 0.9];

/// Largest share of its intervals that a rendered frame may take with the in-between frames before it and without exact
/// pixels. Exact pixels take the rest. The second value applies to fewer in-between frames than before.
const GROUP_SHARES: [f64; 2] = [0.85, 0.7];

/// Weight of a new measurement against the earlier ones, as in the controller of exact pixels.
pub(super) const NEWEST: f64 = 0.5;

/// How long frames take, in seconds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// The last native frame; none before the first of this scene and size.
    native: Option<f64>,
    /// Reconstructed frames without exact pixels and in-between frames; none before the first.
    plain: Option<f64>,
    /// An in-between frame; none before the first.
    between: Option<f64>,
    /// The exact pixels of a frame.
    refining: f64,
    /// What takes time besides rendering, for each picture.
    composing: f64,
    /// What takes time besides the stages of a frame.
    beside: f64,
    /// In-between frames before each rendered one.
    in_between: u32,
}

/// `new`, or between `old` and `new`.
fn follow(old: Option<f64>, new: f64) -> f64 {
    old.map_or(new, |old| old + NEWEST * (new - old))
}

impl Pace {
    /// Takes the times of a frame.
    pub fn learn(&mut self, finished: &Finished) {
        let Finished { making, rendering, took, times, make, .. } = finished;
        let pictures = finished.pictures.as_ref().map_or(0, Vec::len);
        if pictures == 0 {
            return;
        }
        let composing = took.saturating_sub(*rendering).as_secs_f64() / pictures as f64;
        match make {
            Make::Nothing => {}
            Make::Native => self.native = Some(making.as_secs_f64()),
            Make::Reconstructed { between, .. } => {
                let stage = |stage| times.get(stage).unwrap_or_default();
                let [refining, interpolating] = [Stage::Refine, Stage::Interpolate].map(stage);
                let plain = making.saturating_sub(refining).saturating_sub(interpolating);
                self.plain = Some(follow(self.plain, plain.as_secs_f64()));
                self.refining += NEWEST * (refining.as_secs_f64() - self.refining);
                self.composing += NEWEST * (composing - self.composing);
                if !between.is_empty() && interpolating > Duration::ZERO {
                    let each = interpolating.as_secs_f64() / between.len() as f64;
                    self.between = Some(follow(self.between, each));
                }
                // Without what is rendered to compare with.
                let beside = took.saturating_sub(*rendering) + making.saturating_sub(times.total());
                self.beside += NEWEST * (beside.as_secs_f64() - self.beside);
            }
        }
    }

    /// How long the last native frame took.
    pub fn native(&self) -> Option<Duration> {
        self.native.map(Duration::from_secs_f64)
    }

    /// What takes time of a frame besides its stages, in seconds.
    pub const fn beside(&self) -> f64 {
        self.beside
    }

    /// Whether native frames are as fast as frames at `interval` seconds need, or faster than reconstructed ones. `is_native`
    /// says whether frames are native now.
    pub fn is_native_fast(&self, interval: f64, is_native: bool) -> bool {
        let Some(native) = self.native else { return false };
        let share = NATIVE_SHARES[usize::from(is_native)];
        native <= share * interval || self.group(self.in_between).is_some_and(|group| native < group)
    }

    /// Chooses the number of in-between frames, at most `most`: the least that lets pictures follow each other at `interval`
    /// seconds.
    pub fn choose_in_between(&mut self, most: u32, interval: f64) -> u32 {
        let fits = |count: &u32| {
            let share = GROUP_SHARES[usize::from(*count < self.in_between)];
            self.group(*count).is_none_or(|each| each + self.composing <= share * interval)
        };
        self.in_between = (0..most).find(fits).unwrap_or(most);
        self.in_between
    }

    /// In-between frames before each rendered one, as last chosen.
    pub const fn in_between(&self) -> u32 {
        self.in_between
    }

    /// Seconds of rendering for a displayed frame without exact pixels, with `count` in-between frames before each rendered one.
    fn group(&self, count: u32) -> Option<f64> {
        let plain = self.plain?;
        // Before the first one, in-between frames are taken for a third of a frame: twice what was measured at 1280×720 with
        // two threads, 15 of 66 ms.
        let between = self.between.unwrap_or(plain / 3.0);
        Some((plain + between * f64::from(count)) / f64::from(count + 1))
    }

    /// How long the next frame takes with `count` in-between frames before it.
    pub fn expected(&self, count: u32) -> Duration {
        let each = self.group(count).unwrap_or_default() + self.composing;
        Duration::from_secs_f64(each * f64::from(count + 1) + self.refining)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: f64 = 1.0 / 30.0;

    fn pace(plain: f64, between: f64) -> Pace {
        Pace { plain: Some(plain), between: Some(between), ..Pace::default() }
    }

    #[test]
    fn there_are_as_few_frames_in_between_as_the_rate_allows() {
        assert_eq!(Pace::default().choose_in_between(3, INTERVAL), 0, "nothing is known yet");
        for (plain, between, expected) in
            [(0.020, 0.005, 0), (0.045, 0.010, 1), (0.055, 0.014, 2), (0.065, 0.015, 3), (0.300, 0.020, 3)]
        {
            assert_eq!(pace(plain, between).choose_in_between(3, INTERVAL), expected, "{plain}");
        }
        // Modes without in-between frames have none.
        assert_eq!(pace(0.3, 0.02).choose_in_between(0, INTERVAL), 0);
    }

    #[test]
    fn the_choice_does_not_change_to_and_fro() {
        let mut pace = pace(0.030, 0.010);
        assert_eq!(pace.choose_in_between(3, INTERVAL), 1);
        pace.plain = Some(0.026);
        assert_eq!(pace.choose_in_between(3, INTERVAL), 1, "a frame alone fits only just");
        pace.plain = Some(0.020);
        assert_eq!(pace.choose_in_between(3, INTERVAL), 0);
    }

    #[test]
    fn native_frames_are_chosen_where_they_are_fast_or_faster() {
        let native = |native, plain| Pace { native: Some(native), plain: Some(plain), ..Pace::default() };
        assert!(!Pace::default().is_native_fast(INTERVAL, false));
        assert!(native(0.016, 0.010).is_native_fast(INTERVAL, false));
        assert!(!native(0.020, 0.010).is_native_fast(INTERVAL, false));
        assert!(native(0.020, 0.010).is_native_fast(INTERVAL, true));
        assert!(native(0.040, 0.050).is_native_fast(INTERVAL, false));
        // With in-between frames, reconstructed frames come more often than native ones.
        let mut slow = Pace { native: Some(0.080), between: Some(0.015), ..native(0.080, 0.090) };
        assert!(slow.is_native_fast(INTERVAL, false));
        slow.choose_in_between(3, INTERVAL);
        assert!(!slow.is_native_fast(INTERVAL, false));
    }
}
