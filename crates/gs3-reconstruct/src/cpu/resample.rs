//! Classical interpolation of colour alone, with the jitter taken into account: the baselines of the field.

use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use crate::error::{ReconstructError, check_frame_of};
use crate::sample_grid::{GridPosition, SampleAxis};

/// A separable interpolation kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResampleKernel {
    /// The nearest sample.
    Nearest,
    /// Linear between two samples.
    Bilinear,
    /// Catmull–Rom: the cubic convolution of Keys 1981 with a = −½, four samples.
    Bicubic,
}

impl ResampleKernel {
    /// Weights of the samples −1, 0, 1, 2 around a place `f` ∈ `[0, 1)` between samples 0 and 1.
    fn weights(self, f: f32) -> [f32; 4] {
        match self {
            Self::Nearest if f < 0.5 => [0.0, 1.0, 0.0, 0.0],
            Self::Nearest => [0.0, 0.0, 1.0, 0.0],
            Self::Bilinear => [0.0, 1.0 - f, f, 0.0],
            Self::Bicubic => catmull_rom(f),
        }
    }
}

/// Catmull–Rom weights of the samples −1, 0, 1, 2 at `f` ∈ `[0, 1)` between samples 0 and 1.
#[inline(always)]
pub(crate) fn catmull_rom(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [-0.5 * f3 + f2 - 0.5 * f, 1.5 * f3 - 2.5 * f2 + 1.0, -1.5 * f3 + 2.0 * f2 + 0.5 * f, 0.5 * f3 - 0.5 * f2]
}

/// Enlarges the colour of `gbuffer` by `scale` into `out`, which has the output's size. Samples outside the LR frame
/// repeat its border. The fourth channel becomes 0.
///
/// # Errors
/// [`ReconstructError`] if `scale` is not supported, `out` is empty or `gbuffer` is not its LR frame.
pub fn resample(
    gbuffer: &GBuffer,
    scale: u32,
    kernel: ResampleKernel,
    out: &mut Image,
) -> Result<(), ReconstructError> {
    check_frame_of(out, gbuffer, scale)?;
    let (x_axis, y_axis) =
        (SampleAxis::new(scale, gbuffer.jitter[0]), SampleAxis::new(scale, gbuffer.jitter[1]));
    let width = out.width();
    out.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each_init(
        || vec![[0.0; 4]; gbuffer.width()],
        |column, (y, row)| {
            let GridPosition { index, fraction } = y_axis.position(y);
            let weights = kernel.weights(fraction);
            for c in 0..3 {
                let rows: [&[f32]; 4] = std::array::from_fn(|k| {
                    gbuffer.color.row(c, clamped(index - 1 + k as isize, gbuffer.height()))
                });
                for (x, value) in column.iter_mut().enumerate() {
                    value[c] = (0..4).map(|k| weights[k] * rows[k][x]).sum();
                }
            }
            for (x, pixel) in row.iter_mut().enumerate() {
                let GridPosition { index, fraction } = x_axis.position(x);
                let weights = kernel.weights(fraction);
                let taps: [[f32; 4]; 4] =
                    std::array::from_fn(|k| column[clamped(index - 1 + k as isize, column.len())]);
                *pixel = std::array::from_fn(|c| (0..4).map(|k| weights[k] * taps[k][c]).sum());
            }
        },
    );
    Ok(())
}

/// `index` clamped to `0..len`.
#[inline(always)]
pub(crate) fn clamped(index: isize, len: usize) -> usize {
    index.clamp(0, len as isize - 1) as usize
}
