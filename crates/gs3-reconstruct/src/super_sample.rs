//! Temporal super sampling without learning.

use fearless_simd::{Level, Simd, dispatch};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, camera_size, check_gbuffer, check_scale};
use crate::hermite::{Cubics, Surface};
use crate::reprojection::Reprojection;
use crate::samples::SampleFrame;
use crate::splat::{Band, CHUNK, Landing, Occlusion, Reach, land_row};

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

/// Rows of HR pixels that one task fills: their accumulators stay in a core's L2 cache (16 rows of 4096 pixels are
/// 1 MiB), and the rows that two bands both visit stay few.
const BAND_ROWS: usize = 16;

/// Tuning (empirical).
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct Tuning {
    pub frames: usize,
    pub noise: f32,
    pub age_noise: f32,
    pub hermite: f32,
    pub hermite4: f32,
    pub tolerance: f32,
}

impl Default for Tuning {
    fn default() -> Self {
        Self { frames: 16, noise: 1e-3, age_noise: 0.0, hermite: 1.0, hermite4: 0.5, tolerance: 0.02 }
    }
}

/// One remembered LR frame.
#[derive(Clone, Debug)]
struct Past {
    camera: Camera,
    frame: SampleFrame,
    landings: Vec<Landing>,
    reaches: Vec<Reach>,
}

/// Super-samples a sequence of jittered LR frames on the HR grid.
#[derive(Debug)]
pub struct SuperSampler {
    scale: u32,
    /// The last frames, newest first.
    past: Vec<Past>,
    surface: Surface,
    invalid: Option<ResetReason>,
    level: Level,
    #[doc(hidden)]
    pub tuning: Tuning,
}

impl SuperSampler {
    /// A super sampler of `scale` (1 to [`crate::MAX_SCALE`]) without history.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if `scale` is not supported.
    pub fn new(scale: u32) -> Result<Self, ReconstructError> {
        check_scale(scale)?;
        let tuning = Tuning { frames: (scale * scale) as usize, ..Tuning::default() };
        Ok(Self {
            scale,
            past: Vec::new(),
            surface: Surface::default(),
            invalid: Some(ResetReason::FirstFrame),
            level: Level::new(),
            tuning,
        })
    }

    /// Forgets the history. The next frame is reconstructed from itself alone.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// Why there is no history, if there is none.
    #[must_use]
    pub const fn history_invalid(&self) -> Option<ResetReason> {
        self.invalid
    }

    /// Reconstructs the image of `camera` from `gbuffer`, its LR frame, and the frames before it, into `out`, which is
    /// resized. The fourth channel becomes the confidence: the share, `[0, 1]`, that exact samples have in the pixel
    /// (the rest is interpolated from the current frame alone).
    ///
    /// `gbuffer` is what [`Camera::low_resolution`] of `camera` sees, with gradients and geometry, point-sampled at its
    /// jitter (`dilation` matched to the scale).
    ///
    /// # Errors
    /// [`ReconstructError`] if `gbuffer` is not the LR frame of `camera` or lacks gradients or geometry.
    pub fn super_sample(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        let size = camera_size(camera);
        check_gbuffer(gbuffer, self.scale, size)?;
        if gbuffer.gradients.is_none() {
            return Err(ReconstructError::Missing { what: "image gradients" });
        }
        if gbuffer.geometry.is_none() {
            return Err(ReconstructError::Missing { what: "depth" });
        }
        if self.past.first().is_some_and(|newest| camera_size(&newest.camera) != size) {
            self.reset(ResetReason::SizeOrTierChange);
        }
        if self.invalid.take().is_some() {
            self.past.clear();
        }
        self.remember(camera, gbuffer)?;
        self.land(camera, size);
        out.resize(size.0, size.1);
        self.accumulate(size, out);
        Ok(())
    }

    /// Takes the current frame into the history, as its newest.
    fn remember(&mut self, camera: &Camera, gbuffer: &GBuffer) -> Result<(), ReconstructError> {
        let mut newest = if self.past.len() >= self.tuning.frames.max(1) { self.past.pop() } else { None }
            .unwrap_or_else(|| Past {
                camera: *camera,
                frame: SampleFrame::default(),
                landings: Vec::new(),
                reaches: Vec::new(),
            });
        newest.camera = *camera;
        newest.frame.fill(gbuffer, self.scale)?;
        self.surface.set(&newest.frame, gbuffer, self.scale);
        let (width, height) = (newest.frame.width, newest.frame.height);
        newest.landings.resize(width * height, Landing::default());
        newest.reaches.resize(width.div_ceil(CHUNK) * height, Reach { first: 0.0, last: 0.0 });
        self.past.insert(0, newest);
        Ok(())
    }

    /// Reprojects all samples to the current camera.
    fn land(&mut self, camera: &Camera, size: (usize, usize)) {
        let (scale, tuning, level) = (self.scale as f32, self.tuning, self.level);
        // The newest frame's samples are where they are; the occlusion test reads them.
        let current = self.past[0].frame.clone();
        let occlusion = Occlusion { frame: &current, scale, tolerance: tuning.tolerance };
        self.past.par_iter_mut().enumerate().for_each(|(age, past)| {
            let reprojection = Reprojection::new(&past.camera, camera);
            let frame = &past.frame;
            let noise = tuning.noise + tuning.age_noise * age as f32;
            let landings = past.landings.par_chunks_exact_mut(frame.width);
            let reaches = past.reaches.par_chunks_exact_mut(frame.width.div_ceil(CHUNK));
            landings.zip(reaches).enumerate().with_min_len(16).for_each(|(row, (landings, reaches))| {
                dispatch!(level, simd => land_row(
                    simd, frame, row, &reprojection, scale, noise, &occlusion, size, landings, reaches
                ));
            });
        });
    }

    /// Combines the landed samples with the interpolated current frame.
    fn accumulate(&self, size: (usize, usize), out: &mut Image) {
        let width = size.0;
        out.pixels_mut().par_chunks_mut(BAND_ROWS * width).enumerate().for_each_init(
            || self.surface.scratch(),
            |scratch, (index, pixels)| {
                let band = Band { top: index * BAND_ROWS, width, pixels };
                dispatch!(self.level, simd => self.fill_band(simd, scratch, band));
            },
        );
    }

    #[inline(always)]
    fn fill_band<S: Simd>(&self, simd: S, scratch: &mut Cubics, mut band: Band<'_>) {
        let current = &self.past[0].frame;
        let scale = self.scale as usize;
        let top = band.top;
        for (r, row) in band.pixels.chunks_exact_mut(band.width).enumerate() {
            self.surface.row(simd, current, top + r, scratch, row);
            for (x, pixel) in row.iter_mut().enumerate() {
                let weight = self.surface_weight(x % scale, top + r);
                *pixel = pixel.map(|v| v * weight);
            }
        }
        for past in &self.past {
            let chunks_per_row = past.frame.width.div_ceil(CHUNK);
            for (k, reach) in past.reaches.iter().enumerate() {
                if band.meets(reach) {
                    let start = k / chunks_per_row * past.frame.width + k % chunks_per_row * CHUNK;
                    let end = (start + CHUNK).min((k / chunks_per_row + 1) * past.frame.width);
                    band.add(simd, &past.frame.samples[start..end], &past.landings[start..end]);
                }
            }
        }
        for (r, row) in band.pixels.chunks_exact_mut(band.width).enumerate() {
            for (x, pixel) in row.iter_mut().enumerate() {
                let reciprocal = 1.0 / pixel[3];
                let confidence = 1.0 - self.surface_weight(x % scale, top + r) * reciprocal;
                *pixel = pixel.map(|v| v * reciprocal);
                pixel[3] = confidence.max(0.0);
            }
        }
    }

    /// Weight of the interpolated current frame at a pixel.
    #[inline(always)]
    fn surface_weight(&self, phase: usize, y: usize) -> f32 {
        let (x_phases, y_axis) = self.surface.phases();
        let to_sample = |f: f32| f.min(1.0 - f) * self.scale as f32;
        let (dx, dy) = (to_sample(x_phases[phase].fraction), to_sample(y_axis.place(y).fraction));
        let d2 = dx * dx + dy * dy;
        let t = &self.tuning;
        1.0 / (t.noise + t.hermite * d2 * d2 / (1.0 + t.hermite4 * d2))
    }
}
