//! Videos through the `ffmpeg` on PATH.

use std::fmt::Display;
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use gs3::scene::Size;
use gs3_files::end_of_links;
use gs3_video::Picture;

use super::stream::{Failure, Stream};

use crate::cli::interrupt;

/// How frames become a video. 4:2:0 plays everywhere.
const ENCODING: [&str; 8] =
    ["-pix_fmt", "yuv420p", "-c:v", "libx264", "-crf", "17", "-movflags", "+faststart"];

/// What the colours are, as [`Picture`] and [`filter`] make them.
const COLOURS: [&str; 8] =
    ["-color_range", "tv", "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"];

/// What does to PNG files of `size` what [`Picture`] does: BT.709 colours, even sides, the last column or row twice where
/// a side is odd.
fn filter(size: Size) -> String {
    let colours = "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_inp";
    let [right, bottom] = [size.width % 2, size.height % 2];
    if right + bottom == 0 {
        return colours.to_owned();
    }
    let (even, border) = ("pad=ceil(iw/2)*2:ceil(ih/2)*2", format!("right={right}:bottom={bottom}"));
    format!("format=gbrp,{even},fillborders={border}:mode=smear,{colours}")
}

/// The command that makes `file` of the frames of `stream` in folder `frames` that have these `numbers`, for a shell.
pub fn by_hand(file: &Path, frames: &Path, numbers: &Range<usize>, stream: &Stream) -> String {
    // In the name of a series of images % stands for a number.
    let series = format!("{}/frame_%06d.png", no_option(frames).display().to_string().replace('%', "%%"));
    let (rate, first, count) =
        (stream.rate.to_string(), numbers.start.to_string(), numbers.len().to_string());
    let file = no_option(file).display().to_string();
    let input = ["ffmpeg", "-framerate", &rate, "-start_number", &first, "-i", &series, "-frames:v", &count];
    let filter = filter(stream.size);
    let words =
        input.into_iter().chain(["-vf", &filter]).chain(ENCODING).chain(COLOURS).chain([file.as_str()]);
    words.map(quoted).collect::<Vec<_>>().join(" ")
}

/// `path` in a form that no command takes for an option, with any beginning.
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

fn failed(reason: &impl Display) -> Failure {
    Failure(format!("ffmpeg failed: {reason}"))
}

/// How often it is looked whether `ffmpeg` has ended: unnoticed by people, and nothing beside encoding.
const LOOK: Duration = Duration::from_millis(10);

/// Most bytes kept of `ffmpeg`'s messages: the first line is reported, and no line is as long.
const MOST_SAID: u64 = 1 << 16;

/// A running `ffmpeg` that takes raw frames. Its file appears under its name when the video is whole; until then a
/// second Ctrl-C ends it, should it be stuck.
pub struct Ffmpeg {
    size: Size,
    /// Where the video goes: of a link the file that it leads to.
    file: PathBuf,
    partial: PathBuf,
    /// Shared with what handles Ctrl-C, so it is never locked for long.
    process: Arc<Mutex<Child>>,
    frames: Option<ChildStdin>,
    said: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    /// Starts `ffmpeg` for the frames of `stream`; none if there is none on PATH.
    pub fn start(file: &Path, stream: &Stream) -> Result<Option<Self>, Failure> {
        let file = end_of_links(file).map_err(|error| failed(&error))?;
        // A name of this process alone: the `ffmpeg` of a process that was killed may still be ending its own file.
        let partial = file.with_extension(format!("{}.mp4.partial", std::process::id()));
        let mut command = Command::new("ffmpeg");
        let even = stream.size.map(|side| side.next_multiple_of(2));
        command.args(["-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "yuv420p"]).args(COLOURS);
        command.args(["-s", &even.to_string(), "-r", &stream.rate.to_string(), "-i", "-"]);
        command.args(ENCODING).args(COLOURS).args(["-f", "mp4", "-y"]).arg(no_option(&partial));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // In a process group of its own it does not see Ctrl-C, so that this command decides what is left.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut process = match command.spawn() {
            // A folder or a file of that name on PATH that is no program is none, either.
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) => {
                return Ok(None);
            }
            process => process.map_err(|error| failed(&error))?,
        };
        let frames = process.stdin.take();
        // Read while frames are written: neither pipe may fill up while the other is waited for.
        let said = process.stderr.take().map(|stderr| thread::spawn(move || said(stderr)));
        let process = Arc::new(Mutex::new(process));
        let (shared, unfinished) = (Arc::clone(&process), partial.clone());
        interrupt::on_second_request(Some(Box::new(move || kill(&shared, &unfinished))));
        Ok(Some(Self { size: stream.size, file, partial, process, frames, said }))
    }

    /// Gives `ffmpeg` the next frame, RGB rows.
    pub fn write(&mut self, rgb: &[u8]) -> Result<(), Failure> {
        let picture = Picture::from_rgb8(self.size.to_array(), rgb).map_err(|error| failed(&error))?;
        let written = self.frames.as_mut().map(|frames| frames.write_all(picture.samples()));
        match written {
            Some(Ok(())) => Ok(()),
            // It ended early; what it said says why.
            _ => self.end().and(Err(failed(&"it ended before the last frame"))),
        }
    }

    /// Waits for the video to be whole.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.end()?;
        fs::rename(&self.partial, &self.file).map_err(|error| failed(&error))
    }

    fn end(&mut self) -> Result<(), Failure> {
        drop(self.frames.take());
        let status = loop {
            // Without the lock in between.
            let ended = lock(&self.process).try_wait();
            match ended.map_err(|error| failed(&error))? {
                Some(status) => break status,
                None => thread::sleep(LOOK),
            }
        };
        // Without a reason from ffmpeg its exit status still tells.
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        match (status.success(), said.lines().find(|line| !line.trim().is_empty())) {
            (true, _) => Ok(()),
            (false, Some(line)) => Err(failed(&line)),
            (false, None) => Err(failed(&status)),
        }
    }
}

impl Drop for Ffmpeg {
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

/// The beginning of `ffmpeg`'s messages. All messages are read.
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
        let stream = Stream { size: Size::new(96, 54), rate: 29.97, frames: 4 };
        let text = by_hand(Path::new("/tmp/it's.mp4"), Path::new("50 %"), &(3..7), &stream);
        let (input, output) = text.split_once(" -vf ").unwrap();
        assert_eq!(input, "ffmpeg -framerate 29.97 -start_number 3 -i './50 %%/frame_%06d.png' -frames:v 4");
        assert!(output.starts_with("scale=out_color_matrix=bt709:out_range=tv:"), "{output}");
        assert!(output.ends_with(r" '/tmp/it'\''s.mp4'"), "{output}");
        let odd = by_hand(
            Path::new("v.mp4"),
            Path::new("v"),
            &(3..7),
            &Stream { size: Size::new(95, 54), ..stream },
        );
        assert!(odd.contains("ceil(ih/2)*2,fillborders=right=1:bottom=0:mode=smear,scale="), "{odd}");
    }
}
