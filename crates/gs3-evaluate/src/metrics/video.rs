//! ColorVideoVDP (Mantiuk, Hanji, Ashraf, Asano, Chapiro 2024): visible differences of video in just-objectionable
//! differences, through the crate `colorvideovdp`, a port that agrees with the authors' implementation (see the tests).

use colorvideovdp::{Color, Cvvdp, DisplayModel, Options};
use gs3_scene::Image;

use super::{MetricError, displayed, same_size};

/// How the video is watched.
#[derive(Clone, Debug, PartialEq)]
pub struct Viewing {
    /// A display model of ColorVideoVDP by name; `standard_4k` is a 30-inch 3840×2160 display seen from 0.75 m.
    pub display: String,
    /// Displayed frames per second.
    pub frames_per_second: f32,
    /// Largest working memory in bytes; about 120 bytes per pixel and cached frame.
    pub memory_limit_bytes: usize,
}

/// Quality in JOD, 10 for no visible difference, 1 less where 75 % of observers would prefer the reference to a video 1
/// JOD higher. A single frame is judged as a still image.
///
/// # Errors
/// [`MetricError`] if frame counts or sizes differ, a frame is smaller than 4×4, or the display is unknown.
pub fn color_video_vdp(reference: &[Image], test: &[Image], viewing: &Viewing) -> Result<f64, MetricError> {
    if reference.len() != test.len() {
        return Err(MetricError::FrameCount {
            what: "test frames",
            expected: reference.len(),
            actual: test.len(),
        });
    }
    for (reference, test) in reference.iter().zip(test) {
        same_size(reference, "test frame", test)?;
    }
    let options = Options::default().with_memory_limit_bytes(viewing.memory_limit_bytes);
    let metric = Cvvdp::new(DisplayModel::from_name(&viewing.display)?, options)?;
    let reference: Vec<_> = reference.iter().map(converted).collect::<Result<_, _>>()?;
    let test: Vec<_> = test.iter().map(converted).collect::<Result<_, _>>()?;
    let prediction = metric.predict_video(&test, &reference, viewing.frames_per_second, Color::Srgb)?;
    Ok(f64::from(prediction.jod))
}

fn converted(image: &Image) -> Result<colorvideovdp::Image, colorvideovdp::Error> {
    let data = image.pixels().iter().flat_map(|p| [p[0], p[1], p[2]].map(displayed)).collect();
    colorvideovdp::Image::new(image.width(), image.height(), 3, data)
}
