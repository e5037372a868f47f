//! Videos of the keyframes' path: what a user asks for, and what is to be rendered for it.

use std::path::PathBuf;

use gs3::scene::camera_path::{CameraPathError, Pace};
use gs3::scene::{CameraError, CameraPath, Size};
use gs3::{Mode, PipelineSettings, Refine};

/// Rendered frames of a video at most, as `gs3 render --smooth` allows.
const MOST_FRAMES: u32 = 1_000_000;

/// Frames interpolated before each rendered one: a path of 30 cameras per second becomes 60 frames per second, the highest rate
/// that all players and web sites show.
const IN_BETWEEN: u32 = 1;

/// A request for a video of the keyframes' path.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VideoWish {
    /// The MP4 file; none is a numbered file.
    pub file: Option<PathBuf>,
    /// The video's size; none is the size of the viewer's picture.
    pub size: Option<Size>,
    /// Displayed frames per second; none is as many as the path has, times the frames shown for each rendered one.
    pub fps: Option<f64>,
    /// Rendered frames, spread evenly over the path's time; none is as many as keep the path's duration.
    pub frames: Option<u32>,
}

/// What is rendered for a video: a frame for each camera of a path, and the frames between.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoPlan {
    /// The cameras, all of the video's size.
    pub path: CameraPath,
    /// How the frames are made.
    pub settings: PipelineSettings,
    /// Displayed frames per second.
    pub rate: f64,
}

/// Why there is nothing to render.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum VideoPlanError {
    /// The keyframes make no path.
    #[error("video: expected at least 2 keyframes, found {actual}")]
    Keys {
        /// Keyframes found.
        actual: usize,
    },
    /// Another video is not finished.
    #[error("video: expected no other video under way, found one at {:.0} %", 100.0 * share)]
    UnderWay {
        /// The share of the other video that is done.
        share: f32,
    },
    /// The number of frames is none that can be rendered.
    #[error("video: expected 1 to {MOST_FRAMES} rendered frames, found {actual}")]
    Frames {
        /// The number found.
        actual: f64,
    },
    /// The frame rate is none.
    #[error("video: {0}")]
    Rate(#[from] CameraPathError),
    /// The size is none.
    #[error("video: {0}")]
    Size(#[from] CameraError),
}

impl VideoPlan {
    /// The video that `wish` asks for along `way`, at the size `shown` if the wish names none. Frames are made as
    /// `gs3 render --in-between 1` makes them: mode full, exact pixels by the quality in `settings`.
    ///
    /// # Errors
    /// [`VideoPlanError`] if the wish asks for a size, a rate or a number of frames that is none.
    pub fn new(
        way: &CameraPath,
        wish: &VideoWish,
        shown: Size,
        settings: &PipelineSettings,
    ) -> Result<Self, VideoPlanError> {
        let (refine, in_between) = (Refine::default(), IN_BETWEEN);
        let settings = PipelineSettings { mode: Mode::Full, refine, in_between, ..*settings };
        let each = settings.displayed_per_rendered() as f64;
        let rate = wish.fps.unwrap_or_else(|| way.frames_per_second() * each);
        let count = way.cameras().len();
        let frames = match (wish.frames, wish.fps) {
            (Some(frames), _) => f64::from(frames),
            (None, None) => count as f64,
            (None, Some(rate)) => {
                let last = usize::from(!way.is_cycle());
                let seconds = (count - last) as f64 / way.frames_per_second();
                (seconds * rate / each).round() + last as f64
            }
        };
        if !(1.0..=f64::from(MOST_FRAMES)).contains(&frames) {
            return Err(VideoPlanError::Frames { actual: frames });
        }
        let Size { width, height } = wish.size.unwrap_or(shown);
        let resized = way.resized(width, height)?;
        let frames = frames as usize;
        // A path keeps its own cameras: they are those of `gs3 render`, bit for bit.
        let spread = if frames == count { resized } else { resized.smoothed(frames, Pace::Keyframes) };
        let path = CameraPath::new(spread.cameras().to_vec(), rate / each, way.is_cycle())?;
        Ok(Self { path, settings, rate })
    }
}

#[cfg(test)]
mod tests {
    use gs3::scene::demo;

    use super::*;

    fn way(is_cycle: bool) -> CameraPath {
        CameraPath::new(demo::path().cameras()[..61].to_vec(), 30.0, is_cycle).unwrap()
    }

    fn plan(way: &CameraPath, wish: &VideoWish) -> Result<VideoPlan, VideoPlanError> {
        VideoPlan::new(way, wish, Size::new(64, 40), &PipelineSettings::default())
    }

    #[test]
    fn a_video_is_of_the_path_as_it_is_unless_more_is_asked_for() {
        let given = way(false);
        let plain = plan(&given, &VideoWish::default()).unwrap();
        assert_eq!(plain.path, given.resized(64, 40).unwrap());
        assert_eq!(
            (plain.rate, plain.settings.mode, plain.settings.refine),
            (60.0, Mode::Full, Refine::Auto)
        );
        let wish = VideoWish { size: Some(Size::new(32, 20)), fps: Some(24.0), ..VideoWish::default() };
        let slower = plan(&given, &wish).unwrap();
        // Two seconds: 24 steps of two displayed frames.
        assert_eq!(
            (slower.path.cameras().len(), slower.path.frames_per_second(), slower.rate),
            (25, 12.0, 24.0)
        );
        assert_eq!((slower.path.cameras()[0].width(), slower.path.cameras()[24].height()), (32, 20));
        let near = |a: usize, b: usize| {
            let (a, b) = (slower.path.cameras()[a].position(), given.cameras()[b].position());
            assert!(a.distance(b) < 1e-9, "{a} {b}");
        };
        near(0, 0);
        near(12, 30);
        near(24, 60);
        let wish = VideoWish { frames: Some(5), ..VideoWish::default() };
        assert_eq!(plan(&given, &wish).unwrap().path.cameras().len(), 5);
        // A cycle has a step more than an open path.
        let wish = VideoWish { fps: Some(60.0), ..VideoWish::default() };
        assert_eq!(plan(&way(true), &wish).unwrap().path.cameras().len(), 61);
    }

    #[test]
    fn what_cannot_be_rendered_is_told() {
        let refused = |wish: VideoWish| plan(&way(false), &wish).unwrap_err().to_string();
        let none = VideoWish::default();
        assert!(
            refused(VideoWish { frames: Some(0), ..none.clone() })
                .contains("1 to 1000000 rendered frames, found 0")
        );
        assert!(
            refused(VideoWish { fps: Some(1e9), ..none.clone() }).contains("1 to 1000000 rendered frames")
        );
        for fps in [0.0, -1.0, f64::NAN] {
            let wish = VideoWish { fps: Some(fps), frames: Some(3), ..none.clone() };
            assert!(refused(wish).contains("frames per second: expected a positive finite number"));
        }
        let error = refused(VideoWish { size: Some(Size::new(0, 40)), ..none });
        assert!(error.starts_with("video: ") && error.contains("found 0"), "{error}");
    }
}
