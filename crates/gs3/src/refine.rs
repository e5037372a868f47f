//! How much of a frame is rasterized exactly, where the reconstruction cannot be trusted.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use gs3_reconstruct::BlockBudget;
use gs3_scene::Size;

use crate::stages::{Stage, StageTimes};

/// The default effort for a frame: the error that may stay in a block of 4×4 pixels, and the largest share of pixels
/// that is rasterized exactly to reduce it. Frames above 1920×1080 pixels have at most as many exact pixels as frames of 1920×1080.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quality {
    /// Errors of twelve steps of 8 bits, 8 % of the pixels.
    Fast,
    /// Errors of 5.75 steps of 8 bits, 17.5 % of the pixels.
    #[default]
    Balanced,
    /// Errors of three steps of 8 bits, 30 % of the pixels. In-between frames: errors of four steps, 5 % of the pixels.
    High,
}

impl Quality {
    /// All qualities, the fastest first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Balanced, Self::High];

    /// The quality's name in the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::High => "high",
        }
    }

    /// Most pixels of a frame with the whole share: 1920×1080. Native rendering of `flowers_orbit` takes about twice as long at 4096×2160
    /// as at 1920×1080, and super sampling and interpolation four times as long, so less time is left for exact pixels.
    const MOST_PIXELS: f32 = 1920.0 * 1080.0;

    /// The budget of [`Refine::Auto`] for a rendered frame of `size`. Above 1920×1080 pixels no more pixels may be exact than there.
    ///
    /// (Empirical, two in-between frames, 1920×1080, two AVX2 cores. On `flowers_orbit`, whose native frames are the fastest, the
    /// qualities display 2.0, 1.6 and 1.1 times as many frames as native rendering. With 6 instead of 5.75 steps the 99th
    /// percentile of the errors of 8×8 blocks of `flowers_drift` is 5.9 instead of 5.8 of 255.)
    #[must_use]
    pub fn budget(self, size: Size) -> BlockBudget {
        let BlockBudget { most, least_error } = match self {
            Self::Fast => budget(0.08, 12.0),
            Self::Balanced => budget(0.175, 5.75),
            Self::High => budget(0.3, 3.0),
        };
        let pixels = size.width as f32 * size.height as f32;
        BlockBudget { most: most * (Self::MOST_PIXELS / pixels.max(1.0)).min(1.0), least_error }
    }

    /// The budget of [`Refine::Auto`] for in-between frames; none if in-between frames have no exact pixels.
    ///
    /// Gaussians are projected anew for an in-between frame. At 1920×1080 this takes 6 to 9 ms for however few pixels (captures,
    /// two AVX2 cores). With [`Self::Balanced`], exact pixels of in-between frames would gain 0.4 to 1 dB there on `fungi` and
    /// `lacadiere`, in a tenth to a fifth more time.
    #[must_use]
    pub fn budget_between(self) -> Option<BlockBudget> {
        match self {
            Self::Fast | Self::Balanced => None,
            Self::High => Some(budget(0.05, 4.0)),
        }
    }
}

/// At most the share `most` of the pixels, where errors of so many `steps` of 8 bits are expected.
fn budget(most: f32, steps: f32) -> BlockBudget {
    BlockBudget { most, least_error: (steps / 255.0).powi(2) }
}

/// Which pixels of a rendered frame are rasterized exactly besides the low-resolution grid: the blocks of 4×4 pixels
/// with the largest expected error. Exact blocks equal the native image.
///
/// Read by [`Mode::SuperSample`](crate::Mode::SuperSample) and [`Mode::Full`](crate::Mode::Full). Later frames reproject
/// exact blocks. A GPU remembers the newest blocks, up to a quarter of the picture. Some frames of a GPU have none
/// ([`FramePipeline::makes_exact_pixels`](crate::FramePipeline::makes_exact_pixels)).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Refine {
    /// None, as in the paper.
    Off,
    /// The blocks with the largest expected errors, within the budget of the pipeline's [`Quality`]. A frame without history
    /// is rasterized exactly as a whole. In-between frames that a CPU makes without an interpolation network have exact blocks, too,
    /// if the quality says so ([`Quality::budget_between`]).
    #[default]
    Auto,
    /// This share of the pixels, `[0, 1]`, independent of their errors. A frame without history is rasterized exactly
    /// as a whole.
    Share(f32),
    /// As many blocks as fit into this time for a rendered frame and the in-between frames before it. This is for
    /// interactive programs. A frame without history also keeps to the time. The number of blocks depends on the
    /// machine's speed. On a GPU without timestamps at most 1 % of the pixels are exact.
    FrameTime(Duration),
}

impl Refine {
    /// Whether there are exact blocks at all.
    #[must_use]
    pub fn is_on(self) -> bool {
        !matches!(self, Self::Off | Self::Share(0.0))
    }

    /// Whether a frame without history is exact as a whole.
    #[must_use]
    pub const fn starts_exact(self) -> bool {
        matches!(self, Self::Auto | Self::Share(_))
    }
}

/// `off`, `auto`, the share, or the frame time in milliseconds.
impl fmt::Display for Refine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Auto => f.write_str("auto"),
            Self::Share(share) => write!(f, "{share}"),
            Self::FrameTime(time) => write!(f, "{}ms", time.as_secs_f64() * 1e3),
        }
    }
}

/// The text that is no [`Refine`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected off, auto, a share of the pixels from 0 to 1, or milliseconds as in 33ms, found {actual:?}"
)]
pub struct RefineError {
    /// The text found.
    pub actual: String,
}

/// Reads the text that [`Refine`] prints.
impl FromStr for Refine {
    type Err = RefineError;

    fn from_str(text: &str) -> Result<Self, RefineError> {
        let error = || RefineError { actual: text.to_owned() };
        match text {
            "off" => return Ok(Self::Off),
            "auto" => return Ok(Self::Auto),
            _ => {}
        }
        if let Some(milliseconds) = text.strip_suffix("ms") {
            let milliseconds: f64 = milliseconds.parse().map_err(|_| error())?;
            let is_time = milliseconds > 0.0 && milliseconds <= 60_000.0;
            return is_time
                .then(|| Self::FrameTime(Duration::from_secs_f64(milliseconds / 1e3)))
                .ok_or_else(error);
        }
        let share: f32 = text.parse().map_err(|_| error())?;
        (0.0..=1.0).contains(&share).then_some(Self::Share(share)).ok_or_else(error)
    }
}

/// Adjusts the share of exact pixels so that frames take the allowed time.
///
/// The time of a frame is a fixed part plus a part in proportion to the share of exact blocks. Both parts are
/// estimated from earlier frames. A fitting share is found at once when the proportional part is known.
#[derive(Clone, Copy, Debug)]
pub struct ShareController {
    share: f32,
    /// Seconds of a frame without blocks, and seconds of a frame made of blocks only; 0 until they are known.
    fixed: f64,
    per_share: f64,
}

/// The share of the first frame: small, as the machine's speed is still unknown.
const FIRST_SHARE: f32 = 0.01;

/// Weight of a new measurement against the earlier ones: half. A single slow frame then does not swing the share, and
/// a change is followed within three frames.
const NEWEST: f64 = 0.5;

/// Part of the time that may be planned: frames differ by a few percent from the time of earlier frames.
const PLANNED: f64 = 0.95;

impl Default for ShareController {
    fn default() -> Self {
        Self { share: FIRST_SHARE, fixed: 0.0, per_share: 0.0 }
    }
}

impl ShareController {
    /// The share of the next frame.
    pub const fn share(&self) -> f32 {
        self.share
    }

    /// Records the `times` of a frame made under `refine`, with a share `refined` of exact pixels.
    pub fn learn_frame(&mut self, refine: Refine, times: &StageTimes, refined: f32) {
        let Refine::FrameTime(target) = refine else { return };
        // Frames that nobody waits for have no time.
        if times.total() > Duration::ZERO {
            let refining = times.get(Stage::Refine).unwrap_or_default();
            self.learn(target, times.total(), refining, refined);
        }
    }

    /// Records the time of a frame: `total`, with `refining` for its exact blocks, which are a share `refined` of its
    /// pixels. While the time of blocks is unknown (on a GPU without a clock always), the share is the first one if the frame
    /// fits its time, and zero else.
    fn learn(&mut self, target: Duration, total: Duration, refining: Duration, refined: f32) {
        let follow = |old: f64, new: f64| if old > 0.0 { old + NEWEST * (new - old) } else { new };
        let fixed = total.saturating_sub(refining).as_secs_f64();
        self.fixed = follow(self.fixed, fixed);
        if refined > 0.0 {
            self.per_share = follow(self.per_share, refining.as_secs_f64() / f64::from(refined));
        } else if self.share > 0.0 {
            // Less than a block was asked for. If a block was measured as too slow, then this is found out again.
            self.per_share *= NEWEST;
        }
        self.share = if self.per_share > 0.0 {
            let left = PLANNED * target.as_secs_f64() - self.fixed;
            ((left / self.per_share) as f32).clamp(0.0, 1.0)
        } else if total <= target {
            FIRST_SHARE
        } else {
            0.0
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_read() {
        for refine in [
            Refine::Off,
            Refine::Auto,
            Refine::Share(0.05),
            Refine::Share(1.0),
            Refine::FrameTime(Duration::from_millis(33)),
        ] {
            assert_eq!(refine.to_string().parse(), Ok(refine));
        }
        for wrong in ["", "on", "-0.1", "1.5", "NaN", "0ms", "-3ms", "ms", "1e9ms", "infms"] {
            assert_eq!(wrong.parse::<Refine>(), Err(RefineError { actual: wrong.to_owned() }));
        }
    }

    #[test]
    fn a_better_quality_may_spend_more_and_leaves_less() {
        for pair in Quality::ALL.windows(2) {
            let [worse, better] = [pair[0], pair[1]].map(|quality| quality.budget(Size::new(1920, 1080)));
            assert!(better.most > worse.most && better.least_error < worse.least_error);
        }
        for quality in Quality::ALL {
            let sizes = [(1, 1), (1920, 1080), (3840, 2160)];
            let [smallest, hd, four_times] =
                sizes.map(|(width, height)| quality.budget(Size::new(width, height)));
            assert_eq!(smallest, hd);
            assert!(
                (four_times.most - hd.most / 4.0).abs() < 1e-6 && four_times.least_error == hd.least_error
            );
        }
    }

    /// A machine that takes 10 ms for a frame plus 200 ms for all of its pixels, each up to a tenth more or less.
    #[test]
    fn the_controller_holds_a_frame_time() {
        let target = Duration::from_millis(33);
        let mut controller = ShareController::default();
        let mut slowdown = 1.0;
        for frame in 0..60 {
            if frame == 30 {
                slowdown = 1.5;
            }
            let noise = if frame % 3 == 0 { 1.1 } else { 0.95 };
            let refining = Duration::from_secs_f64(0.2 * f64::from(controller.share()) * slowdown * noise);
            let total = Duration::from_secs_f64(0.01 * slowdown * noise) + refining;
            if (5..30).contains(&frame) || frame > 35 {
                let ratio = total.as_secs_f64() / target.as_secs_f64();
                assert!((0.75..1.12).contains(&ratio), "frame {frame} took {total:?}");
            }
            controller.learn(target, total, refining, controller.share());
        }
    }

    #[test]
    fn a_machine_without_time_left_refines_nothing_until_there_is_time_again() {
        let mut controller = ShareController::default();
        let target = Duration::from_millis(10);
        controller.learn(target, Duration::from_millis(50), Duration::from_millis(2), 0.01);
        assert_eq!(controller.share(), 0.0);
        controller.learn(target, Duration::from_millis(50), Duration::ZERO, 0.0);
        assert_eq!(controller.share(), 0.0);
        // Frames become fast: what blocks take is known from before.
        for _ in 0..10 {
            let refining = Duration::from_secs_f64(0.2 * f64::from(controller.share()));
            let total = Duration::from_millis(5) + refining;
            controller.learn(target, total, refining, controller.share());
        }
        let expected = (0.95 * 0.01 - 0.005) / (0.002 / 0.01);
        assert!((f64::from(controller.share()) - expected).abs() < 1e-3, "{}", controller.share());
    }

    /// Without a clock all of a frame counts as work before its blocks.
    #[test]
    fn without_a_clock_few_blocks_are_made_where_there_is_time() {
        let mut controller = ShareController::default();
        let target = Duration::from_millis(10);
        for (total, share) in [(5, FIRST_SHARE), (20, 0.0), (20, 0.0), (5, FIRST_SHARE)] {
            controller.learn(target, Duration::from_millis(total), Duration::ZERO, controller.share());
            assert_eq!(controller.share(), share);
        }
        // Frames that nobody waits for teach nothing.
        let before = controller.share();
        controller.learn_frame(Refine::FrameTime(target), &StageTimes::default(), 0.0);
        assert_eq!(controller.share(), before);
    }

    #[test]
    fn a_single_block_that_was_slow_does_not_end_all_blocks() {
        let mut controller = ShareController::default();
        let target = Duration::from_millis(10);
        // A stall of a second while one block of two thousand was made.
        controller.learn(target, Duration::from_millis(1005), Duration::from_millis(1000), 0.0005);
        assert!(controller.share() < 1e-5);
        for _ in 0..12 {
            controller.learn(target, Duration::from_millis(5), Duration::ZERO, 0.0);
        }
        assert!(controller.share() > 0.0005, "{}", controller.share());
    }
}
