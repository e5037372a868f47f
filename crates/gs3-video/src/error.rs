//! Why there is no video.

/// Why frames do not become a video.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// A frame has the wrong number of bytes for its size.
    #[error("frame: expected {expected} bytes, 3 for each of {}x{} pixels, found {actual}", .size[0], .size[1])]
    Bytes {
        /// Width and height in pixels.
        size: [u32; 2],
        /// Bytes of such a frame.
        expected: u64,
        /// Bytes found.
        actual: usize,
    },
    /// A frame has another size than the video.
    #[error("frame: expected {}x{} pixels as in the frames before, found {}x{}", .expected[0], .expected[1], .actual[0], .actual[1])]
    FrameSize {
        /// Width and height of the video in pixels.
        expected: [u32; 2],
        /// Width and height of the frame.
        actual: [u32; 2],
    },
    /// No H.264 stream may have this size.
    #[error("video: expected 1 to 16384 pixels a side and at most 35651584 in all, found {}x{}", .actual[0], .actual[1])]
    Size {
        /// Width and height in pixels.
        actual: [u32; 2],
    },
    /// The frame rate is none.
    #[error("frame rate: expected more than 0 and at most 1000 frames per second, found {actual}")]
    Rate {
        /// The rate found.
        actual: f64,
    },
    /// The encoder failed.
    #[error("H.264: {0}")]
    Encode(String),
    /// The file cannot be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
