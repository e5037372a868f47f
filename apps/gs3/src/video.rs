//! Video through the `ffmpeg` on PATH.

use std::fs;
use std::io::{ErrorKind, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::error::CliError;
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

/// A running `ffmpeg` that takes raw frames. Its file appears under its name when the video is whole.
pub struct Video {
    file: PathBuf,
    partial: PathBuf,
    frames: PathBuf,
    process: Child,
}

impl Video {
    /// Starts `ffmpeg` for frames of `size`. Without one on PATH there is no video: a message says so, and where the
    /// frames are.
    pub fn start(file: &Path, frames: &Path, size: [u32; 2], rate: f64) -> Result<Option<Self>, CliError> {
        let partial = file.with_extension("mp4.partial");
        let mut command = Command::new("ffmpeg");
        command.args(["-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &format!("{}x{}", size[0], size[1]), "-r", &rate.to_string(), "-i", "-"]);
        command.args(ENCODING).args(["-f", "mp4", "-y"]).arg(no_option(&partial));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // In a process group of its own it does not see Ctrl-C, so that this command decides what is left.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        match command.spawn() {
            Ok(process) => Ok(Some(Self { file: file.into(), partial, frames: frames.into(), process })),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                note(format_args!(
                    "no ffmpeg on PATH, so no {}: the frames are {}/frame_*.png at {rate} frames per second",
                    file.display(),
                    frames.display()
                ));
                Ok(None)
            }
            Err(error) => {
                Err(CliError::Video { path: file.into(), message: error.to_string(), frames: frames.into() })
            }
        }
    }

    /// Gives `ffmpeg` the next frame, RGB rows.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), CliError> {
        let written = self.process.stdin.as_mut().map(|stdin| stdin.write_all(bytes));
        match written {
            Some(Ok(())) => Ok(()),
            // It ended early; what it said says why.
            _ => Err(self.end().err().unwrap_or_else(|| self.error("it ended before the last frame"))),
        }
    }

    /// Waits for the video to be whole.
    pub fn finish(mut self) -> Result<(), CliError> {
        self.end()?;
        fs::rename(&self.partial, &self.file).map_err(CliError::write(&self.file))
    }

    /// Ends without a video.
    pub fn abandon(mut self) {
        // Nothing of it is kept, so how it ended does not matter.
        let _ = self.end();
    }

    fn end(&mut self) -> Result<(), CliError> {
        drop(self.process.stdin.take());
        let mut said = String::new();
        if let Some(mut stderr) = self.process.stderr.take() {
            // Without a reason from ffmpeg its exit status still tells.
            let _ = std::io::Read::read_to_string(&mut stderr, &mut said);
        }
        match self.process.wait() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.error(said.lines().next().unwrap_or(&status.to_string()))),
            Err(error) => Err(self.error(&error.to_string())),
        }
    }

    fn error(&self, message: &str) -> CliError {
        CliError::Video { path: self.file.clone(), message: message.to_owned(), frames: self.frames.clone() }
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        // After an error elsewhere ffmpeg still runs; a partial video is never left. Both may already be gone.
        drop(self.process.stdin.take());
        let _ = self.process.wait();
        let _ = fs::remove_file(&self.partial);
    }
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
