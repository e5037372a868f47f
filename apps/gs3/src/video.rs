//! Video through the `ffmpeg` on PATH.

use std::fmt::Display;
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use gs3_files::end_of_links;

use crate::error::CliError;
use crate::interrupt;
use crate::output::frame_name;
use crate::terminal::note;

/// How frames become a video. 4:2:0 plays everywhere and needs even sizes.
const ENCODING: [&str; 10] = [
    "-vf",
    "pad=ceil(iw/2)*2:ceil(ih/2)*2",
    "-pix_fmt",
    "yuv420p",
    "-c:v",
    "libx264",
    "-crf",
    "17",
    "-movflags",
    "+faststart",
];

/// The command that makes `file` of the frames with these `numbers` in folder `frames`, for a shell.
pub fn by_hand(file: &Path, frames: &Path, numbers: &Range<usize>, rate: f64) -> String {
    // In the name of a series of images % stands for a number.
    let series = format!("{}/frame_%06d.png", no_option(frames).display().to_string().replace('%', "%%"));
    let (rate, first, count) = (rate.to_string(), numbers.start.to_string(), numbers.len().to_string());
    let file = no_option(file).display().to_string();
    let input = ["ffmpeg", "-framerate", &rate, "-start_number", &first, "-i", &series, "-frames:v", &count];
    input.into_iter().chain(ENCODING).chain([file.as_str()]).map(quoted).collect::<Vec<_>>().join(" ")
}

/// `path` such that no command takes it for an option, whatever it begins with.
pub fn no_option(path: &Path) -> PathBuf {
    Path::new(".").join(path)
}

/// A word as a shell reads it back.
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "+-./:=_%".contains(c);
    match word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    }
}

/// Why there is no video.
#[derive(Debug)]
pub enum NoVideo {
    /// No `ffmpeg` is on PATH.
    Absent,
    /// What went wrong with the one that is.
    Failed(String),
}

impl NoVideo {
    /// Says why `file` is not there, and how to make it of the frames with these `numbers` in folder `frames`. Without
    /// an `ffmpeg` frames are all that there can be; one that fails is an error, as whoever has it counts on the video.
    pub fn tell(self, file: &Path, frames: &Path, numbers: &Range<usize>, rate: f64) -> Result<(), CliError> {
        let by_hand = by_hand(file, frames, numbers, rate);
        match self {
            Self::Absent => {
                let [first, last] = [numbers.start, numbers.end.saturating_sub(1)].map(frame_name);
                note(format_args!(
                    "no ffmpeg on PATH, so no {}: the frames are {}/{first} to {last}, and where there is one, {by_hand} makes it",
                    file.display(),
                    frames.display(),
                ));
                Ok(())
            }
            Self::Failed(message) => {
                Err(CliError::Video { path: file.into(), message, frames: frames.into(), by_hand })
            }
        }
    }

    fn failed(reason: &impl Display) -> Self {
        Self::Failed(format!("ffmpeg failed: {reason}"))
    }
}

/// How often it is looked whether `ffmpeg` has ended: unnoticed by people, and nothing beside encoding.
const LOOK: Duration = Duration::from_millis(10);

/// Most of what `ffmpeg` says that is kept: its first line is told, and no line is as long.
const MOST_SAID: u64 = 1 << 16;

/// A running `ffmpeg` that takes raw frames. Its file appears under its name when the video is whole; until then a
/// second Ctrl-C ends it, should it be stuck.
pub struct Video {
    /// Where the video goes: of a link the file that it leads to.
    file: PathBuf,
    partial: PathBuf,
    /// Shared with what handles Ctrl-C, so it is never locked for long.
    process: Arc<Mutex<Child>>,
    frames: Option<ChildStdin>,
    said: Option<JoinHandle<String>>,
}

impl Video {
    /// Starts `ffmpeg` for frames of `size`.
    pub fn start(file: &Path, size: [u32; 2], rate: f64) -> Result<Self, NoVideo> {
        let file = end_of_links(file).map_err(|error| NoVideo::failed(&error))?;
        let partial = file.with_extension("mp4.partial");
        let mut command = Command::new("ffmpeg");
        command.args(["-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &format!("{}x{}", size[0], size[1]), "-r", &rate.to_string(), "-i", "-"]);
        command.args(ENCODING).args(["-f", "mp4", "-y"]).arg(no_option(&partial));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // In a process group of its own it does not see Ctrl-C, so that this command decides what is left.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut process = command.spawn().map_err(|error| match error.kind() {
            ErrorKind::NotFound => NoVideo::Absent,
            _ => NoVideo::failed(&error),
        })?;
        let frames = process.stdin.take();
        // Read while frames are written: neither pipe may fill up while the other is waited for.
        let said = process.stderr.take().map(|stderr| thread::spawn(move || said(stderr)));
        let process = Arc::new(Mutex::new(process));
        let (shared, unfinished) = (Arc::clone(&process), partial.clone());
        interrupt::on_second_request(Some(Box::new(move || kill(&shared, &unfinished))));
        Ok(Self { file, partial, process, frames, said })
    }

    /// Gives `ffmpeg` the next frame, RGB rows.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), NoVideo> {
        let written = self.frames.as_mut().map(|frames| frames.write_all(bytes));
        match written {
            Some(Ok(())) => Ok(()),
            // It ended early; what it said says why.
            _ => self.end().and(Err(NoVideo::failed(&"it ended before the last frame"))),
        }
    }

    /// Waits for the video to be whole.
    pub fn finish(mut self) -> Result<(), NoVideo> {
        self.end()?;
        fs::rename(&self.partial, &self.file).map_err(|error| NoVideo::failed(&error))
    }

    fn end(&mut self) -> Result<(), NoVideo> {
        drop(self.frames.take());
        let status = loop {
            // Without the lock in between.
            let ended = lock(&self.process).try_wait();
            match ended.map_err(|error| NoVideo::failed(&error))? {
                Some(status) => break status,
                None => thread::sleep(LOOK),
            }
        };
        // Without a reason from ffmpeg its exit status still tells.
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        match (status.success(), said.lines().find(|line| !line.trim().is_empty())) {
            (true, _) => Ok(()),
            (false, Some(line)) => Err(NoVideo::failed(&line)),
            (false, None) => Err(NoVideo::failed(&status)),
        }
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        drop(self.frames.take());
        interrupt::on_second_request(None);
        kill(&self.process, &self.partial);
    }
}

/// Ends `process`, if it has not ended, and leaves no part of a video.
fn kill(process: &Mutex<Child>, partial: &Path) {
    let mut process = lock(process);
    // Where it is gone already, so much the better; where it cannot be ended, nothing more can be done.
    let _ = process.kill().and_then(|()| process.wait());
    let _ = fs::remove_file(partial);
}

fn lock(process: &Mutex<Child>) -> MutexGuard<'_, Child> {
    process.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The beginning of what `ffmpeg` says, all of which is read.
fn said(mut stderr: ChildStderr) -> String {
    let mut bytes = Vec::new();
    // What was read before an error may still tell something.
    let _ = stderr.by_ref().take(MOST_SAID).read_to_end(&mut bytes);
    let _ = io::copy(&mut stderr, &mut io::sink());
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_to_be_typed_is_quoted_where_a_shell_needs_it() {
        let text = by_hand(Path::new("/tmp/it's.mp4"), Path::new("50 %"), &(3..7), 29.97);
        let (input, output) = text.split_once(" -vf ").unwrap();
        assert_eq!(input, "ffmpeg -framerate 29.97 -start_number 3 -i './50 %%/frame_%06d.png' -frames:v 4");
        assert!(output.starts_with("'pad=ceil(iw/2)*2:ceil(ih/2)*2' -pix_fmt yuv420p "), "{output}");
        assert!(output.ends_with(r" '/tmp/it'\''s.mp4'"), "{output}");
    }
}
