//! One LR frame as exact point samples of the HR image: colour, gradient, inverse depth.

use gs3_scene::{GBuffer, Planes};
use rayon::prelude::*;

use crate::error::ReconstructError;
use crate::reprojection::inverse_depth;

/// What is known at one sample position. Four lanes per entry, so that each is one 128-bit load; the fourth lanes (1 for
/// the colour, 0 for its derivatives) make the weight accumulate beside the weighted colour.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(16))]
pub(crate) struct Sample {
    /// RGB, 1.
    pub color: [f32; 4],
    /// ∂RGB/∂x per HR pixel, 0.
    pub dx: [f32; 4],
    /// ∂RGB/∂y per HR pixel, 0.
    pub dy: [f32; 4],
}

/// The samples of one LR frame, `[height, width]`.
#[derive(Clone, Debug, Default)]
pub(crate) struct SampleFrame {
    pub width: usize,
    pub height: usize,
    /// Offset of the sample positions from the LR pixel centres, in LR pixels.
    pub jitter: [f32; 2],
    pub samples: Vec<Sample>,
    /// `1 / z` of the median depth; 0 where nothing was hit. Empty if the frame came without geometry.
    pub inverse_depth: Vec<f32>,
}

impl SampleFrame {
    /// Takes over a checked G-buffer of an output `scale` times larger, reusing memory.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if there are no gradients.
    pub fn fill(&mut self, gbuffer: &GBuffer, scale: u32) -> Result<(), ReconstructError> {
        let Some(gradients) = &gbuffer.gradients else {
            return Err(ReconstructError::Missing { what: "image gradients" });
        };
        let (width, height) = (gbuffer.width(), gbuffer.height());
        (self.width, self.height, self.jitter) = (width, height, gbuffer.jitter);
        self.samples.resize(width * height, Sample::default());
        let per_hr_pixel = 1.0 / scale as f32;
        self.samples.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
            let [r, g, b] = rgb_rows(&gbuffer.color, y);
            let [rx, gx, bx] = rgb_rows(&gradients.color_dx, y);
            let [ry, gy, by] = rgb_rows(&gradients.color_dy, y);
            for (i, sample) in row.iter_mut().enumerate() {
                sample.color = [r[i], g[i], b[i], 1.0];
                sample.dx = [rx[i] * per_hr_pixel, gx[i] * per_hr_pixel, bx[i] * per_hr_pixel, 0.0];
                sample.dy = [ry[i] * per_hr_pixel, gy[i] * per_hr_pixel, by[i] * per_hr_pixel, 0.0];
            }
        });
        self.inverse_depth.clear();
        if let Some(geometry) = &gbuffer.geometry {
            self.inverse_depth.extend(geometry.depth_median.data().iter().map(|&z| inverse_depth(z)));
        }
        Ok(())
    }
}

/// Row `y` of the three colour planes.
pub(crate) fn rgb_rows(planes: &Planes<3>, y: usize) -> [&[f32]; 3] {
    std::array::from_fn(|c| planes.row(c, y))
}
