//! What a video is of, and why there is none.

use gs3::scene::Size;
use gs3_video::VideoError;

/// What the frames of a video are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stream {
    /// The frames' size.
    pub size: Size,
    /// Frames per second.
    pub rate: f64,
    /// About how many there are.
    pub frames: usize,
}

/// Why there is no video.
#[derive(Debug)]
pub struct Failure(pub(super) String);

impl From<VideoError> for Failure {
    fn from(error: VideoError) -> Self {
        Self(format!("the video cannot be written: {error}"))
    }
}
