//! What the current frame says about samples of the past: whether they are still visible, and still true.
//!
//! A past sample is wrong where something hides it now, where the surface it was attributed to was not what gave it its
//! colour (reflections, translucent layers), or where its colour depends on the view. The first shows in its depth, the
//! others in its colour: within a cell of four current samples, colours outside the range that their first-order
//! extrapolations span are unlikely. The range is the idea of the neighbourhood clamp of temporal anti-aliasing (Karis
//! 2014, FSR 2), with exact gradients instead of neighbours, and a weight instead of a clamp. Where the current samples
//! predict each other well, a slow drift of colour would stay within that range; there, the past is worth less than the
//! current frame alone, and the less the farther the view has turned since.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*};
use gs3_scene::{GBuffer, Gradients, Planes};
use rayon::prelude::*;

use crate::cpu::lanes::{WINDOW, load, look_up, window_bytes};
use crate::cpu::samples::CHUNK;
use crate::reprojection::inverse_depth_16;

/// Depths may exceed the farthest current one, and the nearest of all samples, by this share: 2 % is the usual
/// tolerance of reprojection.
pub(crate) const DEPTH_TOLERANCE: f32 = 0.02;

/// How far a cell's samples are extrapolated to find the range of plausible colours, in spacings of samples: half a
/// cell is where the extrapolations of two neighbours meet, and half as much again is for curvature. (Empirical: 0.5
/// loses up to 0.19 dB, 1 gains up to 0.08.)
pub(crate) const EXTRAPOLATION: f32 = 0.75;

/// Variance (pixel⁴) of a sample with a colour off by the whole range (empirical: 30 to 300 are alike).
pub(crate) const MISMATCH: f32 = 100.0;

/// How far colours may drift with the view, per pixel of staleness, where nothing in the current frame contradicts:
/// on glossy and translucent surfaces (empirical: 0.002 to 0.004 are alike).
pub(crate) const DRIFT: f32 = 0.004;

/// Variance of a sample that something hides now: beyond use as soon as it has moved a fraction of a pixel. At rest it
/// cannot have become hidden; it lies in a gap that the current samples miss.
pub(crate) const HIDDEN: f32 = 1e4;

const LANES: usize = CHUNK;

/// Cells of a row looked up before that of the first sample: positions need not increase along a row.
const BACK: f32 = 8.0;

/// What is known of a cell.
const VALUES: usize = 9;
/// Middles of the ranges of plausible red, green, blue: these and the next two.
const MIDDLE: usize = 0;
/// Half the extents of the ranges.
const HALF: usize = 3;
/// Smallest inverse depth that is not hidden.
const FARTHEST: usize = 6;
/// [`MISMATCH`] over the squared extent of the range.
const GAIN: usize = 7;
/// Squared [`DRIFT`] over the squared error with which the current samples predict each other.
const DRIFT_GAIN: usize = 8;

/// Ranges of all cells: cell `(i, j)` lies between samples `i`, `i + 1` and `j`, `j + 1`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rectification {
    width: usize,
    /// `(x, y)` HR position to cell: multiply, then add.
    per_hr_pixel: f32,
    offset: [f32; 2],
    last: [f32; 2],
    /// `[LR height, VALUES, LR width]`, and a window more, so that one can be loaded from any place.
    cells: Vec<f32>,
    /// Squared errors, over the channels, with which its neighbours in the row or the column predict a sample: the
    /// larger of both. `[LR height, LR width]`.
    errors: Vec<f32>,
}

impl Rectification {
    /// Makes this the ranges of `gbuffer`, reusing memory. Samples are `scale` HR pixels apart.
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
        // A position is given with pixel centres at whole numbers.
        self.offset = gbuffer.jitter.map(|j| 0.5 * self.per_hr_pixel - 0.5 - j);
        self.last = [(width - 1) as f32, (height - 1) as f32];
        self.errors.resize(width * height, 0.0);
        let errors = self.errors.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        errors.for_each(|(j, errors)| dispatch!(level, simd => predict(simd, gbuffer, gradients, j, errors)));
        let errors = &self.errors;
        let size = VALUES * width * height;
        self.cells.resize(size + WINDOW, 0.0);
        let rows = self.cells[..size].par_chunks_exact_mut(VALUES * width).enumerate().with_min_len(4);
        rows.for_each(|(j, cells)| {
            let rows = [j, (j + 1).min(height - 1)];
            dispatch!(level, simd => {
                join_rows(simd, &gbuffer.color, gradients, depth, errors, rows, cells);
                join_columns(simd, width, cells);
            });
        });
    }

    /// The variances, pixel⁴, that the current frame gives sixteen past samples of colours `colors` seen now at HR
    /// positions `(x, y)`, pixel centres at whole numbers, and inverse depths `w`, so stale (pixels), which may have
    /// changed their colour by `change`. Outside, the nearest cells decide. Those that are not `wanted` have any.
    #[inline(always)]
    pub fn variance<S: Simd>(
        &self,
        simd: S,
        [x, y, w]: [f32x16<S>; 3],
        colors: [&[f32; LANES]; 3],
        staleness: f32x16<S>,
        change: f32x16<S>,
        wanted: mask32x16<S>,
    ) -> f32x16<S> {
        let place = |x: f32x16<S>, axis: usize| {
            let place = x.mul_add(self.per_hr_pixel, f32x16::splat(simd, self.offset[axis]));
            // In this order, NaN becomes 0.
            place.max(0.0).min(self.last[axis]).floor()
        };
        let (i, j) = (place(x, 0), place(y, 1));
        let (columns, rows) = (i.to_array(), j.to_array());
        let mut values = [f32x16::splat(simd, 0.0); VALUES];
        // Sixteen samples of a row mostly lie in sixteen cells of one row or two: loads, and bytes put in place, once
        // or twice.
        let mut left = wanted.to_bitmask() & 0xffff;
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            let (row, column) = (rows[lane], (columns[lane] - BACK).max(0.0));
            let ahead = i - column;
            let is_near = j.simd_eq(row) & ahead.simd_ge(0.0) & ahead.simd_lt(WINDOW as f32);
            let start = row as usize * VALUES * self.width + column as usize;
            let bytes = window_bytes(ahead);
            for (k, value) in values.iter_mut().enumerate() {
                let near = look_up(simd, &self.cells[start + k * self.width..], bytes);
                *value = is_near.select(near, *value);
            }
            left &= !is_near.to_bitmask();
        }
        let mut sum = change * change;
        for c in 0..3 {
            let away = (f32x16::load_array_ref(simd, colors[c]) - values[MIDDLE + c]).abs();
            let outside = (away - values[HALF + c]).max(0.0);
            sum = outside.mul_add(outside, sum);
        }
        let variance = sum.mul_add(values[GAIN], values[DRIFT_GAIN] * (staleness * staleness));
        w.simd_lt(values[FARTHEST]).select(f32x16::splat(simd, HIDDEN), variance)
    }
}

/// In the values of a row of cells, where the lows and highs of the ranges are until columns are joined.
const LOW: usize = MIDDLE;
const HIGH: usize = HALF;

/// Finds how well the samples of row `j` are predicted by the cubic Hermite curves between their neighbours.
#[inline(always)]
fn predict<S: Simd>(simd: S, gbuffer: &GBuffer, gradients: &Gradients, j: usize, errors: &mut [f32]) {
    let (width, height) = (errors.len(), gbuffer.height());
    // The column's three samples around this one, or the next to its end; where there are fewer, the row must do.
    let above = j.saturating_sub(1).min(height.saturating_sub(3));
    let below = (above + 2).min(height - 1);
    for first in (0..width).step_by(LANES) {
        let count = LANES.min(width - first);
        let (mut across, mut down) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 0.0));
        for c in 0..3 {
            // The curve half-way between two samples two spacings apart.
            let middle = |a: f32x16<S>, b: f32x16<S>, da: f32x16<S>, db: f32x16<S>| {
                (a + b).mul_add(0.5, (da - db) * 0.25)
            };
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
                middle(at(color, l), at(color, r), at(dx, l), at(dx, r)) - here
            };
            across = error.mul_add(error, across);
            let at = |planes: &[f32]| load(simd, &planes[first..]);
            let (a, b) = (at(gbuffer.color.row(c, above)), at(gbuffer.color.row(c, below)));
            let dy = &gradients.color_dy;
            let error = middle(a, b, at(dy.row(c, above)), at(dy.row(c, below)));
            let error = error - load(simd, &gbuffer.color.row(c, above + (below - above) / 2)[first..]);
            down = error.mul_add(error, down);
        }
        store(across.max(down), &mut errors[first..], count);
    }
}

/// Finds what the first-order extrapolations of the samples of two rows span together, and the farthest depths,
/// column by column. `cells` is `[VALUES, width]`.
#[inline(always)]
fn join_rows<S: Simd>(
    simd: S,
    color: &Planes<3>,
    gradients: &Gradients,
    depth: &Planes<1>,
    errors: &[f32],
    rows: [usize; 2],
    cells: &mut [f32],
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
            store(low, &mut cells[(LOW + c) * width + first..], count);
            store(high, &mut cells[(HIGH + c) * width + first..], count);
        }
        let [a, b] = rows.map(|row| load(simd, &depth.row(0, row)[first..]));
        let (a, b) = (inverse_depth_16(simd, a), inverse_depth_16(simd, b));
        store(a.min(b), &mut cells[FARTHEST * width + first..], count);
        let [a, b] = rows.map(|row| load(simd, &errors[row * width + first..(row + 1) * width]));
        store(a.max(b), &mut cells[DRIFT_GAIN * width + first..], count);
    }
}

/// Joins each column of a row of cells with the next one, and finds the values of the cells.
#[inline(always)]
fn join_columns<S: Simd>(simd: S, width: usize, cells: &mut [f32]) {
    for first in (0..width).step_by(LANES) {
        let count = LANES.min(width - first);
        let column = f32x16::from_fn(simd, |k| (first + k) as f32);
        let is_inner = column.simd_lt((width - 1) as f32);
        let mut extent = f32x16::splat(simd, 0.0);
        for c in 0..3 {
            let (low_at, high_at) = ((LOW + c) * width + first, (HIGH + c) * width + first);
            let (low, high) = (load(simd, &cells[low_at..]), load(simd, &cells[high_at..]));
            let (next_low, next_high) = (load(simd, &cells[low_at + 1..]), load(simd, &cells[high_at + 1..]));
            let (low, high) =
                (is_inner.select(low.min(next_low), low), is_inner.select(high.max(next_high), high));
            extent = (high - low).mul_add(high - low, extent);
            store((low + high) * 0.5, &mut cells[(MIDDLE + c) * width + first..], count);
            store((high - low) * 0.5, &mut cells[(HALF + c) * width + first..], count);
        }
        let at = FARTHEST * width + first;
        let (far, next) = (load(simd, &cells[at..]), load(simd, &cells[at + 1..]));
        let far = is_inner.select(far.min(next), far);
        store(far * (1.0 - DEPTH_TOLERANCE), &mut cells[at..], count);
        let at = DRIFT_GAIN * width + first;
        let (error, next) = (load(simd, &cells[at..]), load(simd, &cells[at + 1..]));
        let error = is_inner.select(error.max(next), error);
        // Errors below 1/4096 are none.
        store(DRIFT * DRIFT / (error + 6e-8), &mut cells[at..], count);
        // Where nothing varies, rounding alone must not make a sample implausible.
        store(MISMATCH / (extent + 1e-6), &mut cells[GAIN * width + first..], count);
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
