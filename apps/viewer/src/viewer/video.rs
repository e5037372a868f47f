//! Videos: requested here, rendered by the surroundings.

use std::path::PathBuf;
use std::time::Duration;

use super::{Destination, Effect, Viewer};
use crate::video::{VideoPlan, VideoPlanError, VideoWish};

impl Viewer {
    /// States that the surroundings carry out [`Effect::Video`]: the panels then offer videos.
    pub const fn offer_videos(&mut self) {
        self.has_videos = true;
    }

    /// Requests a video of the keyframes' path, or shows why there cannot be one.
    pub fn make_video(&mut self, wish: VideoWish) {
        (self.is_woken, self.is_idle) = (true, false);
        match self.plan_video(&wish) {
            Ok(plan) => {
                let numbered = Destination::Numbered { stem: "gs3", extension: "mp4" };
                self.video = Some(0.0);
                self.effects
                    .push(Effect::Video(wish.file.map_or(numbered, Destination::File), Box::new(plan)));
            }
            Err(error) => self.message = Some(error.to_string()),
        }
    }

    fn plan_video(&self, wish: &VideoWish) -> Result<VideoPlan, VideoPlanError> {
        if let Some(share) = self.video {
            return Err(VideoPlanError::UnderWay { share });
        }
        let way = self.tour.way().ok_or(VideoPlanError::Keys { actual: self.tour.keys() })?;
        VideoPlan::new(way, wish, self.size, &self.settings.pipeline)
    }

    /// Requests that the video under way ends without a file.
    pub fn stop_video(&mut self) {
        if self.video.is_some() {
            self.effects.push(Effect::StopVideo);
            (self.is_woken, self.is_idle) = (true, false);
        }
    }

    /// The share of the video under way that is done, `[0, 1]`.
    #[must_use]
    pub const fn video(&self) -> Option<f32> {
        self.video
    }

    /// Reports the share of the video under way that is done, `[0, 1]`.
    pub fn video_progress(&mut self, share: f32) {
        if let Some(done) = &mut self.video {
            *done = share;
            self.is_woken = true;
        }
    }

    /// Shows a notice for a while.
    pub fn notify(&mut self, notice: String, now: Duration) {
        self.tell(notice, now);
    }

    /// Reports that the video under way is written, that it was stopped (`None`), or why there is none.
    pub fn video_ended(&mut self, ended: Result<Option<PathBuf>, String>, now: Duration) {
        (self.video, self.is_woken, self.is_idle) = (None, true, false);
        match ended {
            Ok(Some(file)) => self.tell(format!("written: {}", file.display()), now),
            Ok(None) => self.tell("the video is cancelled; no file is written".to_owned(), now),
            Err(message) => self.message = Some(message),
        }
    }
}
