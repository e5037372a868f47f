//! The comparison with native rendering: how much faster and how good, over frames of the run, and an image of native,
//! bicubic and gs3 side by side.

use std::path::Path;
use std::time::Duration;

use gs3::reconstruct::{ResampleKernel, resample};
use gs3::scene::{Camera, Image};
use gs3::{Backend, Mode, Networks, PipelineError, PipelineSettings, Session};
use gs3_evaluate::metrics::{Quantisation, psnr};
use gs3_evaluate::protocol::PSNR_CAP;
use serde_json::{Value, json};

use crate::cli::backend::tell_notices;
use crate::cli::error::CliError;
use crate::cli::terminal::note;
use crate::io::output::write_png;

/// Most frames that are rendered natively, too: enough for a mean, few enough that the run is not twice as long.
const MOST: usize = 8;

/// Width of the white line between crops, in pixels.
const GAP: usize = 4;

/// Native rendering beside a run: of some of its frames, each right after the run's own, so that what else the machine
/// does slows both. All threads are the same.
pub struct Comparison {
    native: Session,
    /// The frames of the path that are compared, the run's last among them.
    frames: Vec<usize>,
    compared: usize,
    /// Frames shown at the compared ones, those between included.
    displayed: usize,
    own_time: Duration,
    native_time: Duration,
    /// Sum of PSNRs in dB, each capped.
    psnr: f64,
}

impl Comparison {
    /// A comparison over `frames` of a path, which `session` renders.
    pub fn new(session: &Session, frames: &[usize]) -> Result<Self, PipelineError> {
        let settings = PipelineSettings { mode: Mode::Native, ..session.settings().pipeline };
        let native = session.beside(session.scene().clone(), settings, &Networks::default())?;
        let frames = compared(frames);
        let (own_time, native_time) = (Duration::ZERO, Duration::ZERO);
        Ok(Self { native, frames, compared: 0, displayed: 0, own_time, native_time, psnr: 0.0 })
    }

    /// Looks at frame `k`, which `session` has just rendered at `camera` to show `displayed` frames.
    pub fn observe(
        &mut self,
        session: &Session,
        k: usize,
        camera: &Camera,
        displayed: usize,
    ) -> Result<(), CliError> {
        if !self.frames.contains(&k) {
            return Ok(());
        }
        if session.backend() == Backend::Cpu && self.native.backend() == Backend::Gpu {
            // The CPU took over: frames before it were of another machine.
            self.native.render_on_cpu()?;
            (self.compared, self.displayed, self.psnr) = (0, 0, 0.0);
            (self.own_time, self.native_time) = (Duration::ZERO, Duration::ZERO);
        }
        // The first one makes its memory. A device that has waited is slow at first (an H200: ten times as long).
        if self.compared == 0 || self.native.backend() == Backend::Gpu {
            self.native.render(camera)?;
        }
        self.native.render(camera)?;
        tell_notices(std::slice::from_mut(&mut self.native));
        if self.native.backend() != session.backend() {
            return Err(
                PipelineError::Internal { expected: "native frames by the machine of the run" }.into()
            );
        }
        let native = self.native.pipeline();
        let (own, own_time) = (session.pipeline().last_image(), session.pipeline().times().total());
        self.psnr += psnr(native.last_image(), own, Quantisation::EightBit)?.min(PSNR_CAP);
        self.compared += 1;
        self.displayed += displayed;
        self.own_time += own_time;
        // Shown natively, the in-between frames would each take as long.
        self.native_time += native.times().total() * displayed as u32;
        Ok(())
    }

    /// Writes the middle thirds of the run's last frame: native, bicubic enlargement of the same low-resolution frame, the
    /// session's own. Says how good and how fast the run was, and gives these figures.
    pub fn write(self, session: &mut Session, file: &Path) -> Result<Value, CliError> {
        let native = self.native.pipeline().last_image();
        let mut bicubic = Image::new(native.width(), native.height());
        session.fetch_gbuffer()?;
        let pipeline = session.pipeline();
        resample(pipeline.gbuffer(), pipeline.scale(), ResampleKernel::Bicubic, &mut bicubic)?;
        let own = pipeline.last_image();
        write_png(file, &side_by_side([native, &bicubic, own]))?;
        let quality = |image| psnr(native, image, Quantisation::EightBit);
        let (bicubic, own) = (quality(&bicubic)?, quality(own)?);
        let [own_time, native_time] = [self.own_time, self.native_time].map(|time| time.as_secs_f64());
        let [own_fps, native_fps] = [own_time, native_time].map(|time| self.displayed as f64 / time);
        let times = native_time / own_time;
        let mean = self.psnr / self.compared as f64;
        let frames = match self.compared {
            1 => "1 rendered frame".to_owned(),
            count => format!("{count} rendered frames"),
        };
        note(format_args!(
            "{}: native | bicubic ({bicubic:.2} dB) | gs3 ({own:.2} dB), PSNR of the last frame against native",
            file.display()
        ));
        note(format_args!(
            "{times:.2} times as fast as native over {frames} timed in turn with native ones ({own_fps:.1} against \
             {native_fps:.1} displayed frames/s), mean PSNR {mean:.2} dB"
        ));
        Ok(json!({
            "bicubic_psnr": finite(bicubic),
            "psnr": finite(own),
            "frames": self.compared,
            "mean_psnr": mean,
            "displayed_fps": own_fps,
            "native_fps": native_fps,
            "times_native": times,
        }))
    }
}

/// Up to [`MOST`] of `frames`, evenly spread, the last among them. The first, before which there may be nothing, only if
/// there is no other.
fn compared(frames: &[usize]) -> Vec<usize> {
    let frames = &frames[usize::from(frames.len() > 1)..];
    let most = frames.len().min(MOST);
    (1..=most).map(|i| frames[i * frames.len() / most - 1]).collect()
}

/// JSON has no infinity: equal images have no PSNR.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// The middle third of each image's width, with lines between them.
fn side_by_side(images: [&Image; 3]) -> Image {
    let (width, height) = (images[0].width(), images[0].height());
    let crop = (width / 3).max(1);
    let left = (width - crop) / 2;
    let mut out = Image::new(3 * crop + 2 * GAP, height);
    let stride = out.width();
    out.pixels_mut().fill([1.0; 4]);
    for (y, row) in out.pixels_mut().chunks_exact_mut(stride).enumerate() {
        for (k, image) in images.iter().enumerate() {
            let start = k * (crop + GAP);
            row[start..start + crop].copy_from_slice(&image.row(y)[left..left + crop]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_to_compare_are_spread_and_end_with_the_last() {
        assert_eq!(compared(&Vec::from_iter(0..30)), [3, 7, 10, 14, 18, 21, 25, 29]);
        assert_eq!(compared(&Vec::from_iter(5..10)), [6, 7, 8, 9]);
        assert_eq!(compared(&[4]), [4]);
        assert_eq!(compared(&[0, 9]), [9]);
        assert_eq!(compared(&[]), [0_usize; 0]);
    }
}
