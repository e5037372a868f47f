//! `gs3 join`.

use std::fs::File;
use std::io::BufReader;
use std::ops::Range;
use std::path::Path;
use std::path::PathBuf;

use gs3::scene::Size;
use gs3::scene::camera::MAX_SIDE;
use indicatif::ProgressBar;

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::terminal::note;
use crate::cli::values::FrameRange;
use crate::io::destination::{self, Destination};
use crate::io::frame_files::{frame_name, frame_numbers};
use crate::io::inputs;
use crate::io::manifest::{self, Manifest};
use crate::io::video::{Stream, Video};

#[derive(Debug, clap::Args)]
pub struct JoinArgs {
    /// Folder of frames that gs3 render wrote
    pub frames: PathBuf,
    /// Numbers of the frames, the last one excluded [default: all of the path]
    #[arg(long = "frames", value_name = "A..B", allow_hyphen_values = true)]
    pub numbers: Option<FrameRange>,
    /// Video
    #[arg(long, value_name = "FILE.mp4")]
    pub out: PathBuf,
}

pub fn run(args: &JoinArgs) -> Result<Outcome, CliError> {
    destination::check(&[Destination::video("--out", &args.out)], [args.frames.as_path()])?;
    let folder = args.frames.as_path();
    let Some(facts) = Manifest::read(folder)? else {
        return Err(CliError::Manifest {
            path: folder.join(manifest::NAME),
            message: "expected the file that gs3 render writes beside its frames, found none".to_owned(),
        });
    };
    let (Some(count), Some(rate)) = (facts.frames(), facts.rate()) else {
        return Err(CliError::Manifest {
            path: folder.join(manifest::NAME),
            message: "expected frames and frames_per_second, found none".to_owned(),
        });
    };
    let numbers = args.numbers.as_ref().map_or(0..count, |numbers| numbers.0.clone());
    if numbers.end > count {
        return Err(CliError::Option {
            option: "--frames",
            expected: format!("frames within 0..{count}, as many as the path shows"),
            actual: format!("{}..{}", numbers.start, numbers.end),
        });
    }
    check_all_there(folder, &numbers)?;
    let (size, mut rgb) = read_frame(folder, numbers.start, None)?;
    let stream = Stream { size, rate, frames: numbers.len() };
    let failed = |failure: crate::io::video::Failure| failure.tell(&args.out, folder, &numbers, &stream);
    interrupt::watch()?;
    let mut video = Video::start(&args.out, &stream).map_err(failed)?;
    let bar = ProgressBar::new(numbers.len() as u64)
        .with_style(inputs::style("{pos}/{len} joined {wide_bar} {per_sec}, {eta} left"));
    for number in numbers.clone() {
        if interrupt::requested() {
            note("interrupted; there is no video");
            return Ok(Outcome::Interrupted);
        }
        if number > numbers.start {
            rgb = read_frame(folder, number, Some(size))?.1;
        }
        video.write(&rgb).map_err(failed)?;
        bar.inc(1);
    }
    video.finish().map_err(failed)?;
    bar.finish_and_clear();
    note(format_args!("{} frames in {}", numbers.len(), args.out.display()));
    Ok(Outcome::Done)
}

/// Refuses gaps: names the first, and how many frames are missing in all.
fn check_all_there(folder: &Path, numbers: &Range<usize>) -> Result<(), CliError> {
    let there: std::collections::BTreeSet<usize> = frame_numbers(folder).collect();
    let missing: Vec<usize> = numbers.clone().filter(|number| !there.contains(number)).collect();
    let Some(first) = missing.first() else { return Ok(()) };
    let last = missing.iter().zip(*first..).take_while(|(number, k)| *number == k).count() + first - 1;
    let found = match missing.len() {
        count if last - first + 1 == count => format!("none of {first} to {last}"),
        count => format!("none of {first} to {last}, and {count} missing in all"),
    };
    Err(CliError::Option {
        option: "DIR",
        expected: format!(
            "all frames from {} to {} (gs3 render --skip-existing makes those that are missing; --frames A..B joins some)",
            numbers.start,
            numbers.end - 1
        ),
        actual: found,
    })
}

/// Size and RGB rows of frame `number`, of `size` if that is known.
fn read_frame(folder: &Path, number: usize, size: Option<Size>) -> Result<(Size, Vec<u8>), CliError> {
    let file = folder.join(frame_name(number));
    let wrong = |message: String| CliError::Manifest { path: file.clone(), message };
    let opened = File::open(&file).map_err(|source| CliError::Read { path: file.clone(), source })?;
    let mut decoder = png::Decoder::new(BufReader::new(opened));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(|error| wrong(format!("no PNG file: {error}")))?;
    let found = Size::from(reader.info().size());
    if let Some(size) = size.filter(|size| *size != found) {
        return Err(wrong(format!("expected {size} pixels, found {found}")));
    }
    if found.width.max(found.height) > MAX_SIDE {
        return Err(wrong(format!("expected at most {MAX_SIDE} pixels a side, found {found}")));
    }
    let pixels = found.pixels() as usize;
    // Eight bits of at most four channels.
    let mut bytes = vec![0; 4 * pixels];
    let info = reader.next_frame(&mut bytes).map_err(|error| wrong(format!("no PNG file: {error}")))?;
    let rgb = match info.color_type {
        png::ColorType::Rgb => {
            bytes.truncate(3 * pixels);
            bytes
        }
        other => {
            return Err(wrong(format!(
                "expected RGB, found {other:?} (MP4 files have no transparency: render without --alpha)"
            )));
        }
    };
    Ok((found, rgb))
}
