//! Rectification: the current frame decides whether past samples are still visible, and still true.
//!
//! A past sample is wrong in three cases: (1) something hides it now; (2) another surface gave it its colour
//! (reflections, translucent layers); (3) its colour depends on the view. Depth shows the first case, and colour the
//! other two. Within a cell of four current samples, colours outside the range of their first-order extrapolations
//! are unlikely. This range is the neighbourhood clamp of temporal anti-aliasing (Karis 2014, FSR 2), with exact
//! gradients instead of neighbours, and a weight instead of a clamp. Where the current samples predict each other
//! well, a slow drift of colour stays within the range. There, past samples count less than the current frame alone,
//! and still less, the farther the view has turned since.

use fearless_simd::{Level, Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3_scene::{GBuffer, Gradients, Planes};
use rayon::prelude::*;

use crate::cpu::lanes::{load, look_up_four};
use crate::cpu::samples::CHUNK;
use crate::reprojection::inverse_depth_16;

/// A depth may exceed the farthest current depth, or the nearest of all samples, by this share: 2 % is the usual
/// tolerance of reprojection.
pub(crate) const DEPTH_TOLERANCE: f32 = 0.02;

/// How far a cell's samples are extrapolated for the range of plausible colours, in sample spacings. At half a cell
/// the extrapolations of two neighbours meet; half as much again is for curvature. (Empirical: 0.5 loses up to 0.19
/// dB, 1 gains up to 0.08.)
pub(crate) const EXTRAPOLATION: f32 = 0.75;

/// Variance (pixel⁴) of a sample with a colour off by the whole range (empirical: 30 to 300 are alike).
pub(crate) const MISMATCH: f32 = 100.0;

/// How far colours may drift with the view, per pixel of staleness, if nothing in the current frame contradicts them:
/// for glossy and translucent surfaces (empirical: 0.002 to 0.004 are alike).
pub(crate) const DRIFT: f32 = 0.004;

/// Added to squared errors of the current samples' predictions of each other: errors below 1/4096, a sixteenth of a step of 8-bit displays, count as none. The
/// largest gain of drift is then [`DRIFT`]² over this, 267 pixel⁴ per squared pixel of staleness.
pub(crate) const ERROR_FLOOR: f32 = 6e-8;

/// Added to the squared extent of a cell's range, so that rounding alone does not make a sample implausible where the
/// colour is constant. Range and sample are off by at most 4·2⁻²⁴ of colours up to 1, squared over three channels 1.7e-13.
/// [`MISMATCH`] over this makes 1.7e-5 pixel⁴ of it, about [`NOISE`](crate::cpu::tile::NOISE). (Halves of a GPU's history
/// are off by up to 2⁻¹², which makes up to 18 pixel⁴: there the samples of a constant colour may lose their weight once
/// they move. The surface has that colour.)
pub(crate) const EXTENT_FLOOR: f32 = 1e-6;

/// Variance of a sample that is hidden now: useless as soon as it has moved a fraction of a pixel. At rest a sample
/// cannot have become hidden; it lies in a gap between the current samples.
pub(crate) const HIDDEN: f32 = 1e4;

const LANES: usize = CHUNK;

/// Number of values per cell.
const VALUES: usize = 8;
/// Index of the middle of the range of plausible red; green and blue follow.
const MIDDLE: usize = 0;
/// Index of the smallest inverse depth that is not hidden.
const FARTHEST: usize = 3;
/// Index of half the extent of the range of red; green and blue follow.
const HALF: usize = 4;
/// Index of squared [`DRIFT`] over the squared error of the current samples' predictions of each other.
const DRIFT_GAIN: usize = 7;

/// Ranges of all cells: cell `(i, j)` lies between samples `i`, `i + 1` and `j`, `j + 1`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rectification {
    width: usize,
    /// Scale from `(x, y)` HR position to cell; `offset` is added afterwards.
    per_hr_pixel: f32,
    offset: [f32; 2],
    last: [f32; 2],
    /// `[LR height, LR width]`.
    cells: Vec<[f32; VALUES]>,
    /// Squared error, summed over the channels, of predicting a sample from its neighbours in the row and in the
    /// column: the larger of both. `[LR height, LR width]`.
    errors: Vec<f32>,
}

impl Rectification {
    /// Computes the ranges of `gbuffer`. Memory is reused. Samples are `scale` HR pixels apart.
    pub fn set(
        &mut self,
        level: Level,
        gbuffer: &GBuffer,
        gradients: &Gradients,
        depth: &Planes<1>,
        scale: u32,
    ) {
        let (width, height) = (gbuffer.width(), gbuffer.height());
        self.width = width;
        self.per_hr_pixel = 1.0 / scale as f32;
        // Positions are given with pixel centres at whole numbers.
        self.offset = gbuffer.jitter.map(|j| 0.5 * self.per_hr_pixel - 0.5 - j);
        self.last = [(width - 1) as f32, (height - 1) as f32];
        self.errors.resize(width * height, 0.0);
        let errors = self.errors.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        errors.for_each(|(j, errors)| dispatch!(level, simd => predict(simd, gbuffer, gradients, j, errors)));
        let errors = &self.errors;
        self.cells.resize(width * height, [0.0; VALUES]);
        let rows = self.cells.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        // One more value at the end, so that the column after the last can be loaded.
        rows.for_each_init(
            || vec![0.0; VALUES * width + 1],
            |planes, (j, cells)| {
                let rows = [j, (j + 1).min(height - 1)];
                dispatch!(level, simd => {
                    join_rows(simd, &gbuffer.color, gradients, depth, errors, rows, planes);
                    join_columns(simd, width, planes);
                });
                for (i, cell) in cells.iter_mut().enumerate() {
                    *cell = std::array::from_fn(|k| planes[k * width + i]);
                }
            },
        );
    }

    /// The variances, in pixel⁴, that the current frame gives sixteen past samples. The samples have colours
    /// `colors`, and are seen now at HR positions `(x, y)`, pixel centres at whole numbers, with inverse depths `w`.
    /// Staleness is in pixels, and `change` is a possible change of their colour. Samples outside the frame use the
    /// nearest cells.
    #[inline(always)]
    pub fn variance<S: Simd>(
        &self,
        simd: S,
        [x, y, w]: [f32x16<S>; 3],
        colors: [&[f32; LANES]; 3],
        staleness: f32x16<S>,
        change: f32x16<S>,
    ) -> f32x16<S> {
        let (i, j) = (self.cell(simd, x, 0), self.cell(simd, y, 1));
        let at = (j * self.width as i32 + i).to_array();
        let [middle @ .., farthest] = look_up_four(simd, &self.cells, &at, MIDDLE);
        let [extent @ .., drift_gain] = look_up_four(simd, &self.cells, &at, HALF);
        let (mut sum, mut square) = (change * change, f32x16::splat(simd, 0.0));
        for c in 0..3 {
            let away = (f32x16::load_array_ref(simd, colors[c]) - middle[c]).abs();
            let outside = (away - extent[c]).max(0.0);
            sum = outside.mul_add(outside, sum);
            square = extent[c].mul_add(extent[c], square);
        }
        // A range's extent is twice its half extent, so the square is four times as large.
        let gain = f32x16::splat(simd, MISMATCH) / square.mul_add(4.0, f32x16::splat(simd, EXTENT_FLOOR));
        let variance = sum.mul_add(gain, drift_gain * (staleness * staleness));
        w.simd_lt(farthest).select(f32x16::splat(simd, HIDDEN), variance)
    }

    /// Along an axis, the cells of HR positions.
    #[inline(always)]
    fn cell<S: Simd>(&self, simd: S, x: f32x16<S>, axis: usize) -> i32x16<S> {
        let place = x.mul_add(self.per_hr_pixel, f32x16::splat(simd, self.offset[axis]));
        // NaN becomes 0.
        place.max_precise(0.0).min(self.last[axis]).floor().to_int()
    }
}

/// Index, among the planes of a row, of the ranges' lows and highs, before columns are joined.
const LOW: usize = MIDDLE;
const HIGH: usize = HALF;

/// Finds how well cubic Hermite curves between neighbours predict the samples of row `j`.
#[inline(always)]
fn predict<S: Simd>(simd: S, gbuffer: &GBuffer, gradients: &Gradients, j: usize, errors: &mut [f32]) {
    let (width, height) = (errors.len(), gbuffer.height());
    // The column's three samples around row `j`; at an end, the nearest three. With fewer rows, the row's error is
    // used alone.
    let above = j.saturating_sub(1).min(height.saturating_sub(3));
    let below = (above + 2).min(height - 1);
    for first in (0..width).step_by(LANES) {
        let count = LANES.min(width - first);
        let (mut across, mut down) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 0.0));
        for c in 0..3 {
            let (color, dx) = (gbuffer.color.row(c, j), gradients.color_dx.row(c, j));
            let here = load(simd, &color[first..]);
            let error = if first == 0 || first + LANES + 1 > width {
                let mut error = [0.0; LANES];
                for (k, error) in error.iter_mut().enumerate().take(count) {
                    let i = first + k;
                    if i > 0 && i + 1 < width {
                        let mean = 0.5 * (color[i - 1] + color[i + 1]);
                        *error = mean + 0.25 * (dx[i - 1] - dx[i + 1]) - color[i];
                    }
                }
                f32x16::load_array(simd, error)
            } else {
                let at = |values: &[f32], i: usize| load(simd, &values[i..]);
                let (l, r) = (first - 1, first + 1);
                middle([at(color, l), at(color, r)], [at(dx, l), at(dx, r)]) - here
            };
            across = error.mul_add(error, across);
            let at = |planes: &[f32]| load(simd, &planes[first..]);
            let (a, b) = (at(gbuffer.color.row(c, above)), at(gbuffer.color.row(c, below)));
            let dy = &gradients.color_dy;
            let error = middle([a, b], [at(dy.row(c, above)), at(dy.row(c, below))]);
            let error = error - load(simd, &gbuffer.color.row(c, above + (below - above) / 2)[first..]);
            down = error.mul_add(error, down);
        }
        store(across.max(down), &mut errors[first..], count);
    }
}

/// The value of a Hermite curve half-way between two samples two spacings apart, from the samples' values and slopes.
#[inline(always)]
fn middle<S: Simd>([a, b]: [f32x16<S>; 2], [da, db]: [f32x16<S>; 2]) -> f32x16<S> {
    (a + b).mul_add(0.5, (da - db) * 0.25)
}

/// Finds the joint range of the first-order extrapolations of two rows of samples, and the farthest depths, column by
/// column. `planes` is `[VALUES, width]` and one more value.
#[inline(always)]
fn join_rows<S: Simd>(
    simd: S,
    color: &Planes<3>,
    gradients: &Gradients,
    depth: &Planes<1>,
    errors: &[f32],
    rows: [usize; 2],
    planes: &mut [f32],
) {
    let width = color.width();
    for first in (0..width).step_by(LANES) {
        let count = LANES.min(width - first);
        for c in 0..3 {
            let (mut low, mut high) =
                (f32x16::splat(simd, f32::INFINITY), f32x16::splat(simd, f32::NEG_INFINITY));
            for row in rows {
                let color = load(simd, &color.row(c, row)[first..]);
                let dx = load(simd, &gradients.color_dx.row(c, row)[first..]);
                let dy = load(simd, &gradients.color_dy.row(c, row)[first..]);
                let spread = (dx.abs() + dy.abs()) * EXTRAPOLATION;
                (low, high) = (low.min(color - spread), high.max(color + spread));
            }
            store(low, &mut planes[(LOW + c) * width + first..], count);
            store(high, &mut planes[(HIGH + c) * width + first..], count);
        }
        let [a, b] = rows.map(|row| load(simd, &depth.row(0, row)[first..]));
        let (a, b) = (inverse_depth_16(simd, a), inverse_depth_16(simd, b));
        store(a.min(b), &mut planes[FARTHEST * width + first..], count);
        let [a, b] = rows.map(|row| load(simd, &errors[row * width + first..(row + 1) * width]));
        store(a.max(b), &mut planes[DRIFT_GAIN * width + first..], count);
    }
}

/// Joins each column of a row of cells with the next column, and computes the values of the cells.
#[inline(always)]
fn join_columns<S: Simd>(simd: S, width: usize, planes: &mut [f32]) {
    for first in (0..width).step_by(LANES) {
        let count = LANES.min(width - first);
        let column = f32x16::from_fn(simd, |k| (first + k) as f32);
        let is_inner = column.simd_lt((width - 1) as f32);
        for c in 0..3 {
            let (low_at, high_at) = ((LOW + c) * width + first, (HIGH + c) * width + first);
            let (low, high) = (load(simd, &planes[low_at..]), load(simd, &planes[high_at..]));
            let (next_low, next_high) =
                (load(simd, &planes[low_at + 1..]), load(simd, &planes[high_at + 1..]));
            let (low, high) =
                (is_inner.select(low.min(next_low), low), is_inner.select(high.max(next_high), high));
            store((low + high) * 0.5, &mut planes[(MIDDLE + c) * width + first..], count);
            store((high - low) * 0.5, &mut planes[(HALF + c) * width + first..], count);
        }
        let at = FARTHEST * width + first;
        let (far, next) = (load(simd, &planes[at..]), load(simd, &planes[at + 1..]));
        let far = is_inner.select(far.min(next), far);
        store(far * (1.0 - DEPTH_TOLERANCE), &mut planes[at..], count);
        let at = DRIFT_GAIN * width + first;
        let (error, next) = (load(simd, &planes[at..]), load(simd, &planes[at + 1..]));
        let error = is_inner.select(error.max(next), error);
        store(DRIFT * DRIFT / (error + ERROR_FLOOR), &mut planes[at..], count);
    }
}

/// Writes the first `count` lanes.
#[inline(always)]
fn store<S: Simd>(vector: f32x16<S>, values: &mut [f32], count: usize) {
    if count == LANES
        && let Some(values) = values.first_chunk_mut()
    {
        return vector.store_array(values);
    }
    values[..count].copy_from_slice(&vector.to_array()[..count]);
}
