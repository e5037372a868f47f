//! Videos: through the `ffmpeg` on PATH, which makes smaller files, or by an encoder of our own where there is none. Both
//! get the same pictures.

mod ffmpeg;
mod stream;

use std::ops::Range;
use std::path::Path;

use gs3_files::AtomicFile;
use gs3_video::{VideoError, VideoWriter};

use ffmpeg::Ffmpeg;
pub use stream::{Failure, Stream};

use crate::cli::error::CliError;
use crate::cli::terminal::note;
pub use ffmpeg::{by_hand, no_option, quoted};

/// A video in the making. Its file appears under its name when it is whole; dropped before, it leaves nothing.
pub enum Video {
    Ffmpeg(Ffmpeg),
    Own(Box<VideoWriter<AtomicFile>>),
}

impl Video {
    /// Begins the video `file`. Without an `ffmpeg`, gs3 encodes the video itself, and reports it. An `ffmpeg` that
    /// fails is an error, because its owner expects it to work.
    pub fn start(file: &Path, stream: &Stream) -> Result<Self, Failure> {
        if let Some(ffmpeg) = Ffmpeg::start(file, stream)? {
            return Ok(Self::Ffmpeg(ffmpeg));
        }
        let out = AtomicFile::create(file).map_err(VideoError::from)?;
        let writer = VideoWriter::new(out, stream.size.to_array(), stream.rate, stream.frames)?;
        note(format_args!(
            "no ffmpeg on PATH: {} is encoded by gs3 itself, which makes larger files",
            file.display()
        ));
        Ok(Self::Own(Box::new(writer)))
    }

    /// Adds the next frame, RGB rows.
    pub fn write(&mut self, rgb: &[u8]) -> Result<(), Failure> {
        match self {
            Self::Ffmpeg(ffmpeg) => ffmpeg.write(rgb),
            Self::Own(writer) => Ok(writer.write(rgb)?),
        }
    }

    /// Waits for the video to be whole.
    pub fn finish(self) -> Result<(), Failure> {
        match self {
            Self::Ffmpeg(ffmpeg) => ffmpeg.finish(),
            Self::Own(writer) => Ok(writer.finish()?.commit().map_err(VideoError::from)?),
        }
    }
}

impl Failure {
    /// The error that says why `file` is not there, and how to make it of the frames of `stream` with these `numbers` in
    /// folder `frames`.
    pub fn tell(self, file: &Path, frames: &Path, numbers: &Range<usize>, stream: &Stream) -> CliError {
        let by_hand = by_hand(file, frames, numbers, stream);
        CliError::Video { path: file.into(), message: self.0, frames: frames.into(), by_hand }
    }
}
