//! Where frames go: PNG files that are always whole, and a video.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gs3::scene::Image;
use gs3::scene::format::write_atomically;
use rayon::prelude::*;

use crate::error::CliError;
use crate::video::Video;

/// What `--out` asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// One PNG file.
    Single(PathBuf),
    /// A folder of PNG files.
    Folder(PathBuf),
    /// A video, and its frames in a folder beside it.
    Video { file: PathBuf, frames: PathBuf },
}

impl Target {
    pub fn of(out: &Path) -> Self {
        let extension = out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        match extension.as_deref() {
            Some("png") => Self::Single(out.into()),
            Some("mp4") => Self::Video { file: out.into(), frames: out.with_extension("") },
            _ => Self::Folder(out.into()),
        }
    }

    /// The folder of the frames, made if it is not there; so that an unwritable output is known before the work.
    fn prepare(&self) -> Result<&Path, CliError> {
        let folder = match self {
            Self::Single(file) => file.parent().unwrap_or(Path::new("")),
            Self::Folder(frames) | Self::Video { frames, .. } => frames,
        };
        if !folder.as_os_str().is_empty() {
            fs::create_dir_all(folder).map_err(CliError::write(folder))?;
        }
        Ok(folder)
    }
}

/// Writes frames in order. Encoding never overlaps rendering, so neither slows the other's figures: frames are collected
/// until there is one for every thread, and then encoded by all threads at once.
pub struct FrameWriter {
    target: Target,
    video: Option<Video>,
    /// Frames to be encoded: file, pixels.
    batch: Vec<(PathBuf, Rgb8)>,
    written: usize,
    encode_time: Duration,
}

/// An 8-bit RGB image.
struct Rgb8 {
    width: u32,
    height: u32,
    bytes: Vec<u8>,
}

impl FrameWriter {
    /// A writer to `target` of frames of `size` at `frames_per_second`.
    pub fn new(target: Target, size: [u32; 2], frames_per_second: f64) -> Result<Self, CliError> {
        target.prepare()?;
        let video = match &target {
            Target::Video { file, frames } => Video::start(file, frames, size, frames_per_second)?,
            Target::Single(_) | Target::Folder(_) => None,
        };
        Ok(Self { target, video, batch: Vec::new(), written: 0, encode_time: Duration::ZERO })
    }

    /// Takes the frame with the number `number` among all displayed ones.
    pub fn write(&mut self, number: usize, image: &Image) -> Result<(), CliError> {
        let started = Instant::now();
        let file = match &self.target {
            Target::Single(file) => file.clone(),
            Target::Folder(frames) | Target::Video { frames, .. } => {
                frames.join(format!("frame_{number:06}.png"))
            }
        };
        self.batch.push((file, rgb8(image)));
        if self.batch.len() >= rayon::current_num_threads() {
            self.flush()?;
        }
        self.encode_time += started.elapsed();
        Ok(())
    }

    /// Encodes what is left and ends the video, keeping it only if `is_complete`. Gives the number of frames written and
    /// the time that encoding took.
    pub fn finish(mut self, is_complete: bool) -> Result<(usize, Duration), CliError> {
        let started = Instant::now();
        self.flush()?;
        if let Some(video) = self.video.take() {
            if is_complete { video.finish()? } else { video.abandon() }
        }
        Ok((self.written, self.encode_time + started.elapsed()))
    }

    fn flush(&mut self) -> Result<(), CliError> {
        self.batch.par_iter().try_for_each(|(file, image)| {
            write_atomically(file, |writer| encode_png(image, writer)).map_err(CliError::write(file))
        })?;
        self.written += self.batch.len();
        for (_, image) in self.batch.drain(..) {
            if let Some(video) = &mut self.video {
                video.write(&image.bytes)?;
            }
        }
        Ok(())
    }
}

/// Writes one image as a PNG file.
pub fn write_png(file: &Path, image: &Image) -> Result<(), CliError> {
    Target::Single(file.into()).prepare()?;
    write_atomically(file, |writer| encode_png(&rgb8(image), writer)).map_err(CliError::write(file))
}

/// Writes text as a file, whole or not at all.
pub fn write_text(file: &Path, text: &str) -> Result<(), CliError> {
    Target::Single(file.into()).prepare()?;
    write_atomically(file, |writer| writer.write_all(text.as_bytes())).map_err(CliError::write(file))
}

fn rgb8(image: &Image) -> Rgb8 {
    // Image sides come from cameras, which are at most 8192.
    Rgb8 { width: image.width() as u32, height: image.height() as u32, bytes: image.to_rgb8() }
}

fn encode_png(image: &Rgb8, writer: impl Write) -> io::Result<()> {
    let mut encoder = png::Encoder::new(writer, image.width, image.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&image.bytes)?;
    Ok(writer.finish()?)
}
