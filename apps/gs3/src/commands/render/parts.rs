//! Frames of a part of a path: their numbers, which of them are there, and what is told at their end or after an
//! interruption.

use std::ops::Range;

use gs3::scene::CameraPath;

use super::args::RenderArgs;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::terminal::note;
use crate::io::frame_files::{frame_name, others};
use crate::io::manifest::Manifest;
use crate::io::output::Target;
use crate::io::video::{Failure, Stream, by_hand, no_option, quoted};

/// What a video of the rendered frames `range` of `path` is, where `each` are shown for one.
pub fn stream_of(path: &CameraPath, range: &Range<usize>, each: usize) -> Stream {
    Stream {
        size: path.cameras()[range.start].size(),
        rate: path.frames_per_second() * each as f64,
        frames: numbers_of(range, each).len(),
    }
}

/// Frames per second that most screens show.
const SCREEN_RATE: f64 = 60.0;

/// Says that a video has more frames per second than most screens show, where fewer in-between frames would help. Such a screen
/// leaves out frames unevenly.
pub fn tell_of_high_rate(target: &Target, stream: &Stream, each: usize) {
    if let Target::Video { file, .. } = target
        && each > 2
        && stream.rate > SCREEN_RATE
    {
        let fewer = 2.0 * stream.rate / each as f64;
        note(format_args!(
            "{} has {} frames per second, and most screens show {SCREEN_RATE}; with --in-between 1 it has {fewer}",
            file.display(),
            stream.rate,
        ));
    }
}

/// Ends a run over the rendered frames `range`, which wrote frames of `stream` with these `numbers`. After an
/// interruption `next` is the first frame that is left, and the user is told how to go on. After a whole run the video
/// that was asked for may be missing, which is an error.
pub fn end(
    target: &Target,
    range: &Range<usize>,
    next: Option<usize>,
    numbers: &Range<usize>,
    stream: &Stream,
    no_video: Option<Failure>,
) -> Result<Outcome, CliError> {
    if let Some(next) = next {
        let again = remainder(target, range.start, &(next..range.end), numbers, stream);
        note(format_args!("interrupted; all files are whole. To go on: {again}"));
        return Ok(Outcome::Interrupted);
    }
    match (target, no_video) {
        (Target::Video { file, frames }, Some(failure)) => Err(failure.tell(file, frames, numbers, stream)),
        _ => Ok(Outcome::Done),
    }
}

/// The command to run after an interruption, for the frames `left` of the frames from `first` on. A video starts anew
/// with the frames that it is given. So the video of all frames, with these `numbers`, is made once all of them
/// exist.
fn remainder(
    target: &Target,
    first: usize,
    left: &Range<usize>,
    numbers: &Range<usize>,
    stream: &Stream,
) -> String {
    let same = format!("the same command with --frames {}..{}", left.start, left.end);
    match target {
        Target::Video { file, frames } if left.start > first => format!(
            "{same} --out {}, and then, for the video of all frames, {}",
            // With a separator at its end the path is a folder, with any name.
            quoted(&no_option(frames).join("").display().to_string()),
            by_hand(file, frames, numbers, stream)
        ),
        Target::Video { .. } | Target::Single(_) | Target::Folder(_) => same,
    }
}

/// The numbers of what is shown of the rendered frames `range`, `each` for one: those between lie before it, but for the
/// path's first frame.
pub fn numbers_of(range: &Range<usize>, each: usize) -> Range<usize> {
    (range.start * each + 1).saturating_sub(each)..(range.end - 1) * each + 1
}

/// Whether the folder of `target` has all files of the frame with this number.
pub fn is_there(args: &RenderArgs, target: &Target, number: usize) -> bool {
    let in_numbers = || args.aov.is_empty() || target.file(number, args.aov_format.name()).is_file();
    target.folder().is_some_and(|folder| folder.join(frame_name(number)).is_file()) && in_numbers()
}

/// Which frames of `range` are rendered. With `--skip-existing` a frame is left out if the folder has its files and those of
/// the in-between frames before it. Frames of other `facts` are refused before any is made.
pub fn frames_missing(
    args: &RenderArgs,
    target: &Target,
    facts: &Manifest,
    range: &Range<usize>,
    each: usize,
) -> Result<Vec<usize>, CliError> {
    let Some(folder) = target.folder() else { return Ok(range.clone().collect()) };
    if args.skip_existing || others(folder, &numbers_of(range, each)) > 0 {
        facts.check(folder)?;
    }
    if !args.skip_existing {
        return Ok(range.clone().collect());
    }
    let is_whole = |k: &usize| numbers_of(&(*k..k + 1), each).all(|number| is_there(args, target, number));
    let missing: Vec<usize> = range.clone().filter(|k| !is_whole(k)).collect();
    note(format_args!("{} of {} frames are there already", range.len() - missing.len(), range.len()));
    Ok(missing)
}

/// Writes `facts` beside the frames with `numbers`, before any of them. Other facts in the folder are replaced only if the
/// folder has no frames but these numbers.
pub fn claim(target: &Target, facts: &Manifest, numbers: &Range<usize>) -> Result<(), CliError> {
    match target.folder() {
        Some(folder) => facts.claim(folder, others(folder, numbers) == 0),
        None => Ok(()),
    }
}
