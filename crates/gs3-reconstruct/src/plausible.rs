//! What the current frame says about samples of the past: whether they are still visible, and still true.
//!
//! A past sample is wrong where something hides it now, where the surface it was attributed to was not what gave it its
//! colour (reflections, translucent layers), or where its colour depends on the view. The first shows in its depth, the
//! others in its colour: within a cell of four current samples, colours outside the range that their first-order
//! extrapolations span are unlikely. The range is the idea of the neighbourhood clamp of temporal anti-aliasing (Karis
//! 2014, FSR 2), with exact gradients instead of neighbours, and a weight instead of a clamp.

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*};
use rayon::prelude::*;

use crate::samples::{Sample, SampleFrame};

/// Depths may exceed the farthest current one by this share: 2 % is the usual tolerance of reprojection.
const DEPTH_TOLERANCE: f32 = 0.02;

/// How far a cell's samples are extrapolated to find the range of plausible colours, in spacings of samples: half a cell
/// is where the extrapolations of two neighbours meet.
const EXTRAPOLATION: f32 = 0.5;

/// Variance (in units of `Splatter`'s weights, pixel⁴) of a sample whose colour is off by the whole range (empirical:
/// 30 to 300 are alike).
const MISMATCH: f32 = 100.0;

/// Variance of a sample that something hides now: beyond use as soon as it has moved a fraction of a pixel. At rest it
/// cannot have become hidden; it lies in a gap that the current samples miss.
const HIDDEN: f32 = 1e4;

/// The range of one cell between four current samples.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(16))]
struct Cell {
    /// Lowest plausible RGB, −∞.
    low: [f32; 4],
    /// Highest plausible RGB, ∞.
    high: [f32; 4],
    /// Smallest inverse depth that is not hidden.
    farthest: f32,
    /// [`MISMATCH`] over the squared extent of the range.
    gain: f32,
}

/// Ranges of all cells, `[LR height, LR width]`: cell `(i, j)` lies between samples `i`, `i + 1` and `j`, `j + 1`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Plausible {
    width: usize,
    /// `(x, y)` HR position to cell: multiply, then add.
    per_hr_pixel: f32,
    offset: [f32; 2],
    last: [f32; 2],
    cells: Vec<Cell>,
}

impl Plausible {
    /// Makes this the ranges of `frame`, whose samples are `scale` HR pixels apart, reusing memory.
    pub fn set(&mut self, frame: &SampleFrame, scale: u32) {
        let (width, height) = (frame.width, frame.height);
        self.width = width;
        self.per_hr_pixel = 1.0 / scale as f32;
        // A position is given with pixel centres at whole numbers.
        self.offset = frame.jitter.map(|j| 0.5 * self.per_hr_pixel - 0.5 - j);
        self.last = [(width - 1) as f32, (height - 1) as f32];
        self.cells.resize(width * height, Cell::default());
        let reach = EXTRAPOLATION * scale as f32;
        self.cells.par_chunks_exact_mut(width).enumerate().for_each(|(j, row)| {
            let rows = [j, (j + 1).min(height - 1)];
            let column = |i: usize| rows.map(|j| Range::of(&frame.samples[j * width + i], reach));
            let depth = |i: usize| {
                let [a, b] = rows.map(|j| frame.inverse_depth[j * width + i]);
                a.min(b)
            };
            let mut left = (Range::join(column(0)), depth(0));
            for (i, cell) in row.iter_mut().enumerate() {
                let next = (i + 1).min(width - 1);
                let right = (Range::join(column(next)), depth(next));
                let Range { low, high } = Range::join([left.0, right.0]);
                let extent: f32 = (0..3).map(|c| (high[c] - low[c]) * (high[c] - low[c])).sum();
                let farthest = left.1.min(right.1) * (1.0 - DEPTH_TOLERANCE);
                // Where nothing varies, rounding alone must not make a sample implausible.
                let gain = MISMATCH / (extent + 1e-6);
                *cell = Cell {
                    low: [low[0], low[1], low[2], f32::NEG_INFINITY],
                    high: [high[0], high[1], high[2], f32::INFINITY],
                    farthest,
                    gain,
                };
                left = right;
            }
        });
    }

    /// The cells at sixteen HR positions, pixel centres at whole numbers; outside, the nearest cell.
    #[inline(always)]
    pub fn cell<S: Simd>(&self, x: f32x16<S>, y: f32x16<S>) -> i32x16<S> {
        let place = |x: f32x16<S>, axis: usize| {
            let place = x * self.per_hr_pixel + self.offset[axis];
            // In this order, NaN becomes 0.
            place.max(0.0).min(self.last[axis]).floor()
        };
        place(y, 1).to_int::<i32x16<S>>() * self.width as i32 + place(x, 0).to_int::<i32x16<S>>()
    }

    /// The variance, pixel⁴, that the current frame gives a past sample of colour `color` seen now in `cell` at inverse
    /// depth `w`.
    #[inline(always)]
    pub fn doubt<S: Simd>(&self, simd: S, cell: i32, color: &[f32; 4], w: f32) -> f32 {
        let cell = &self.cells[cell as usize];
        if w < cell.farthest {
            return HIDDEN;
        }
        let [color, low, high] = [color, &cell.low, &cell.high].map(|v| f32x4::load_array_ref(simd, v));
        let outside = (low - color).max(color - high).max(0.0);
        (outside * outside).reduce_sum() * cell.gain
    }
}

/// A range of RGB.
#[derive(Clone, Copy)]
struct Range {
    low: [f32; 3],
    high: [f32; 3],
}

impl Range {
    /// What the first-order extrapolation of `sample` spans within `reach` HR pixels along both axes.
    #[inline(always)]
    fn of(sample: &Sample, reach: f32) -> Self {
        let spread: [f32; 3] = std::array::from_fn(|c| reach * (sample.dx[c].abs() + sample.dy[c].abs()));
        Self {
            low: std::array::from_fn(|c| sample.color[c] - spread[c]),
            high: std::array::from_fn(|c| sample.color[c] + spread[c]),
        }
    }

    #[inline(always)]
    fn join([a, b]: [Self; 2]) -> Self {
        Self {
            low: std::array::from_fn(|c| a.low[c].min(b.low[c])),
            high: std::array::from_fn(|c| a.high[c].max(b.high[c])),
        }
    }
}
