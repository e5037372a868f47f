//! Gradient-aware tensor cubic Hermite interpolation of one LR frame.
//!
//! A cubic per axis passes through the values and the exact derivatives of the two samples around a pixel. The tensor
//! product also needs the mixed derivative. If the renderer gives none, it is estimated from the gradients of the
//! neighbours: ½ (Δx I_y + Δy I_x), as in UpscaleGS.

use std::ops::Range;

use fearless_simd::{Simd, dispatch, f32x4, f32x16, prelude::*};
use gs3_scene::{GBuffer, Gradients, Image};
use rayon::prelude::*;

use crate::cpu::lanes::repeat;
use crate::cpu::resample::clamped;
use crate::cpu::samples::rgb_rows;
use crate::cpu::tile_size::{PAD_X, SPAN, STRIDE};
use crate::error::{ReconstructError, check_frame_of};
use crate::sample_grid::{GridPosition, SampleAxis};

/// Enlarges `gbuffer` by `scale` into `out`, which has the output's size. Outside the LR frame the border colour
/// continues, constant. The fourth channel becomes 0.
///
/// # Errors
/// [`ReconstructError`] if `scale` is not supported, `out` is empty, or `gbuffer` is not its LR frame or has no
/// gradients.
pub fn hermite(gbuffer: &GBuffer, scale: u32, out: &mut Image) -> Result<(), ReconstructError> {
    check_frame_of(out, gbuffer, scale)?;
    let Some(gradients) = &gbuffer.gradients else {
        return Err(ReconstructError::Missing { what: "image gradients" });
    };
    let mut surface = Surface::default();
    surface.set(gbuffer, gradients, scale);
    let level = gs3_simd::level();
    let width = out.width();
    out.pixels_mut().par_chunks_exact_mut(width).enumerate().with_min_len(8).for_each(|(y, row)| {
        let (mut columns, mut part) = (Columns::new(), [[0.0; 4]; STRIDE]);
        for (left, out) in (0..).step_by(SPAN).zip(row.chunks_mut(SPAN)) {
            let pixels = left..left + out.len();
            let factors = [1.0; crate::MAX_SCALE as usize];
            dispatch!(level, simd => surface.row(simd, y, pixels, &factors, &mut columns, &mut part));
            for (to, [r, g, b, _]) in out.iter_mut().zip(&part[PAD_X..]) {
                *to = [*r, *g, *b, 0.0];
            }
        }
    });
    Ok(())
}

/// The surface through the samples of a frame. Derivatives are per HR pixel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surface {
    width: usize,
    height: usize,
    /// RGB, 1: `[height, width]`.
    color: Vec<[f32; 4]>,
    /// ∂RGB/∂x, 0: `[height, width]`.
    dx: Vec<[f32; 4]>,
    /// ∂RGB/∂y, 0: `[height, width]`.
    dy: Vec<[f32; 4]>,
    /// ∂²RGB/∂x∂y, 0: `[height, width]`.
    mixed: Vec<[f32; 4]>,
    scale: f32,
    x_axis: SampleAxis,
    y_axis: SampleAxis,
    /// The first pixel of cell 0, between samples 0 and 1. The other cells follow, `scale` pixels each.
    x_first: isize,
    /// Weights of `[value₀, slope₀, value₁, slope₁]` for the pixels of a cell, from its first pixel on.
    x_weights: Vec<[f32; 4]>,
}

/// Cubics along x: value and slope at each LR column that a row of a tile needs.
#[derive(Clone, Debug)]
pub(crate) struct Columns {
    values: [[f32; 4]; SPAN + 1],
    slopes: [[f32; 4]; SPAN + 1],
}

impl Columns {
    pub const fn new() -> Self {
        Self { values: [[0.0; 4]; SPAN + 1], slopes: [[0.0; 4]; SPAN + 1] }
    }
}

impl Surface {
    /// Computes the surface through the samples of `gbuffer` with the gradients `gradients`. Memory is reused.
    pub fn set(&mut self, gbuffer: &GBuffer, gradients: &Gradients, scale: u32) {
        self.scale = scale as f32;
        (self.width, self.height) = (gbuffer.width(), gbuffer.height());
        self.x_axis.set(scale, gbuffer.jitter[0]);
        self.y_axis.set(scale, gbuffer.jitter[1]);
        // Fractions grow along a cell.
        let phases = self.x_axis.phases().iter().enumerate();
        let first = phases.min_by(|(_, a), (_, b)| a.fraction.total_cmp(&b.fraction));
        let (phase, place) =
            first.map_or((0, GridPosition { index: 0, fraction: 0.0 }), |(phase, place)| (phase, *place));
        self.x_first = phase as isize - place.index * scale as isize;
        self.x_weights.clear();
        for k in 0..scale as usize {
            let place = self.x_axis.position(phase + k);
            self.x_weights.push(weights(place.fraction, self.scale));
        }
        let (width, per_pixel) = (self.width, 1.0 / self.scale);
        let of_size = |entries: &mut Vec<[f32; 4]>| entries.resize(width * gbuffer.height(), [0.0; 4]);
        [&mut self.color, &mut self.dx, &mut self.dy, &mut self.mixed].into_iter().for_each(of_size);
        let rows = self.color.par_chunks_exact_mut(width).zip(self.dx.par_chunks_exact_mut(width));
        let rows = rows.zip(self.dy.par_chunks_exact_mut(width)).zip(self.mixed.par_chunks_exact_mut(width));
        rows.enumerate().with_min_len(8).for_each(|(y, (((color, dx), dy), mixed))| {
            interleave(rgb_rows(&gbuffer.color, y), 1.0, 1.0, color);
            interleave(rgb_rows(&gradients.color_dx, y), per_pixel, 0.0, dx);
            interleave(rgb_rows(&gradients.color_dy, y), per_pixel, 0.0, dy);
            match &gradients.color_dxy {
                Some(planes) => interleave(rgb_rows(planes, y), per_pixel * per_pixel, 0.0, mixed),
                None => estimate_mixed(gradients, per_pixel * per_pixel, y, mixed),
            }
        });
    }

    /// The places of the pixels of a cell along x, from its first pixel on.
    pub fn x_fractions(&self) -> impl Iterator<Item = f32> {
        (0..self.x_weights.len()).map(|k| {
            self.x_axis.position(self.x_first.rem_euclid(self.x_weights.len() as isize) as usize + k).fraction
        })
    }

    /// The place of HR row `y`.
    pub fn y_place(&self, y: usize) -> GridPosition {
        self.y_axis.position(y)
    }

    /// Interpolates `pixels`, at most [`SPAN`], of HR row `y` into `out` from [`PAD_X`] on: RGB and 1, times the
    /// pixel's entry in `factors`, which has one entry per pixel of a cell. Values of `out` around these pixels are
    /// unspecified afterwards.
    #[inline(always)]
    pub fn row<S: Simd>(
        &self,
        simd: S,
        y: usize,
        pixels: Range<usize>,
        factors: &[f32; crate::MAX_SCALE as usize],
        columns: &mut Columns,
        out: &mut [[f32; 4]],
    ) {
        /// Pixels of a vector.
        const QUAD: usize = 4;
        let scale = self.x_weights.len();
        let [first, last] = [pixels.start, pixels.end - 1].map(|x| self.x_axis.position(x).index);
        let count = (last - first) as usize + 1;
        self.blend_rows(simd, y, first, &mut columns.values[..=count], &mut columns.slopes[..=count]);
        let mut weights = [[[0.0; 4 * QUAD]; 4]; crate::MAX_SCALE as usize / QUAD];
        for (k, (taps, factor)) in self.x_weights.iter().zip(factors).enumerate() {
            for (weights, tap) in weights[k / QUAD].iter_mut().zip(taps) {
                weights[4 * (k % QUAD)..][..4].fill(tap * factor);
            }
        }
        // Place in `out` of the first pixel of a cell. Pixels of the first cell may lie before the first wanted
        // pixel.
        let start = self.x_first + first * scale as isize - pixels.start as isize + PAD_X as isize;
        for cell in 0..count {
            let [v0, v1] = [&columns.values[cell], &columns.values[cell + 1]];
            let [s0, s1] = [&columns.slopes[cell], &columns.slopes[cell + 1]];
            let (v0, v1) = (repeat(simd, v0), repeat(simd, v1));
            let (s0, s1) = (repeat(simd, s0), repeat(simd, s1));
            for (group, weights) in weights[..scale.div_ceil(QUAD)].iter().enumerate() {
                let weight = |k: usize| f32x16::load_array_ref(simd, &weights[k]);
                let value =
                    v0.mul_add(weight(0), s0.mul_add(weight(1), v1.mul_add(weight(2), s1 * weight(3))));
                // The last vector of a cell may be too long; the next cell overwrites the excess.
                let at = start as usize + cell * scale + group * QUAD;
                value.store_slice(out[at..at + QUAD].as_flattened_mut());
            }
        }
    }

    /// The cubics along x at the height of HR row `y`, from LR column `first` on. Beyond the border the nearest
    /// column is repeated, with slope 0 along x.
    #[inline(always)]
    fn blend_rows<S: Simd>(
        &self,
        simd: S,
        y: usize,
        first: isize,
        values: &mut [[f32; 4]],
        slopes: &mut [[f32; 4]],
    ) {
        let GridPosition { index, fraction } = self.y_axis.position(y);
        let mut weights = weights(fraction, self.scale);
        let [j0, j1] = [index, index + 1].map(|j| clamped(j, self.height));
        // Beyond the border the nearest row is repeated, with slope 0 along y.
        for (k, (j, inside)) in [(1, (index, j0)), (3, (index + 1, j1))] {
            if j != inside as isize {
                weights[k] = 0.0;
            }
        }
        // The columns inside the frame, and their places among the wanted columns: empty, if samples lie far beyond
        // their pixels.
        let [start, end] =
            [first, first + values.len() as isize].map(|i| i.clamp(0, self.width as isize) as usize);
        let before = (-first).clamp(0, values.len() as isize) as usize;
        let inside = before..before + (end - start);
        let rows = [j0, j1].map(|j| j * self.width);
        weighted_sum(simd, [&self.color, &self.dy], rows, start, &weights, &mut values[inside.clone()]);
        weighted_sum(simd, [&self.dx, &self.mixed], rows, start, &weights, &mut slopes[inside.clone()]);
        for (column, beyond) in [(0, 0..inside.start), (self.width - 1, inside.end..values.len())] {
            if !beyond.is_empty() {
                let mut border = [[0.0; 4]];
                weighted_sum(simd, [&self.color, &self.dy], rows, column, &weights, &mut border);
                values[beyond.clone()].fill(border[0]);
                slopes[beyond].fill([0.0; 4]);
            }
        }
    }
}

/// Σ weight · entry over values and slopes in two rows, which begin at `rows`, from column `start` on.
#[inline(always)]
fn weighted_sum<S: Simd>(
    simd: S,
    [values, slopes]: [&[[f32; 4]]; 2],
    rows: [usize; 2],
    start: usize,
    weights: &[f32; 4],
    out: &mut [[f32; 4]],
) {
    /// Entries of a vector.
    const QUAD: usize = 4;
    let [upper, lower] = rows.map(|row| row + start..row + start + out.len());
    let (a, b) = (&values[upper.clone()], &slopes[upper]);
    let (c, d) = (&values[lower.clone()], &slopes[lower]);
    let weight = |k: usize| f32x16::splat(simd, weights[k]);
    let (w0, w1, w2, w3) = (weight(0), weight(1), weight(2), weight(3));
    let at = |term: &[[f32; 4]], k: usize| f32x16::from_slice(simd, term[k..k + QUAD].as_flattened());
    let whole = out.len() - out.len() % QUAD;
    for k in (0..whole).step_by(QUAD) {
        let sum = at(a, k).mul_add(w0, at(b, k).mul_add(w1, at(c, k).mul_add(w2, at(d, k) * w3)));
        sum.store_slice(out[k..k + QUAD].as_flattened_mut());
    }
    for k in whole..out.len() {
        let at = |term: &[[f32; 4]]| f32x4::load_array_ref(simd, &term[k]);
        let weight = |k: usize| f32x4::splat(simd, weights[k]);
        let sum = at(c).mul_add(weight(2), at(d) * weight(3));
        out[k] = at(a).mul_add(weight(0), at(b).mul_add(weight(1), sum)).to_array();
    }
}

/// Weights of `[value₀, slope₀, value₁, slope₁]` at `f` ∈ `[0, 1)` between two samples `spacing` apart.
fn weights(f: f32, spacing: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [2.0 * f3 - 3.0 * f2 + 1.0, spacing * (f3 - 2.0 * f2 + f), 3.0 * f2 - 2.0 * f3, spacing * (f3 - f2)]
}

/// RGB times `factor`, and `last`.
fn interleave([r, g, b]: [&[f32]; 3], factor: f32, last: f32, row: &mut [[f32; 4]]) {
    for (i, pixel) in row.iter_mut().enumerate() {
        *pixel = [r[i] * factor, g[i] * factor, b[i] * factor, last];
    }
}

/// ½ (Δx I_y + Δy I_x) of LR row `y` by central differences, one-sided at the border, times `factor`.
fn estimate_mixed(gradients: &Gradients, factor: f32, y: usize, row: &mut [[f32; 4]]) {
    let Gradients { color_dx, color_dy, .. } = gradients;
    let (width, height) = (color_dx.width(), color_dx.height());
    let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
    let per = |from: usize, to: usize| if to > from { 0.5 * factor / (to - from) as f32 } else { 0.0 };
    let y_factor = per(above, below);
    let (a, b, dy) = (rgb_rows(color_dx, above), rgb_rows(color_dx, below), rgb_rows(color_dy, y));
    for (i, pixel) in row.iter_mut().enumerate() {
        let (left, right) = (i.saturating_sub(1), (i + 1).min(width - 1));
        let x_factor = per(left, right);
        for c in 0..3 {
            pixel[c] = y_factor * (b[c][i] - a[c][i]) + x_factor * (dy[c][right] - dy[c][left]);
        }
    }
}
