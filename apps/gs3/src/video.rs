//! Video through the `ffmpeg` on PATH.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::error::CliError;

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
        // 4:2:0 plays everywhere and needs even sizes.
        command.args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]);
        command
            .args(["-c:v", "libx264", "-crf", "17", "-movflags", "+faststart", "-f", "mp4", "-y"])
            .arg(&partial);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // In a process group of its own it does not see Ctrl-C, so that this command decides what is left.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        match command.spawn() {
            Ok(process) => Ok(Some(Self { file: file.into(), partial, frames: frames.into(), process })),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                eprintln!(
                    "no ffmpeg on PATH, so no {}: the frames are {}/frame_*.png at {rate} frames per second",
                    file.display(),
                    frames.display()
                );
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
