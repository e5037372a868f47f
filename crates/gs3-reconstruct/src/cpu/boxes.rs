//! Bounding boxes of chunks of samples in the current frame.

use std::ops::Range;

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

use crate::cpu::displacement::Displacement;
use crate::cpu::samples::SampleFrame;
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// A box is larger than its contents by this many HR pixels, pixel centres at whole numbers. This is far more than
/// the difference in rounding between a corner and a sample.
const SLACK: f32 = 0.5;

const LANES: usize = 16;

/// Number of chunks in one mask.
const WORD: usize = 64;

/// A range of HR pixels along x and y, ends included.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BoxLimits {
    pub left: f32,
    pub right: f32,
    pub top: f32,
    pub bottom: f32,
}

impl BoxLimits {
    /// The limits of nothing.
    const NONE: Self =
        Self { left: f32::INFINITY, right: f32::NEG_INFINITY, top: f32::INFINITY, bottom: f32::NEG_INFINITY };

    /// The range widened by `by` pixels on each side.
    pub fn wider(self, by: f32) -> Self {
        let Self { left, right, top, bottom } = self;
        Self { left: left - by, right: right + by, top: top - by, bottom: bottom + by }
    }
}

/// The boxes of the chunks of one frame, `[height, stride]` each, and of its rows, `[height]`. An empty box has a
/// left end of ∞.
#[derive(Clone, Debug, Default)]
pub(crate) struct Boxes {
    /// Chunks per row, padded to a multiple of [`LANES`] with empty boxes.
    stride: usize,
    left: Vec<f32>,
    right: Vec<f32>,
    top: Vec<f32>,
    bottom: Vec<f32>,
    rows: Vec<BoxLimits>,
}

impl Boxes {
    /// Finds the boxes of `frame`, with samples `scale` HR pixels apart, under `reprojection`. Memory is reused.
    ///
    /// Positions are monotonic along a row or a column at one inverse depth, and along inverse depths at one place,
    /// if everything is in front of the camera. So the extremes of a chunk are at its ends, at its nearest and
    /// farthest depth.
    #[inline(always)]
    pub fn set<S: Simd>(&mut self, simd: S, frame: &SampleFrame, reprojection: &Reprojection, scale: f32) {
        let chunks = frame.chunks_per_row();
        self.stride = chunks.next_multiple_of(LANES);
        for ends in [&mut self.left, &mut self.right, &mut self.top, &mut self.bottom] {
            ends.resize(self.stride * frame.height, f32::INFINITY);
        }
        self.rows.resize(frame.height, BoxLimits::NONE);
        let splat = |v: f32| f32x16::splat(simd, v);
        let lanes = f32x16::from_fn(simd, |i| i as f32);
        for row in 0..frame.height {
            let in_row = frame.extents(row).len();
            // The end of a row of exact blocks, which may be partial.
            let padding = row * self.stride + in_row.next_multiple_of(LANES)..(row + 1) * self.stride;
            self.left[padding].fill(f32::INFINITY);
            let (mut row_left, mut row_right) = (splat(f32::INFINITY), splat(f32::NEG_INFINITY));
            let (mut row_top, mut row_bottom) = (row_left, row_right);
            for (run, of_run) in frame.extents(row).chunks(LANES).enumerate() {
                let (mut far, mut near) = ([0.0; LANES], [0.0; LANES]);
                for (k, extent) in of_run.iter().enumerate() {
                    (far[k], near[k]) = (extent.far, extent.near);
                }
                let is_chunk = lanes.simd_lt((in_row - run * LANES) as f32);
                let [[first, last], [upper, lower]] = frame.ends(simd, row, run * LANES, scale);
                let (mut left, mut right) = (splat(f32::INFINITY), splat(f32::NEG_INFINITY));
                let (mut top, mut bottom) = (left, right);
                let mut is_behind = mask32x16::splat(simd, true);
                let mut is_ahead = is_behind;
                let corners = [
                    (first, upper, &far),
                    (first, upper, &near),
                    (last, upper, &far),
                    (last, upper, &near),
                    (first, lower, &far),
                    (first, lower, &near),
                    (last, lower, &far),
                    (last, lower, &near),
                ];
                // A row of an LR frame has one y.
                let count = if frame.is_blocks() { 8 } else { 4 };
                for (x, y, depths) in corners.into_iter().take(count) {
                    let [u, v, q] = reprojection.apply_16(simd, x, y, f32x16::from_slice(simd, depths));
                    let ahead = q.simd_gt(MIN_DIVISOR);
                    is_ahead &= ahead;
                    is_behind &= !ahead;
                    (left, right) = (left.min(u), right.max(u));
                    (top, bottom) = (top.min(v), bottom.max(v));
                }
                // A chunk partly behind the camera may be anywhere. A chunk wholly behind it, or no chunk, is
                // nowhere.
                let is_none = is_behind | !is_chunk;
                let (least, most) = (splat(f32::NEG_INFINITY), splat(f32::INFINITY));
                let left = is_none.select(most, is_ahead.select(left - (0.5 + SLACK), least));
                let right = is_none.select(least, is_ahead.select(right - (0.5 - SLACK), most));
                let top = is_none.select(most, is_ahead.select(top - (0.5 + SLACK), least));
                let bottom = is_none.select(least, is_ahead.select(bottom - (0.5 - SLACK), most));
                let at = row * self.stride + run * LANES..row * self.stride + (run + 1) * LANES;
                left.store_slice(&mut self.left[at.clone()]);
                right.store_slice(&mut self.right[at.clone()]);
                top.store_slice(&mut self.top[at.clone()]);
                bottom.store_slice(&mut self.bottom[at]);
                (row_left, row_right) = (row_left.min(left), row_right.max(right));
                (row_top, row_bottom) = (row_top.min(top), row_bottom.max(bottom));
            }
            self.rows[row] = BoxLimits {
                left: row_left.reduce_min(),
                right: row_right.reduce_max(),
                top: row_top.reduce_min(),
                bottom: row_bottom.reduce_max(),
            };
            for chunk in 0..in_row {
                if let Some(displacement) = frame.displacement(row, chunk)
                    && displacement.has_movers()
                {
                    self.widen(simd, frame, reprojection, scale, [row, chunk], displacement);
                }
            }
        }
    }

    /// Extends the box of a chunk so that it contains its samples at their displaced places as well.
    #[inline(always)]
    fn widen<S: Simd>(
        &mut self,
        simd: S,
        frame: &SampleFrame,
        reprojection: &Reprojection,
        scale: f32,
        [row, chunk]: [usize; 2],
        displacement: &Displacement,
    ) {
        let places = frame.places(simd, row, chunk, scale);
        let w = f32x16::load_array_ref(simd, frame.chunk(row, chunk).inverse_depth());
        let offsets = displacement.offsets(simd);
        let [u, v, q] = reprojection.apply_moved_16(simd, places.x, places.y, w, offsets);
        let is_there = places.is_sample & q.simd_gt(MIN_DIVISOR);
        let (least, most) = (f32x16::splat(simd, f32::NEG_INFINITY), f32x16::splat(simd, f32::INFINITY));
        let (left, right) = (is_there.select(u, most), is_there.select(u, least));
        let (top, bottom) = (is_there.select(v, most), is_there.select(v, least));
        let k = row * self.stride + chunk;
        self.left[k] = self.left[k].min(left.reduce_min() - (0.5 + SLACK));
        self.right[k] = self.right[k].max(right.reduce_max() - (0.5 - SLACK));
        let (top, bottom) = (top.reduce_min() - (0.5 + SLACK), bottom.reduce_max() - (0.5 - SLACK));
        self.top[k] = self.top[k].min(top);
        self.bottom[k] = self.bottom[k].max(bottom);
        let of_row = &mut self.rows[row];
        *of_row = BoxLimits {
            left: of_row.left.min(self.left[k]),
            right: of_row.right.max(self.right[k]),
            top: of_row.top.min(top),
            bottom: of_row.bottom.max(bottom),
        };
    }

    /// From the first to the last row of samples that meets `limits`.
    pub fn rows_meeting(&self, limits: BoxLimits) -> Range<usize> {
        let meets = |row: &BoxLimits| row.top <= limits.bottom && row.bottom >= limits.top;
        let first = self.rows.iter().position(meets);
        let last = self.rows.iter().rposition(meets);
        first.zip(last).map_or(0..0, |(first, last)| first..last + 1)
    }

    /// Row, and place in the row, of each chunk of `rows` that meets `limits`, in order.
    #[inline(always)]
    pub fn chunks_meeting<S: Simd>(&self, simd: S, rows: Range<usize>, limits: BoxLimits) -> Meeting<'_, S> {
        self.chunks_beginning(simd, rows, limits, f32::NEG_INFINITY..f32::INFINITY)
    }

    /// The chunks of [`Self::chunks_meeting`] with boxes that begin within `tops`.
    #[inline(always)]
    pub fn chunks_beginning<S: Simd>(
        &self,
        simd: S,
        rows: Range<usize>,
        limits: BoxLimits,
        tops: Range<f32>,
    ) -> Meeting<'_, S> {
        Meeting { boxes: self, simd, rows, limits, tops, row: 0, word: self.words(), mask: 0 }
    }

    /// The box of chunk `chunk` of row `row`; none if the chunk is nowhere.
    pub fn limits(&self, row: usize, chunk: usize) -> Option<BoxLimits> {
        let k = row * self.stride + chunk;
        let (left, right, top, bottom) = (self.left[k], self.right[k], self.top[k], self.bottom[k]);
        (left <= right).then_some(BoxLimits { left, right, top, bottom })
    }

    /// The middle of the box of chunk `chunk` of row `row`, in HR pixels. Not finite if the chunk is nowhere or
    /// anywhere.
    pub fn middle(&self, row: usize, chunk: usize) -> [f32; 2] {
        let k = row * self.stride + chunk;
        [0.5 * (self.left[k] + self.right[k]), 0.5 * (self.top[k] + self.bottom[k])]
    }

    /// Number of masks per row.
    const fn words(&self) -> usize {
        self.stride.div_ceil(WORD)
    }

    /// Which chunks of word `word` of row `row` meet `limits` and begin within `tops`.
    #[inline(always)]
    fn meeting<S: Simd>(
        &self,
        simd: S,
        row: usize,
        word: usize,
        limits: BoxLimits,
        tops: &Range<f32>,
    ) -> u64 {
        let of_row = &self.rows[row];
        let is_beside = of_row.left > limits.right || of_row.right < limits.left;
        if is_beside || of_row.top > limits.bottom.min(tops.end) || of_row.bottom < limits.top.max(tops.start)
        {
            return 0;
        }
        let first = word * WORD;
        let load = |ends: &[f32], k: usize| {
            let start = row * self.stride + first + k;
            f32x16::from_slice(simd, &ends[start..start + LANES])
        };
        let mut mask = 0;
        for k in (0..WORD.min(self.stride - first)).step_by(LANES) {
            let top = load(&self.top, k);
            let meets = load(&self.left, k).simd_le(limits.right)
                & load(&self.right, k).simd_ge(limits.left)
                & top.simd_le(limits.bottom)
                & load(&self.bottom, k).simd_ge(limits.top)
                & top.simd_ge(tops.start)
                & top.simd_lt(tops.end);
            mask |= (meets.to_bitmask() & 0xffff) << k;
        }
        mask
    }
}

/// Iterates over chunks that meet limits. Not a closure, which would be a call outside of the kernel.
pub(crate) struct Meeting<'a, S> {
    boxes: &'a Boxes,
    simd: S,
    /// Rows still to come.
    rows: Range<usize>,
    limits: BoxLimits,
    /// Range where the boxes may begin.
    tops: Range<f32>,
    row: usize,
    /// The next word of `row`.
    word: usize,
    /// Chunks of the last word still to come.
    mask: u64,
}

impl<S: Simd> Iterator for Meeting<'_, S> {
    type Item = (usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, usize)> {
        while self.mask == 0 {
            if self.word == self.boxes.words() {
                (self.row, self.word) = (self.rows.next()?, 0);
            }
            self.mask = self.boxes.meeting(self.simd, self.row, self.word, self.limits, &self.tops);
            self.word += 1;
        }
        let chunk = (self.word - 1) * WORD + self.mask.trailing_zeros() as usize;
        self.mask &= self.mask - 1;
        Some((self.row, chunk))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::dispatch;

    /// Boxes of pixels of two words of chunks, the second partial, in three rows.
    fn boxes() -> Boxes {
        let (stride, height) = (WORD + LANES, 3);
        let from = |k: usize| ((k * 37 % 101) as f32, (k * 53 % 97) as f32);
        let all = |f: fn((f32, f32)) -> f32| (0..stride * height).map(|k| f(from(k))).collect::<Vec<f32>>();
        let [left, right] = [all(|(x, _)| x), all(|(x, _)| x + 7.0)];
        let [top, bottom] = [all(|(_, y)| y), all(|(_, y)| y + 9.0)];
        let ends = |row: usize| {
            let row = row * stride..(row + 1) * stride;
            let least = |ends: &[f32]| ends[row.clone()].iter().copied().fold(f32::INFINITY, f32::min);
            let most = |ends: &[f32]| ends[row.clone()].iter().copied().fold(f32::NEG_INFINITY, f32::max);
            BoxLimits { left: least(&left), right: most(&right), top: least(&top), bottom: most(&bottom) }
        };
        let rows = (0..height).map(ends).collect();
        Boxes { stride, left, right, top, bottom, rows }
    }

    #[test]
    fn each_chunk_that_meets_limits_begins_in_one_strip() {
        let boxes = boxes();
        let limits = BoxLimits { left: 20.0, right: 60.0, top: 30.0, bottom: 70.0 };
        let meets = |k: &usize| {
            boxes.left[*k] <= limits.right
                && boxes.right[*k] >= limits.left
                && boxes.top[*k] <= limits.bottom
                && boxes.bottom[*k] >= limits.top
        };
        let expected: Vec<usize> = (0..boxes.left.len()).filter(meets).collect();
        assert!(expected.len() > 20 && expected.iter().any(|k| k % boxes.stride >= WORD), "{expected:?}");
        // A box begins at 50 exactly: it belongs to the strip below.
        assert!(expected.iter().any(|k| boxes.top[*k] == 50.0), "{expected:?}");
        let strips = [f32::NEG_INFINITY..40.0, 40.0..50.0, 50.0..f32::INFINITY];
        dispatch!(gs3_simd::level(), simd => {
            let place = |(row, chunk): (usize, usize)| row * boxes.stride + chunk;
            let met: Vec<usize> = boxes.chunks_meeting(simd, 0..3, limits).map(place).collect();
            assert_eq!(met, expected);
            let mut begun = Vec::new();
            for strip in strips {
                let places: Vec<usize> =
                    boxes.chunks_beginning(simd, 0..3, limits, strip.clone()).map(place).collect();
                assert!(places.iter().all(|k| strip.contains(&boxes.top[*k])), "{strip:?}: {places:?}");
                begun.extend(places);
            }
            begun.sort_unstable();
            assert_eq!(begun, expected);
        });
    }
}
