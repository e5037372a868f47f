//! Videos of rendered frames, without another program: 8-bit RGB frames in, an MP4 file with H.264 out, which browsers,
//! players and editors open.
//!
//! [`Picture`] converts colours, [`Encoder`] compresses, [`Mp4`] is the file; [`VideoWriter`] is the three in a row.
//! Colours are BT.709 with limited range, as all players expect of such files, and the file says so twice: in
//! the video stream and in the box `colr` beside it, each with primaries, transfer, matrix and range.

mod error;
mod h264;
mod mp4;
mod picture;
mod writer;

pub use error::VideoError;
pub use h264::{AccessUnit, Encoder};
pub use mp4::{Mp4, Track};
pub use picture::Picture;
pub use writer::VideoWriter;
