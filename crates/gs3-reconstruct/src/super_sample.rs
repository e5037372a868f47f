//! Temporal super sampling without learning.

use fearless_simd::{Level, Simd, dispatch, f32x4, prelude::*};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, camera_size, check_gbuffer, check_scale};
use crate::hermite::{Cubics, Surface};
use crate::plausible::Plausible;
use crate::reprojection::Reprojection;
use crate::samples::SampleFrame;
use crate::splat::{Band, NOISE, Rows, Source};

/// Why history is not valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetReason {
    /// There has been no frame yet.
    FirstFrame,
    /// The camera jumped: what it sees has little to do with what it saw.
    CameraCut,
    /// The output size or the quality tier changed.
    SizeOrTierChange,
    /// The scene, or what is shown of it, changed.
    SceneChange,
}

/// HR pixels that one task fills: their accumulators (16 B each) fill a core's L2 cache of 1 MiB. Smaller bands reproject
/// more samples twice, larger ones spill; the result does not depend on it.
const BAND_PIXELS: usize = 1 << 16;

/// Deviation up to which a pixel counts as exact, pixel²: that of one sample on its centre, √[`NOISE`] = 0.00316, and room
/// for the rounding of places and weights.
const EXACT: f32 = 0.0033;

/// Variance of the interpolated current frame at distance d from its nearest sample, pixel⁴: that of one sample's
/// first-order prediction, d⁴, times [`SURFACE`] because it joins four samples, and flattening to a square, because no
/// error exceeds the contrast of the image (both empirical).
const SURFACE: f32 = 0.5;

/// One remembered LR frame.
#[derive(Clone, Debug)]
struct Past {
    camera: Camera,
    frame: SampleFrame,
    /// Pixel rows that each chunk of samples touches now, `[LR height, chunks per row]`.
    chunk_rows: Vec<Rows>,
    /// The same for each row of samples, `[LR height]`.
    row_rows: Vec<Rows>,
}

/// Super-samples a sequence of jittered LR frames on the HR grid.
///
/// The history is the last S² LR frames themselves: exact samples, splatted anew for every frame (see the module
/// `splat`). At rest under the exact S×S grid jitter the result therefore is the native image after S² frames.
///
/// Memory: 52 B per LR pixel and remembered frame, that is per HR pixel.
#[derive(Debug)]
pub struct SuperSampler {
    scale: u32,
    /// The last frames, newest first.
    past: Vec<Past>,
    surface: Surface,
    plausible: Plausible,
    invalid: Option<ResetReason>,
    level: Level,
}

impl SuperSampler {
    /// A super sampler of `scale` (1 to [`crate::MAX_SCALE`]) without history.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if `scale` is not supported.
    pub fn new(scale: u32) -> Result<Self, ReconstructError> {
        check_scale(scale)?;
        Ok(Self {
            scale,
            past: Vec::new(),
            surface: Surface::default(),
            plausible: Plausible::default(),
            invalid: Some(ResetReason::FirstFrame),
            level: Level::new(),
        })
    }

    /// Forgets the history. The next frame is reconstructed from itself alone.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// Why the next frame will have no history, if it will have none.
    #[must_use]
    pub const fn history_invalid(&self) -> Option<ResetReason> {
        self.invalid
    }

    /// Reconstructs the image of `camera` from `gbuffer`, its LR frame, and the frames before it, into `out`, which is
    /// resized. The fourth channel becomes the uncertainty, `[0, 1]`: √(1/Σw) less that of one exact sample, with Σw the
    /// sum of the inverse variances (pixel⁻⁴) of all that predicts the pixel. Its unit is pixel²: what the curvature of the
    /// image is to be multiplied with to give the expected error. It is 0 where a pixel has a sample of its own, so
    /// everywhere at rest with a full history; it is larger where samples are far, old, doubtful or missing. Another size
    /// than before resets the history.
    ///
    /// `gbuffer` is what [`Camera::low_resolution`] of `camera` sees, with gradients and geometry, point-sampled at its
    /// jitter (`dilation` matched to the scale).
    ///
    /// # Errors
    /// [`ReconstructError`] if `gbuffer` is not the LR frame of `camera` or lacks gradients or geometry; the history is
    /// then as before.
    pub fn super_sample(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        let size = camera_size(camera);
        check_gbuffer(gbuffer, self.scale, size)?;
        if gbuffer.geometry.is_none() {
            return Err(ReconstructError::Missing { what: "depth" });
        }
        if gbuffer.gradients.is_none() {
            return Err(ReconstructError::Missing { what: "image gradients" });
        }
        if self.past.first().is_some_and(|newest| camera_size(&newest.camera) != size) {
            self.reset(ResetReason::SizeOrTierChange);
        }
        if self.invalid.take().is_some() {
            self.past.clear();
        }
        self.remember(camera, gbuffer)?;
        self.find_rows(camera);
        out.resize(size.0, size.1);
        self.accumulate(camera, out);
        Ok(())
    }

    /// Takes the current frame into the history, as its newest.
    fn remember(&mut self, camera: &Camera, gbuffer: &GBuffer) -> Result<(), ReconstructError> {
        let is_full = self.past.len() >= (self.scale * self.scale) as usize;
        let oldest = if is_full { self.past.pop() } else { None };
        let mut newest = oldest.unwrap_or_else(|| Past {
            camera: *camera,
            frame: SampleFrame::default(),
            chunk_rows: Vec::new(),
            row_rows: Vec::new(),
        });
        newest.camera = *camera;
        newest.frame.fill(gbuffer, self.scale)?;
        self.surface.set(&newest.frame, gbuffer, self.scale);
        self.plausible.set(&newest.frame, self.scale);
        self.past.insert(0, newest);
        Ok(())
    }

    /// Finds which pixel rows the samples of the past touch now.
    fn find_rows(&mut self, camera: &Camera) {
        let (scale, level) = (self.scale as f32, self.level);
        for (age, past) in self.past.iter_mut().enumerate() {
            let reprojection = Reprojection::new(&past.camera, camera);
            let source = Source { frame: &past.frame, reprojection, age, scale };
            let chunks = source.chunks_per_row();
            let height = past.frame.height;
            past.chunk_rows.resize(chunks * height, Rows::NONE);
            past.row_rows.resize(height, Rows::NONE);
            let rows = past.chunk_rows.par_chunks_exact_mut(chunks).zip(&mut past.row_rows);
            rows.enumerate().with_min_len(32).for_each(|(row, (chunk_rows, row_rows))| {
                dispatch!(level, simd => {
                    *row_rows = Rows::NONE;
                    for (chunk, rows) in chunk_rows.iter_mut().enumerate() {
                        *rows = source.rows(simd, row, chunk);
                        *row_rows = row_rows.union(*rows);
                    }
                });
            });
        }
    }

    /// Combines the samples of the past with the interpolated current frame.
    fn accumulate(&self, camera: &Camera, out: &mut Image) {
        let width = out.width();
        let band_rows = (BAND_PIXELS / width).max(1);
        out.pixels_mut().par_chunks_mut(band_rows * width).enumerate().for_each_init(
            Cubics::default,
            |scratch, (index, pixels)| {
                let band = Band { top: index * band_rows, width, pixels };
                dispatch!(self.level, simd => self.fill_band(simd, camera, scratch, band));
            },
        );
    }

    #[inline(always)]
    fn fill_band<S: Simd>(&self, simd: S, camera: &Camera, scratch: &mut Cubics, mut band: Band<'_>) {
        let top = band.top;
        for (r, row) in band.pixels.chunks_exact_mut(band.width).enumerate() {
            let weights = self.surface_weights(top + r);
            self.surface.row(simd, &self.past[0].frame, top + r, &weights, scratch, row);
        }
        for (age, past) in self.past.iter().enumerate() {
            let reprojection = Reprojection::new(&past.camera, camera);
            let source = Source { frame: &past.frame, reprojection, age, scale: self.scale as f32 };
            let chunks = source.chunks_per_row();
            for (row, rows) in past.row_rows.iter().enumerate() {
                if !band.meets(*rows) {
                    continue;
                }
                for (chunk, rows) in past.chunk_rows[row * chunks..(row + 1) * chunks].iter().enumerate() {
                    if band.meets(*rows) {
                        band.add(simd, &source, &self.plausible, row, chunk);
                    }
                }
            }
        }
        for pixel in band.pixels {
            let variance = 1.0 / pixel[3];
            *pixel = (f32x4::load_array_ref(simd, pixel) * variance).to_array();
            pixel[3] = (variance.sqrt() - EXACT).clamp(0.0, 1.0);
        }
    }

    /// Weights of the interpolated current frame at the pixels of one period of row `y`.
    #[inline(always)]
    fn surface_weights(&self, y: usize) -> [f32; crate::MAX_SCALE as usize] {
        let mut weights = [0.0; crate::MAX_SCALE as usize];
        let (x_phases, y_place) = (self.surface.x_phases(), self.surface.y_place(y));
        let to_sample = |f: f32| f.min(1.0 - f) * self.scale as f32;
        let dy = to_sample(y_place.fraction);
        for (weight, place) in weights.iter_mut().zip(x_phases) {
            let dx = to_sample(place.fraction);
            let d2 = dx * dx + dy * dy;
            *weight = 1.0 / (NOISE + SURFACE * d2 * d2 / (1.0 + SURFACE * d2));
        }
        weights
    }
}
