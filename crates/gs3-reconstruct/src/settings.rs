//! Settings that the CPU and the GPU share.

/// Most LR frames in the history.
pub(crate) const MAX_PAST: usize = (crate::MAX_SCALE * crate::MAX_SCALE) as usize;

/// The history of a device has room for the exact blocks of one in so many blocks of the picture: four frames of balanced quality.
/// (On an H100 it gains 2.8 dB for 5 % more time: docs/performance.md.)
#[cfg(feature = "gpu")]
pub(crate) const PER_HISTORY: u32 = 4;

/// Most layers of exact blocks in the history of a device. A layer of the largest scale is as large as an LR frame.
#[cfg(feature = "gpu")]
pub(crate) const MAX_LAYERS: usize = MAX_PAST / PER_HISTORY as usize;

/// A pixel is kriged if the correction for curvature changes it by more than this: three quarters of a step of 8
/// bits. (Empirical: `docs/performance.md`.)
const THRESHOLD: f32 = 0.003;

/// The threshold where time counts more than quality: one and a half steps. (It loses 0.15 to 0.42 dB and saves 6 to
/// 25 ms a pair of frames on two cores at 1920×1080. On foliage, 0.01 kriges half as many pixels as 0.004 and loses
/// 0.3 dB.)
const THRESHOLD_COARSE: f32 = 0.006;

/// The threshold where quality counts more than time: a quarter of a step. (It gains 0.1 dB over half a step, for 10
/// to 30 ms.)
const THRESHOLD_FINE: f32 = 0.001;

/// Which pixels are kriged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kriging {
    /// None. A pixel is the mean of the first-order predictions of the samples around it, weighted by inverse
    /// variances.
    #[default]
    Off,
    /// A pixel with a visible error of this mean is kriged instead: it becomes the best linear prediction from the
    /// values and gradients of the samples around it (gradient-enhanced kriging). Kriged pixels are sharper in
    /// motion. Kriging takes longer, the more detail there is. Here only the pixels with the largest errors are
    /// kriged.
    Coarse,
    /// Pixels with an error of about a step of 8 bits are kriged: sharper, and slower.
    On,
    /// All pixels that kriging changes noticeably are kriged: sharper yet, and slower.
    Fine,
}

impl Kriging {
    /// The name in the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Coarse => "coarse",
            Self::On => "on",
            Self::Fine => "fine",
        }
    }

    /// The change of a pixel by the correction for curvature from which on the pixel is kriged; none if no pixel is
    /// kriged.
    pub(crate) const fn threshold(self) -> Option<f32> {
        match self {
            Self::Off => None,
            Self::Coarse => Some(THRESHOLD_COARSE),
            Self::On => Some(THRESHOLD),
            Self::Fine => Some(THRESHOLD_FINE),
        }
    }
}
