//! Why inputs cannot be compared.

/// Why a metric has no value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
    /// Two inputs that belong together differ in size.
    #[error("{what}: expected {}x{} pixels, found {}x{}", .expected.0, .expected.1, .actual.0, .actual.1)]
    Size {
        /// The input with the wrong size.
        what: &'static str,
        /// Expected width and height.
        expected: (usize, usize),
        /// Actual width and height.
        actual: (usize, usize),
    },
    /// The images are too small for the metric.
    #[error("{metric}: expected images of at least {min}x{min} pixels, found {}x{}", .actual.0, .actual.1)]
    TooSmall {
        /// The metric.
        metric: &'static str,
        /// Smallest side that the metric accepts.
        min: usize,
        /// Actual width and height.
        actual: (usize, usize),
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
