//! When displayed frames are shown.

use serde::{Deserialize, Serialize};

/// The moment of a displayed frame. Rendered frames are equally spaced, and so are the frames between two of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Moment(pub(super) usize);

/// Moments from one rendered frame to the next: as few as hold the frames between for each number of them, 1 to
/// [`gs3::MAX_IN_BETWEEN`].
pub(super) const PER_RENDERED: usize = 12;

impl Moment {
    /// The moment of rendered frame `i`.
    #[must_use]
    pub const fn rendered(i: usize) -> Self {
        Self(i * PER_RENDERED)
    }

    /// The moments of the `count` frames, at most [`gs3::MAX_IN_BETWEEN`], between rendered frame `i` and the one
    /// before it, in order. Nothing lies before the first frame.
    pub fn before(i: usize, count: u32) -> impl Iterator<Item = Self> {
        let parts = count as usize + 1;
        let start = i.checked_sub(1).map(Self::rendered);
        start
            .into_iter()
            .flat_map(move |Self(start)| (1..parts).map(move |k| Self(start + k * PER_RENDERED / parts)))
    }

    /// Whether a frame is rendered at this moment.
    #[must_use]
    pub const fn is_rendered(self) -> bool {
        self.0.is_multiple_of(PER_RENDERED)
    }

    /// Time since the first rendered frame, in rendered frames.
    #[must_use]
    pub fn time(self) -> f64 {
        self.0 as f64 / PER_RENDERED as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3::{MAX_IN_BETWEEN, PipelineSettings};

    #[test]
    fn frames_between_are_at_the_moments_of_the_pipeline() {
        for in_between in 1..=MAX_IN_BETWEEN {
            let settings = PipelineSettings { in_between, ..PipelineSettings::default() };
            let expected: Vec<f64> = settings.moments().map(|t| 4.0 + t).collect();
            let moments: Vec<Moment> = Moment::before(5, in_between).collect();
            assert_eq!(moments.len(), expected.len());
            assert!(moments.iter().zip(&expected).all(|(m, t)| (m.time() - t).abs() < 1e-12), "{moments:?}");
            assert!(!moments.iter().any(|moment| moment.is_rendered()));
            assert_eq!(Moment::before(0, in_between).count(), 0);
        }
        assert_eq!(Moment::before(5, 0).count(), 0);
        assert!(Moment::rendered(5).is_rendered() && Moment::rendered(5).time() == 5.0);
    }
}
