//! Gradient-aware tensor cubic Hermite interpolation of one LR frame.
//!
//! A cubic per axis through the values and the exact derivatives of the two samples around a pixel; the tensor product
//! needs the mixed derivative as well, which is estimated from the gradients of the neighbours where it was not
//! rendered: ½ (Δx I_y + Δy I_x), as in UpscaleGS.

use fearless_simd::{Level, Simd, dispatch, f32x4, prelude::*};
use gs3_scene::{GBuffer, Image, Planes};
use rayon::prelude::*;

use crate::error::{ReconstructError, check_gbuffer, check_scale, image_size};
use crate::lattice::{Axis, Place};
use crate::resample::clamped;
use crate::samples::{SampleFrame, rgb_rows};

/// Samples repeated on each side of a row: jitter of one LR pixel reaches two samples out.
const PAD: usize = 2;

/// Enlarges `gbuffer` by `scale` into `out`, whose size says how large. Outside the LR frame the border colour goes on,
/// flat. The fourth channel becomes 0.
///
/// # Errors
/// [`ReconstructError`] if `scale` is not supported, or `gbuffer` is not the LR frame of `out` or has no gradients.
pub fn hermite(gbuffer: &GBuffer, scale: u32, out: &mut Image) -> Result<(), ReconstructError> {
    check_scale(scale)?;
    check_gbuffer(gbuffer, scale, image_size(out))?;
    let mut frame = SampleFrame::default();
    frame.fill(gbuffer, scale)?;
    let mut surface = Surface::default();
    surface.set(&frame, gbuffer, scale);
    let width = out.width();
    let level = Level::new();
    out.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each_init(
        Cubics::default,
        |scratch, (y, row)| {
            dispatch!(level, simd => surface.row(simd, &frame, y, &[1.0; crate::MAX_SCALE as usize], scratch, row));
            for pixel in row {
                pixel[3] = 0.0;
            }
        },
    );
    Ok(())
}

/// What interpolation needs beyond the samples: the mixed derivative and where HR pixels lie.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surface {
    /// ∂²RGB/∂x∂y per HR pixel², 0: `[height, width]`.
    mixed: Vec<[f32; 4]>,
    scale: f32,
    x_axis: Axis,
    y_axis: Axis,
    /// Weights of `[value₀, slope₀, value₁, slope₁]` for each phase along x.
    x_weights: Vec<[f32; 4]>,
}

/// One row of cubics along x: value and slope at each LR column, `PAD` columns repeated at each side.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cubics {
    values: Vec<[f32; 4]>,
    slopes: Vec<[f32; 4]>,
}

impl Surface {
    /// Makes this the surface through `frame`, the samples of `gbuffer`, reusing memory.
    pub fn set(&mut self, frame: &SampleFrame, gbuffer: &GBuffer, scale: u32) {
        self.scale = scale as f32;
        self.x_axis.set(scale, frame.jitter[0]);
        self.y_axis.set(scale, frame.jitter[1]);
        self.x_weights.clear();
        self.x_weights.extend(self.x_axis.phases().iter().map(|place| weights(place.fraction, self.scale)));
        let (width, height) = (frame.width, frame.height);
        self.mixed.resize(width * height, [0.0; 4]);
        let given = gbuffer.gradients.as_ref().and_then(|g| g.color_dxdy.as_ref());
        self.mixed.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| match given {
            Some(planes) => interleave(planes, y, 1.0 / (self.scale * self.scale), row),
            None => estimate_mixed(frame, self.scale, y, row),
        });
    }

    /// The places of the pixels of one period along x.
    pub fn x_phases(&self) -> &[Place] {
        self.x_axis.phases()
    }

    /// The place of HR row `y`.
    pub fn y_place(&self, y: usize) -> Place {
        self.y_axis.place(y)
    }

    /// Interpolates HR row `y` into `out`, `[HR width]`: RGB and 1, times the pixel's entry in `factors`, which holds one
    /// for each pixel of a period.
    #[inline(always)]
    pub fn row<S: Simd>(
        &self,
        simd: S,
        frame: &SampleFrame,
        y: usize,
        factors: &[f32; crate::MAX_SCALE as usize],
        cubics: &mut Cubics,
        out: &mut [[f32; 4]],
    ) {
        self.blend_rows(simd, frame, y, cubics);
        let scale = self.x_weights.len();
        for (phase, (place, weights)) in self.x_axis.phases().iter().zip(&self.x_weights).enumerate() {
            let [w0, w1, w2, w3] = weights.map(|w| f32x4::splat(simd, w * factors[phase]));
            // Cell −2 is the first that jitter of one LR pixel can reach.
            let first = PAD.wrapping_add_signed(place.index);
            let cells = cubics.values[first..].windows(2).zip(cubics.slopes[first..].windows(2));
            for (pixel, (values, slopes)) in out.iter_mut().skip(phase).step_by(scale).zip(cells) {
                let [v0, v1] = [0, 1].map(|k| f32x4::load_array(simd, values[k]));
                let [s0, s1] = [0, 1].map(|k| f32x4::load_array(simd, slopes[k]));
                let value = v0.mul_add(w0, s0.mul_add(w1, v1.mul_add(w2, s1 * w3)));
                *pixel = value.to_array();
            }
        }
    }

    /// The cubics along x at the height of HR row `y`.
    #[inline(always)]
    fn blend_rows<S: Simd>(&self, simd: S, frame: &SampleFrame, y: usize, cubics: &mut Cubics) {
        let Place { index, fraction } = self.y_axis.place(y);
        let mut weights = weights(fraction, self.scale);
        let [j0, j1] = [index, index + 1].map(|j| clamped(j, frame.height));
        // Beyond the border the nearest row is repeated, flat across.
        for (k, (j, inside)) in [(1, (index, j0)), (3, (index + 1, j1))] {
            if j != inside as isize {
                weights[k] = 0.0;
            }
        }
        let [w0, w1, w2, w3] = weights.map(|w| f32x4::splat(simd, w));
        let width = frame.width;
        cubics.values.resize(width + 2 * PAD, [0.0; 4]);
        cubics.slopes.resize(width + 2 * PAD, [0.0; 4]);
        let [row0, row1] = [j0, j1].map(|j| &frame.samples[j * width..][..width]);
        let [mixed0, mixed1] = [j0, j1].map(|j| &self.mixed[j * width..][..width]);
        let values = &mut cubics.values[PAD..][..width];
        let slopes = &mut cubics.slopes[PAD..][..width];
        for i in 0..width {
            let load = |v: &[f32; 4]| f32x4::load_array_ref(simd, v);
            let (a, b) = (&row0[i], &row1[i]);
            let value = load(&a.color)
                .mul_add(w0, load(&a.dy).mul_add(w1, load(&b.color).mul_add(w2, load(&b.dy) * w3)));
            let slope = load(&a.dx)
                .mul_add(w0, load(&mixed0[i]).mul_add(w1, load(&b.dx).mul_add(w2, load(&mixed1[i]) * w3)));
            values[i] = value.to_array();
            slopes[i] = slope.to_array();
        }
        let (first, last) = (cubics.values[PAD], cubics.values[PAD + width - 1]);
        cubics.values[..PAD].fill(first);
        cubics.values[PAD + width..].fill(last);
        cubics.slopes[..PAD].fill([0.0; 4]);
        cubics.slopes[PAD + width..].fill([0.0; 4]);
    }
}

/// Weights of `[value₀, slope₀, value₁, slope₁]` at `f` ∈ `[0, 1)` between two samples `spacing` apart.
fn weights(f: f32, spacing: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [2.0 * f3 - 3.0 * f2 + 1.0, spacing * (f3 - 2.0 * f2 + f), 3.0 * f2 - 2.0 * f3, spacing * (f3 - f2)]
}

fn interleave(planes: &Planes<3>, y: usize, factor: f32, row: &mut [[f32; 4]]) {
    let [r, g, b] = rgb_rows(planes, y);
    for (i, pixel) in row.iter_mut().enumerate() {
        *pixel = [r[i] * factor, g[i] * factor, b[i] * factor, 0.0];
    }
}

/// ½ (Δx I_y + Δy I_x) of LR row `y` by central differences, one-sided at the border.
fn estimate_mixed(frame: &SampleFrame, scale: f32, y: usize, row: &mut [[f32; 4]]) {
    let (width, height) = (frame.width, frame.height);
    let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
    // Samples are `scale` HR pixels apart, and derivatives are per HR pixel.
    let per = |from: usize, to: usize| if to > from { 0.5 / ((to - from) as f32 * scale) } else { 0.0 };
    let y_factor = per(above, below);
    for (i, pixel) in row.iter_mut().enumerate() {
        let (left, right) = (i.saturating_sub(1), (i + 1).min(width - 1));
        let x_factor = per(left, right);
        let (a, b) = (&frame.samples[above * width + i].dx, &frame.samples[below * width + i].dx);
        let (c, d) = (&frame.samples[y * width + left].dy, &frame.samples[y * width + right].dy);
        *pixel = std::array::from_fn(|k| y_factor * (b[k] - a[k]) + x_factor * (d[k] - c[k]));
    }
}
