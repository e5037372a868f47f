//! Frames in, a file out.

use std::io::{Seek, Write};

use crate::{Encoder, Mp4, Picture, Track, VideoError};

/// Writes a video frame by frame. What it writes is whole only after [`Self::finish`].
#[derive(Debug)]
pub struct VideoWriter<W> {
    size: [u32; 2],
    encoder: Encoder,
    file: Mp4<W>,
}

impl<W: Write + Seek> VideoWriter<W> {
    /// Begins a video of `size` (width and height in pixels) at `rate` frames per second, with room at its beginning for
    /// the index of `frames` frames. Where a side is odd the last column or row is shown twice.
    ///
    /// # Errors
    /// [`VideoError::Size`] and [`VideoError::Rate`] for what a video cannot be, and what writing reports.
    pub fn new(out: W, size: [u32; 2], rate: f64, frames: usize) -> Result<Self, VideoError> {
        let even = size.map(|side| (side as usize).next_multiple_of(2));
        let encoder = Encoder::new(even, rate)?;
        let track = Track { size: even, rate, key_interval: encoder.key_interval() };
        Ok(Self { size, encoder, file: Mp4::new(out, track, frames)? })
    }

    /// Adds a frame: its display-encoded 8-bit RGB pixels, row by row.
    ///
    /// # Errors
    /// [`VideoError`] for a frame of another size, and what encoding or writing reports.
    pub fn write(&mut self, rgb: &[u8]) -> Result<(), VideoError> {
        let unit = self.encoder.encode(&Picture::from_rgb8(self.size, rgb)?)?;
        self.file.write(&unit)
    }

    /// Ends the video and gives back what it was written to.
    ///
    /// # Errors
    /// [`VideoError::Encode`] if there was no frame, and what writing reports.
    pub fn finish(self) -> Result<W, VideoError> {
        let none = || VideoError::Encode("expected at least one frame, found none".to_owned());
        let parameters = self.encoder.parameters().ok_or_else(none)?;
        self.file.finish(parameters)
    }
}
