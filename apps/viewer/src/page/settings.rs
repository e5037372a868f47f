//! What a page asks for when it begins.

use gs3::scene::Size;
use gs3::{Backend, Networks};
use gs3::{Mode, PipelineSettings, Quality, Refine, Scale, SessionSettings};
use serde::Deserialize;
use std::time::Duration;

use crate::viewer::ViewerSettings;

/// Settings of a page, as JSON: each field may be missing.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PageSettings {
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Displayed frames per second that are aimed at, 1 to 1000.
    pub fps: f64,
    /// High-resolution over low-resolution size, 1 to 8. Without it the size of the picture says ([`Scale::Auto`]).
    pub scale: Option<u32>,
    /// `fast`, `balanced` or `high`: exact pixels by the error that may be seen. Without it they are as many as the frame rate
    /// leaves time for.
    pub quality: Option<String>,
    /// `auto`, `gpu` or `cpu`. `auto` takes a GPU that the browser offers, if it is none in software.
    pub backend: Option<String>,
    /// Gaussians of a streamed scene at most, at the levels that leave the least error. Without it its finest levels are shown.
    pub budget: Option<u64>,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self { width: 640, height: 360, fps: 30.0, scale: None, quality: None, backend: None, budget: None }
    }
}

/// What no page can ask for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("settings: {message}")]
pub struct PageSettingsError {
    message: String,
}

impl PageSettings {
    /// Reads `json`.
    ///
    /// # Errors
    /// [`PageSettingsError`] with what was expected and what was found.
    pub fn parse(json: &str) -> Result<Self, PageSettingsError> {
        serde_json::from_str(json).map_err(|e| PageSettingsError { message: e.to_string() })
    }

    /// The settings of the viewer.
    ///
    /// # Errors
    /// [`PageSettingsError`] if the quality or the backend has no such name, or the frame rate is none.
    pub fn viewer(&self) -> Result<ViewerSettings, PageSettingsError> {
        let error = |message: String| PageSettingsError { message };
        if !(1.0..=1000.0).contains(&self.fps) {
            return Err(error(format!("fps: expected 1 to 1000, found {}", self.fps)));
        }
        let mut pipeline = PipelineSettings {
            mode: Mode::SuperSample,
            scale: self.scale.map_or(Scale::Auto, Scale::Fixed),
            refine: Refine::FrameTime(Duration::from_secs_f64(1.0 / self.fps)),
            ..PipelineSettings::default()
        };
        if let Some(name) = &self.quality {
            pipeline.quality = Quality::ALL
                .into_iter()
                .find(|quality| quality.name() == name)
                .ok_or_else(|| error(format!("quality: expected fast, balanced or high, found {name:?}")))?;
            pipeline.refine = Refine::Auto;
        }
        let backend = self.backend.as_deref().unwrap_or(Backend::Auto.name());
        let backend = backend.parse().map_err(|e| error(format!("backend: {e}")))?;
        let session = SessionSettings {
            pipeline,
            networks: Networks::default(),
            backend,
            ..SessionSettings::default()
        };
        let size = Size::new(self.width, self.height);
        Ok(ViewerSettings { session, native_when_fast: true, waker: None, fps: self.fps, size })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_and_refused() {
        let settings = PageSettings::parse(r#"{"width": 320, "height": 200, "quality": "high"}"#).unwrap();
        let viewer = settings.viewer().unwrap();
        assert_eq!((viewer.size, viewer.fps), (Size::new(320, 200), 30.0));
        assert_eq!(viewer.session.pipeline.quality, Quality::High);
        assert_eq!(viewer.session.pipeline.refine, Refine::Auto);
        let plain = PageSettings::parse("{}").unwrap().viewer().unwrap();
        assert!(matches!(plain.session.pipeline.refine, Refine::FrameTime(_)));
        assert_eq!(plain.session.pipeline.scale, Scale::Auto);
        let half = PageSettings::parse(r#"{"scale": 2}"#).unwrap().viewer().unwrap();
        assert_eq!(half.session.pipeline.scale, Scale::Fixed(2));
        let refused = |json: &str| match PageSettings::parse(json).and_then(|settings| settings.viewer()) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("{json} is taken"),
        };
        assert!(refused(r#"{"size": 3}"#).contains("unknown field `size`, expected one of `width`"));
        assert_eq!(
            refused(r#"{"quality": "best"}"#),
            "settings: quality: expected fast, balanced or high, found \"best\""
        );
        assert_eq!(plain.session.backend, Backend::Auto);
        let gpu = PageSettings::parse(r#"{"backend": "gpu"}"#).unwrap().viewer().unwrap();
        assert_eq!(gpu.session.backend, Backend::Gpu);
        assert_eq!(
            refused(r#"{"backend": "cuda"}"#),
            "settings: backend: expected auto, cpu or gpu, found \"cuda\""
        );
        assert_eq!(refused(r#"{"fps": 0}"#), "settings: fps: expected 1 to 1000, found 0");
    }
}
