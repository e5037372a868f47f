//! The scale of frames: high-resolution over low-resolution size, on each axis.

use std::fmt;
use std::str::FromStr;

use gs3_reconstruct::MAX_SCALE;
use gs3_scene::Size;

use crate::learned::Networks;

/// High-resolution over low-resolution size, on each axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Follows the size of each frame: 4 up to [`Scale::MOST_PIXELS_AT_4`] pixels, 6 above. With networks it is the
    /// networks' scale ([`Scale::with`]).
    #[default]
    Auto,
    /// The same for frames of all sizes, 1 to [`MAX_SCALE`].
    Fixed(u32),
}

impl Scale {
    /// The scale of shipped networks of all tiers, and of [`Scale::Auto`] for frames up to [`Self::MOST_PIXELS_AT_4`].
    pub const SMALL: u32 = 4;

    /// The scale of [`Scale::Auto`] for larger frames. `docs/performance.md` compares the speed of both scales at 4096×2160.
    pub const LARGE: u32 = 6;

    /// Most pixels of a frame that [`Scale::Auto`] renders at scale 4. At 4096×2160 scale 6 is 1.19 to 1.26 times as fast. Its PSNR is within
    /// 1.5 dB of 1920×1080 at scale 4 (three paths; `docs/performance.md`, `docs/results.md`).
    pub const MOST_PIXELS_AT_4: u64 = 2560 * 1440;

    /// The scale of frames that `networks` refine: [`Scale::Auto`] is the networks' scale.
    #[must_use]
    pub fn with(self, networks: &Networks) -> Self {
        let weights = networks.super_sample.as_ref().or(networks.interpolate.as_ref());
        match (self, weights) {
            (Self::Auto, Some(weights)) => Self::Fixed(weights.header.scale),
            (scale, _) => scale,
        }
    }

    /// The scale of frames of `size`.
    #[must_use]
    pub const fn at(self, size: Size) -> u32 {
        match self {
            Self::Fixed(scale) => scale,
            Self::Auto if size.width as u64 * size.height as u64 > Self::MOST_PIXELS_AT_4 => Self::LARGE,
            Self::Auto => Self::SMALL,
        }
    }

    /// The largest scale of frames of any size.
    #[must_use]
    pub const fn largest(self) -> u32 {
        match self {
            Self::Fixed(scale) => scale,
            Self::Auto => Self::LARGE,
        }
    }

    /// The scale of networks for these frames: [`Scale::Auto`] takes networks of scale 4, which come in all tiers.
    #[must_use]
    pub const fn of_networks(self) -> u32 {
        match self {
            Self::Fixed(scale) => scale,
            Self::Auto => Self::SMALL,
        }
    }
}

/// `auto`, or the number.
impl fmt::Display for Scale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Fixed(scale) => write!(f, "{scale}"),
        }
    }
}

/// The text that is no [`Scale`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected auto or 1 to {MAX_SCALE}, found {actual}")]
pub struct ScaleError {
    /// The text found.
    pub actual: String,
}

/// Reads the text that [`Scale`] prints.
impl FromStr for Scale {
    type Err = ScaleError;

    fn from_str(text: &str) -> Result<Self, ScaleError> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        match text.parse() {
            Ok(scale) if (1..=MAX_SCALE).contains(&scale) => Ok(Self::Fixed(scale)),
            _ => Err(ScaleError { actual: text.to_owned() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_frames_are_rendered_coarser() {
        for (width, height, expected) in
            [(1, 1, 4), (1920, 1080, 4), (2560, 1440, 4), (2561, 1440, 6), (1440, 2561, 6), (4096, 2160, 6)]
        {
            let size = Size::new(width, height);
            assert_eq!(Scale::Auto.at(size), expected, "{size}");
            assert_eq!(Scale::Fixed(3).at(size), 3);
            assert!(Scale::Auto.at(size) <= Scale::Auto.largest());
        }
    }

    #[test]
    fn texts_are_read_back_and_others_refused() {
        for scale in [Scale::Auto, Scale::Fixed(1), Scale::Fixed(MAX_SCALE)] {
            assert_eq!(scale.to_string().parse(), Ok(scale));
        }
        for text in ["", "0", "9", "4.5", "-4", "Auto", "x4"] {
            let error = text.parse::<Scale>().unwrap_err();
            assert_eq!(error.to_string(), format!("expected auto or 1 to 8, found {text}"));
        }
    }
}
