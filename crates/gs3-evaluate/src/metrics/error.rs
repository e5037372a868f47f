//! Why inputs cannot be compared.

use gs3_scene::Size;

/// Why a metric has no value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
    /// Two inputs that belong together differ in size.
    #[error("{what}: expected {expected} pixels, found {actual}")]
    Size {
        /// The input with the wrong size.
        what: &'static str,
        /// The size expected.
        expected: Size,
        /// The size found.
        actual: Size,
    },
    /// The images are too small for the metric.
    #[error("{metric}: expected images of at least {min}x{min} pixels, found {actual}")]
    TooSmall {
        /// The metric.
        metric: &'static str,
        /// Smallest side that the metric accepts.
        min: usize,
        /// The size found.
        actual: Size,
    },
    /// Two sequences that belong together differ in length.
    #[error("{what}: expected {expected} frames, found {actual}")]
    FrameCount {
        /// The sequence with the wrong length.
        what: &'static str,
        /// Expected number of frames.
        expected: usize,
        /// Actual number of frames.
        actual: usize,
    },
    /// The perceptual video metric refused its input.
    #[error("ColorVideoVDP: {0}")]
    ColorVideoVdp(#[from] colorvideovdp::Error),
}
