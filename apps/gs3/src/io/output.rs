//! Where frames go: PNG files that are always whole, files in numbers, and a video.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf, is_separator};
use std::time::{Duration, Instant};

use gs3::scene::format::{SaveOptions, clamped, losses, position_step, save_with};
use gs3::scene::info::SceneInfo;
use gs3::scene::{Image, PngChannels, Scene, Size};
use gs3_files::write_atomically;
use rayon::prelude::*;

use super::alpha::straight_rgba8;
use super::destination::{Destination, has_extension};
use super::frame_files::{frame_name, name_with};
use super::layers::Layers;
use super::video::{Failure, Stream, Video};
use crate::cli::error::CliError;
use crate::cli::terminal::note;

/// What `--out` asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// One PNG file, or one EXR file ([`Target::is_exr`]).
    Single(PathBuf),
    /// A folder of PNG files.
    Folder(PathBuf),
    /// A video, and its frames in a folder beside it.
    Video { file: PathBuf, frames: PathBuf },
}

impl Target {
    /// By the extension of `out`. A name with an extension means a folder if the folder is there, or the name ends in a separator.
    pub fn of(out: &Path) -> Result<Self, CliError> {
        if out.to_string_lossy().ends_with(is_separator) {
            return Ok(Self::Folder(out.into()));
        }
        match out.extension() {
            Some(_) if has_extension(out, "png") || has_extension(out, EXR) => Ok(Self::Single(out.into())),
            Some(_) if has_extension(out, "mp4") => {
                Ok(Self::Video { file: out.into(), frames: out.with_extension("") })
            }
            Some(_) if !out.is_dir() => Err(CliError::Option {
                option: "--out",
                expected: "DIR, FILE.png, FILE.exr or FILE.mp4 (DIR/ if its name has a dot)".to_owned(),
                actual: out.display().to_string(),
            }),
            _ => Ok(Self::Folder(out.into())),
        }
    }

    /// The folder of frames, if there is one.
    pub fn folder(&self) -> Option<&Path> {
        match self {
            Self::Single(_) => None,
            Self::Folder(folder) | Self::Video { frames: folder, .. } => Some(folder),
        }
    }

    /// Whether the frame is written in numbers alone.
    pub fn is_exr(&self) -> bool {
        matches!(self, Self::Single(file) if has_extension(file, EXR))
    }

    /// The file of the picture of the frame with this number.
    pub fn picture(&self, number: usize) -> PathBuf {
        match self {
            Self::Single(file) => file.clone(),
            Self::Folder(frames) | Self::Video { frames, .. } => frames.join(frame_name(number)),
        }
    }

    /// The file that belongs to the frame with this number, in a format of files with this `extension`.
    pub fn file(&self, number: usize, extension: &str) -> PathBuf {
        match self {
            Self::Single(file) => file.with_extension(extension),
            Self::Folder(frames) | Self::Video { frames, .. } => frames.join(name_with(number, extension)),
        }
    }

    /// What is written.
    pub fn destinations(&self) -> Vec<Destination<'_>> {
        match self {
            Self::Single(file) => {
                vec![Destination::file("--out", file, if self.is_exr() { EXR } else { "png" })]
            }
            Self::Folder(folder) => vec![Destination::frames("--out", folder)],
            Self::Video { file, frames } => {
                vec![Destination::video("--out", file), Destination::frames("--out, its frames", frames)]
            }
        }
    }

    /// The folder of the frames, made if it is not there; so that an unwritable output is known before the work.
    pub fn prepare(&self) -> Result<(), CliError> {
        match self {
            Self::Single(file) => make_folder_of(file),
            Self::Folder(frames) | Self::Video { frames, .. } => {
                fs::create_dir_all(frames).map_err(CliError::write(frames))
            }
        }
    }
}

/// The extension of OpenEXR files.
const EXR: &str = "exr";

/// Most frames that are held to be encoded at once, however many threads there are: one takes 3 B a pixel, and 2 more
/// while it is compressed. Eight are 40 B of the 250 B a pixel that a command may take beside its scene
/// (docs/performance.md, Memory).
const MOST_HELD: usize = 8;

/// Writes frames in order. Encoding never overlaps rendering, so neither slows the other's figures: frames are
/// collected until there is one for every thread, or as many as may be held, and then encoded by all threads at once.
pub struct FrameWriter {
    target: Target,
    /// Where one was asked for; if it fails, frames go on.
    video: Option<Result<Video, Failure>>,
    /// Frames to be encoded: file, pixels.
    batch: Vec<(PathBuf, Pixels)>,
    written: Written,
}

/// What a [`FrameWriter`] has written.
#[derive(Debug, Default)]
pub struct Written {
    pub frames: usize,
    pub encode_time: Duration,
    /// Why the video that was asked for is not there.
    pub no_video: Option<Failure>,
}

/// An 8-bit image.
struct Pixels {
    size: Size,
    channels: PngChannels,
    bytes: Vec<u8>,
}

impl FrameWriter {
    /// A writer to `target` of the frames of `stream`.
    pub fn new(target: Target, stream: &Stream) -> Result<Self, CliError> {
        target.prepare()?;
        let video = match &target {
            Target::Video { file, .. } => Some(Video::start(file, stream)),
            Target::Single(_) | Target::Folder(_) => None,
        };
        Ok(Self { target, video, batch: Vec::new(), written: Written::default() })
    }

    /// Takes the frame with the number `number` among all displayed ones, and its `coverage`, if it is to be transparent
    /// where nothing is. Its `layers`, if there are any, are written at once, before its picture.
    pub fn write(
        &mut self,
        number: usize,
        image: &Image,
        coverage: Option<&Image>,
        layers: Option<&Layers>,
    ) -> Result<(), CliError> {
        let started = Instant::now();
        if let Some(layers) = layers {
            let file = match self.target.is_exr() {
                true => self.target.picture(number),
                false => self.target.file(number, layers.format.name()),
            };
            layers.write(&file)?;
        }
        if self.target.is_exr() {
            self.written.frames += 1;
            self.written.encode_time += started.elapsed();
            return Ok(());
        }
        let file = self.target.picture(number);
        let pixels = match coverage {
            None => rgb8(image),
            Some(coverage) => {
                let bytes = straight_rgba8(image, coverage);
                Pixels { bytes, channels: PngChannels::Rgba, ..blank_like(image) }
            }
        };
        self.batch.push((file, pixels));
        if self.batch.len() >= rayon::current_num_threads().min(MOST_HELD) {
            self.flush()?;
        }
        self.written.encode_time += started.elapsed();
        Ok(())
    }

    /// Encodes what is left and ends the video, keeping it only if `is_complete`.
    pub fn finish(mut self, is_complete: bool) -> Result<Written, CliError> {
        let started = Instant::now();
        if !is_complete {
            self.video = None;
        }
        self.flush()?;
        let video = self.video.map(|video| video.and_then(Video::finish));
        let encode_time = self.written.encode_time + started.elapsed();
        Ok(Written { encode_time, no_video: video.and_then(Result::err), ..self.written })
    }

    fn flush(&mut self) -> Result<(), CliError> {
        let (batch, video) = (&self.batch, &mut self.video);
        // A video takes one frame after the other, so that its encoder uses a core at most.
        let (images, ()) = rayon::join(
            || {
                batch.par_iter().try_for_each(|(file, image)| {
                    write_atomically(file, |writer| encode_png(image, writer)).map_err(CliError::write(file))
                })
            },
            || {
                for (_, image) in batch {
                    if let Some(Ok(encoder)) = video
                        && let Err(error) = encoder.write(&image.bytes)
                    {
                        *video = Some(Err(error));
                    }
                }
            },
        );
        images?;
        self.written.frames += self.batch.len();
        self.batch.clear();
        Ok(())
    }
}

/// Writes one image as a PNG file.
pub fn write_png(file: &Path, image: &Image) -> Result<(), CliError> {
    write_file(file, |writer| encode_png(&rgb8(image), writer))
}

/// Writes text as a file, whole or not at all.
pub fn write_text(file: &Path, text: &str) -> Result<(), CliError> {
    write_file(file, |writer| writer.write_all(text.as_bytes()))
}

/// Writes a scene in the format that the extension names, and says so if its Gaussians are moved visibly by that.
pub fn save_scene(scene: &Scene, file: &Path, options: &SaveOptions) -> Result<(), CliError> {
    make_folder_of(file)?;
    save_with(scene, file, options)?;
    for lost in losses(scene, file) {
        note(format_args!("{}: {lost}", file.display()));
    }
    if let Some(lost) = clamped(scene, file, options) {
        note(format_args!("{}: {lost}", file.display()));
    }
    if let Some(step) = position_step(scene, file) {
        let info = SceneInfo::of(scene);
        // Rounded, positions are off by up to half a step.
        let usual = info.largest_scale.p50;
        if step > usual {
            let far = info.bounds.min.iter().chain(&info.bounds.max).fold(0.0_f32, |far, v| far.max(v.abs()));
            note(format_args!(
                "{}: positions are rounded to steps of {step:.2e}, as one Gaussian is {far:.2e} from the origin; half of all \
                 Gaussians are smaller than {usual:.2e} (a PLY keeps them exactly)",
                file.display()
            ));
        }
    }
    Ok(())
}

/// Writes a file through `write`, whole or not at all, in a folder that is made if it is not there.
pub fn write_file(
    file: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), CliError> {
    make_folder_of(file)?;
    write_atomically(file, write).map_err(CliError::write(file))
}

fn make_folder_of(file: &Path) -> Result<(), CliError> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => {
            fs::create_dir_all(folder).map_err(CliError::write(folder))
        }
        _ => Ok(()),
    }
}

fn rgb8(image: &Image) -> Pixels {
    Pixels { bytes: image.to_rgb8(), ..blank_like(image) }
}

/// No RGB pixels for an image of the size of `image`.
fn blank_like(image: &Image) -> Pixels {
    Pixels { size: image.size(), channels: PngChannels::Rgb, bytes: Vec::new() }
}

fn encode_png(image: &Pixels, writer: impl Write) -> io::Result<()> {
    gs3::scene::write_png(writer, image.size, image.channels, &image.bytes)
}
