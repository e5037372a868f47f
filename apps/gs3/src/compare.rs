//! The comparison image: native, bicubic and gs3 side by side.

use std::path::Path;

use gs3::reconstruct::{Kernel, resample};
use gs3::scene::{Camera, Image};
use gs3::{FramePipeline, Mode, PipelineSettings};
use gs3_evaluate::metrics::{Quantisation, psnr};
use serde_json::{Value, json};

use crate::error::CliError;
use crate::output::write_png;
use crate::terminal::note;

/// Width of the white line between crops, in pixels.
const GAP: usize = 4;

/// Writes the middle thirds of the frame at `camera`, the pipeline's last: native, bicubic enlargement of the same
/// low-resolution frame, the pipeline's own. Prints and gives the PSNR of the whole frames against native.
pub fn write(pipeline: &mut FramePipeline, camera: &Camera, file: &Path) -> Result<Value, CliError> {
    let settings = *pipeline.settings();
    let native_settings = PipelineSettings { mode: Mode::Native, ..settings };
    let mut native = FramePipeline::new(pipeline.scene().clone(), native_settings)?;
    let native = native.render(camera)?.current;
    let mut bicubic = Image::new(native.width(), native.height());
    pipeline.fetch_gbuffer()?;
    resample(pipeline.gbuffer(), settings.scale, Kernel::Bicubic, &mut bicubic)?;
    let own = pipeline.last_image();
    write_png(file, &side_by_side([native, &bicubic, own]))?;
    let quality = |image| psnr(native, image, Quantisation::EightBit);
    let (bicubic, own) = (quality(&bicubic)?, quality(own)?);
    note(format_args!(
        "{}: native | bicubic ({bicubic:.2} dB) | gs3 ({own:.2} dB), PSNR of the last frame against native",
        file.display()
    ));
    Ok(json!({ "bicubic_psnr": finite(bicubic), "psnr": finite(own) }))
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
