//! What both halves are asked for.

/// Most LR frames in the history.
pub(crate) const MAX_PAST: usize = (crate::MAX_SCALE * crate::MAX_SCALE) as usize;

/// A pixel is kriged if the correction for curvature changes the pixel by more than this: three quarters of a step of 8
/// bits. (Empirical: `docs/performance.md`.)
const THRESHOLD: f32 = 0.003;

/// The same where time counts more than quality: one and a half steps. (Loses 0.15 to 0.42 dB and saves 6 to 25 ms a
/// pair of frames on two cores at 1920×1080; on foliage, 0.01 takes half the pixels that 0.004 does and loses 0.3
/// dB.)
const THRESHOLD_COARSE: f32 = 0.006;

/// The same where quality counts more than time: a quarter of a step. (Gains 0.1 dB over half a step, for 10 to 30 ms.)
const THRESHOLD_FINE: f32 = 0.001;

/// Which pixels are kriged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kriging {
    /// A pixel is the mean of what the samples around it predict to first order, by inverse variances.
    #[default]
    Off,
    /// Where that mean errs visibly, a pixel is the best linear prediction from the values and the gradients of the
    /// samples around it: gradient-enhanced kriging. Sharper in motion; takes longer, the more detail there is. Here
    /// only where the mean errs most.
    Coarse,
    /// The same where it errs by about a step of 8 bits: sharper, and slower.
    On,
    /// The same wherever it makes a difference at all: sharper yet, and slower.
    Fine,
}

impl Kriging {
    /// Its name at the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Coarse => "coarse",
            Self::On => "on",
            Self::Fine => "fine",
        }
    }

    /// By how much the correction for curvature must change a pixel, if any is kriged at all.
    pub(crate) const fn threshold(self) -> Option<f32> {
        match self {
            Self::Off => None,
            Self::Coarse => Some(THRESHOLD_COARSE),
            Self::On => Some(THRESHOLD),
            Self::Fine => Some(THRESHOLD_FINE),
        }
    }
}
