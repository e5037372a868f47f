//! The best linear map from the neighbourhood of an LR sample, gradients included, to its HR block, in closed form.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_raster::Outputs;
use gs3_scene::{GBuffer, Gradients, Image};
use rayon::prelude::*;

use super::lattice::{LANES, PAD, Padded, PhaseRow};
use super::{UpscaleError, Upscaler, check_size};

/// A linear map, one for all three channels, from the 3×3 block of (I, I<sub>x</sub>, I<sub>y</sub>) around an LR
/// sample to the S×S block of HR pixels in it: what one convolution with pixel shuffle can do at most without a
/// nonlinearity.
///
/// It maps differences to the centre sample to differences from it (8 colours and 18 gradients to S² values), so
/// constant images stay constant.
#[derive(Clone, Debug)]
pub struct RidgeMap {
    scale: u32,
    /// `[S², FEATURES]`.
    weights: Vec<f32>,
    color: Padded,
    color_dx: Padded,
    color_dy: Padded,
}

/// Why no map could be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RidgeError {
    /// There is nothing to fit to.
    #[error("ridge map: expected at least 1 training frame, found 0")]
    NoFrames,
    /// A training frame does not suit.
    #[error(transparent)]
    Frame(#[from] UpscaleError),
    /// The training frames do not determine the map.
    #[error("ridge map: expected training frames with content, found a singular system")]
    Singular,
}

const NAME: &str = "ridge";
/// Neighbours of the centre sample in the 3×3 block.
const NEIGHBORS: [(isize, isize); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
const FEATURES: usize = 8 + 9 + 9;
/// Ridge term relative to the mean of the normal matrix's diagonal. Empirical: below it the fit does not change, far
/// above it loses; it only keeps flat training frames from a singular system.
const RIDGE: f64 = 1e-7;

impl RidgeMap {
    /// Fits the map that turns the LR frames into their HR images, `scale` times as large, with the least squared
    /// error.
    ///
    /// # Errors
    /// [`RidgeError`] if there is no frame, one does not suit, or they have no content.
    pub fn fit(frames: &[(&GBuffer, &Image)], scale: u32) -> Result<Self, RidgeError> {
        let targets = (scale * scale) as usize;
        let mut normal = Normal::new(targets);
        for (lr, hr) in frames {
            let gradients = check(lr, scale, hr)?;
            let rows: Vec<Normal> = (0..lr.height())
                .into_par_iter()
                .map(|y| Normal::of_row(lr, gradients, hr, scale as usize, y))
                .collect();
            rows.iter().for_each(|row| normal.add(row));
        }
        if frames.is_empty() {
            return Err(RidgeError::NoFrames);
        }
        let weights = normal.solve().ok_or(RidgeError::Singular)?;
        let empty = Padded::default;
        Ok(Self { scale, weights, color: empty(), color_dx: empty(), color_dy: empty() })
    }
}

/// Checks that the frame has the right size, gradients and no jitter.
fn check<'a>(lr: &'a GBuffer, scale: u32, hr: &Image) -> Result<&'a Gradients, UpscaleError> {
    check_size(lr, scale, hr)?;
    if lr.jitter != [0.0; 2] {
        return Err(UpscaleError::Jitter { method: NAME, actual: lr.jitter });
    }
    lr.gradients.as_ref().ok_or(UpscaleError::NoGradients { method: NAME })
}

impl Upscaler for RidgeMap {
    fn outputs(&self) -> Outputs {
        Outputs::Samples
    }

    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale != self.scale {
            return Err(UpscaleError::Scale { method: NAME, expected: self.scale, actual: scale });
        }
        let gradients = check(lr, scale, out)?;
        self.color.fill(&lr.color, |v| v);
        self.color_dx.fill(&gradients.color_dx, |v| v);
        self.color_dy.fill(&gradients.color_dy, |v| v);
        let scale = scale as usize;
        let width = out.width();
        let this = &*self;
        let level = gs3_simd::level();
        out.pixels_mut().par_chunks_exact_mut(scale * width).enumerate().for_each_init(
            || vec![PhaseRow::new(this.scale, &this.color); scale],
            |phase_rows, (y, rows)| {
                dispatch!(level, simd => this.rows(simd, y as isize, phase_rows));
                for (phase_row, row) in phase_rows.iter().zip(rows.chunks_exact_mut(width)) {
                    phase_row.interleave(row);
                }
            },
        );
        Ok(())
    }
}

impl RidgeMap {
    /// The S HR rows of LR row `y`.
    #[inline(always)]
    fn rows<S: Simd>(&self, simd: S, y: isize, out: &mut [PhaseRow]) {
        let scale = out.len();
        for c in 0..3 {
            for block in 0..self.color.blocks() {
                let at = PAD + block * LANES;
                let centre = f32x16::from_slice(simd, &self.color.row(c, y)[at..at + LANES]);
                let mut features = [f32x16::splat(simd, 0.0); FEATURES];
                for (i, (dx, dy)) in NEIGHBORS.into_iter().enumerate() {
                    let start = at.wrapping_add_signed(dx);
                    features[i] =
                        f32x16::from_slice(simd, &self.color.row(c, y + dy)[start..start + LANES]) - centre;
                }
                for (planes, first) in [(&self.color_dx, 8), (&self.color_dy, 17)] {
                    for i in 0..9 {
                        let start = at + i % 3 - 1;
                        let row = planes.row(c, y + (i / 3) as isize - 1);
                        features[first + i] = f32x16::from_slice(simd, &row[start..start + LANES]);
                    }
                }
                for (target, weights) in self.weights.chunks_exact(FEATURES).enumerate() {
                    let mut sum = centre;
                    for (feature, weight) in features.iter().zip(weights) {
                        sum = feature.mul_add(*weight, sum);
                    }
                    sum.store_slice(out[target / scale].block(c, target % scale, block));
                }
            }
        }
    }
}

/// The normal equations AᵀA W = AᵀB.
struct Normal {
    targets: usize,
    /// AᵀA, `[FEATURES, FEATURES]`.
    gram: Vec<f64>,
    /// AᵀB, `[FEATURES, targets]`.
    moments: Vec<f64>,
}

impl Normal {
    fn new(targets: usize) -> Self {
        Self { targets, gram: vec![0.0; FEATURES * FEATURES], moments: vec![0.0; FEATURES * targets] }
    }

    fn add(&mut self, other: &Self) {
        self.gram.iter_mut().zip(&other.gram).for_each(|(a, b)| *a += b);
        self.moments.iter_mut().zip(&other.moments).for_each(|(a, b)| *a += b);
    }

    /// The equations of LR row `y`, border columns left out (their neighbourhood is repeated, not seen).
    fn of_row(lr: &GBuffer, gradients: &Gradients, hr: &Image, scale: usize, y: usize) -> Self {
        let mut normal = Self::new(scale * scale);
        if y == 0 || y + 1 >= lr.height() {
            return normal;
        }
        let mut features = [0.0f64; FEATURES];
        let mut targets = vec![0.0f64; scale * scale];
        for x in 1..lr.width().saturating_sub(1) {
            for c in 0..3 {
                let centre = lr.color.row(c, y)[x];
                for (feature, (dx, dy)) in features.iter_mut().zip(NEIGHBORS) {
                    let row = lr.color.row(c, y.wrapping_add_signed(dy));
                    *feature = f64::from(row[x.wrapping_add_signed(dx)] - centre);
                }
                for (planes, first) in [(&gradients.color_dx, 8), (&gradients.color_dy, 17)] {
                    for i in 0..9 {
                        features[first + i] = f64::from(planes.row(c, y + i / 3 - 1)[x + i % 3 - 1]);
                    }
                }
                for (i, target) in targets.iter_mut().enumerate() {
                    let pixel = hr.row(y * scale + i / scale)[x * scale + i % scale];
                    *target = f64::from(pixel[c] - centre);
                }
                normal.observe(&features, &targets);
            }
        }
        normal
    }

    fn observe(&mut self, features: &[f64; FEATURES], targets: &[f64]) {
        for (i, feature) in features.iter().enumerate() {
            let gram = &mut self.gram[i * FEATURES..(i + 1) * FEATURES];
            gram.iter_mut().zip(features).for_each(|(g, f)| *g += feature * f);
            let moments = &mut self.moments[i * self.targets..(i + 1) * self.targets];
            moments.iter_mut().zip(targets).for_each(|(m, t)| *m += feature * t);
        }
    }

    /// The weights, `[targets, FEATURES]`, by Cholesky decomposition. None if the system is singular.
    fn solve(mut self) -> Option<Vec<f32>> {
        let n = FEATURES;
        let mean = (0..n).map(|i| self.gram[i * n + i]).sum::<f64>() / n as f64;
        // Row by row: gram becomes the lower factor.
        for i in 0..n {
            self.gram[i * n + i] += RIDGE * mean;
            for j in 0..=i {
                let dot: f64 = (0..j).map(|k| self.gram[i * n + k] * self.gram[j * n + k]).sum();
                let rest = self.gram[i * n + j] - dot;
                self.gram[i * n + j] = if i == j { rest.sqrt() } else { rest / self.gram[j * n + j] };
            }
            let pivot = self.gram[i * n + i];
            if !(pivot.is_finite() && pivot > 0.0) {
                return None;
            }
        }
        let lower = |i: usize, j: usize| self.gram[i * n + j];
        let mut weights = vec![0.0f32; self.targets * n];
        for (target, weights) in weights.chunks_exact_mut(n).enumerate() {
            let mut solution: Vec<f64> = (0..n).map(|i| self.moments[i * self.targets + target]).collect();
            for i in 0..n {
                let dot: f64 = (0..i).map(|k| lower(i, k) * solution[k]).sum();
                solution[i] = (solution[i] - dot) / lower(i, i);
            }
            for i in (0..n).rev() {
                let dot: f64 = (i + 1..n).map(|k| lower(k, i) * solution[k]).sum();
                solution[i] = (solution[i] - dot) / lower(i, i);
            }
            weights.iter_mut().zip(solution).for_each(|(w, s)| *w = s as f32);
        }
        Some(weights)
    }
}
