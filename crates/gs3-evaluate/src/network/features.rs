//! Feature maps with zero borders.

use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

/// Pixels that a kernel computes at a time; rows are rounded up to whole multiples.
pub(super) const RUN: usize = 64;

/// Feature maps, `[height + 2, channels, stride]`: a border of one zero row above and below and one zero column left,
/// zeros right. Column `x` is at index `x + 1`.
#[derive(Clone, Debug)]
pub(super) struct Features {
    pub channels: usize,
    pub width: usize,
    pub height: usize,
    pub stride: usize,
    data: Vec<f32>,
}

impl Features {
    /// Zeros.
    pub fn new(channels: usize, width: usize, height: usize) -> Self {
        let stride = width.next_multiple_of(RUN) + 2;
        Self { channels, width, height, stride, data: vec![0.0; (height + 2) * channels * stride] }
    }

    /// Row `y` of all channels, −1 to `height`: `[channels, stride]`.
    pub fn row(&self, y: isize) -> &[f32] {
        let size = self.channels * self.stride;
        let start = (y + 1) as usize * size;
        &self.data[start..start + size]
    }

    /// Rows 0 to `height − 1`, in parallel.
    pub fn rows_mut(&mut self) -> impl IndexedParallelIterator<Item = (usize, &mut [f32])> {
        let size = self.channels * self.stride;
        let height = self.height;
        self.data[size..(height + 1) * size].par_chunks_exact_mut(size).enumerate()
    }

    /// Applies `f(value, values of the others at the same place)` to every value.
    pub fn combine<const N: usize>(
        mut self,
        others: [&Self; N],
        f: impl Fn(f32, [f32; N]) -> f32 + Sync,
    ) -> Self {
        let (width, stride) = (self.width, self.stride);
        self.rows_mut().for_each(|(y, row)| {
            let others = others.map(|o| o.row(y as isize));
            for (c, channel) in row.chunks_exact_mut(stride).enumerate() {
                for (x, value) in channel[1..=width].iter_mut().enumerate() {
                    *value = f(*value, others.map(|o| o[c * stride + x + 1]));
                }
            }
        });
        self
    }

    /// All channels of all parts, one after the other.
    pub fn concatenate(parts: &[&Self]) -> Self {
        let channels = parts.iter().map(|p| p.channels).sum();
        let mut all = Self::new(channels, parts[0].width, parts[0].height);
        all.rows_mut().for_each(|(y, row)| {
            let mut at = 0;
            for part in parts {
                let from = part.row(y as isize);
                row[at..at + from.len()].copy_from_slice(from);
                at += from.len();
            }
        });
        all
    }

    /// The colour of `lr`, clamped to `[0, 1]`; the last column and row are repeated until `multiple` divides the
    /// sides.
    pub fn of_color(lr: &GBuffer, multiple: usize) -> Self {
        let [width, height] = [lr.width(), lr.height()].map(|side| side.next_multiple_of(multiple));
        let mut color = Self::new(3, width, height);
        let stride = color.stride;
        color.rows_mut().for_each(|(y, row)| {
            for (c, channel) in row.chunks_exact_mut(stride).enumerate() {
                let from = lr.color.row(c, y.min(lr.height() - 1));
                for (x, to) in channel[1..=width].iter_mut().enumerate() {
                    *to = from[x.min(lr.width() - 1)].clamp(0.0, 1.0);
                }
            }
        });
        color
    }

    /// Channels `first` to `first + count − 1`.
    pub fn part(&self, first: usize, count: usize) -> Self {
        let mut part = Self::new(count, self.width, self.height);
        let stride = self.stride;
        part.rows_mut().for_each(|(y, row)| {
            row.copy_from_slice(&self.row(y as isize)[first * stride..(first + count) * stride]);
        });
        part
    }

    /// Pixel shuffle: channel `c S² + i S + j` becomes pixel `(i, j)` of the S×S blocks of channel `c`.
    pub fn shuffled(&self, scale: usize) -> Self {
        let mut out = Self::new(self.channels / (scale * scale), self.width * scale, self.height * scale);
        let stride = out.stride;
        out.rows_mut().for_each(|(y, row)| {
            let from = self.row((y / scale) as isize);
            for (c, channel) in row.chunks_exact_mut(stride).enumerate() {
                for j in 0..scale {
                    let at = (c * scale * scale + y % scale * scale + j) * self.stride + 1;
                    let values = &from[at..at + self.width];
                    channel[1 + j..].iter_mut().step_by(scale).zip(values).for_each(|(to, v)| *to = *v);
                }
            }
        });
        out
    }

    /// The inverse of [`Self::shuffled`] for sides divisible by `scale`; others are cut.
    pub fn unshuffled(&self, scale: usize) -> Self {
        let mut out = Self::new(self.channels * scale * scale, self.width / scale, self.height / scale);
        let (width, stride) = (out.width, out.stride);
        out.rows_mut().for_each(|(y, row)| {
            for (channel, values) in row.chunks_exact_mut(stride).enumerate() {
                let (c, i, j) = (channel / (scale * scale), channel / scale % scale, channel % scale);
                let from = &self.row((y * scale + i) as isize)[c * self.stride + 1 + j..];
                values[1..=width].iter_mut().zip(from.iter().step_by(scale)).for_each(|(to, v)| *to = *v);
            }
        });
        out
    }

    /// Writes three channels to an image of this size or smaller, fourth channel 0.
    pub fn write(&self, out: &mut Image) {
        let width = out.width();
        out.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each(|(y, pixels)| {
            let row = self.row(y as isize);
            for (x, pixel) in pixels.iter_mut().enumerate() {
                let [r, g, b] = [0, 1, 2].map(|c| row[c * self.stride + x + 1]);
                *pixel = [r, g, b, 0.0];
            }
        });
    }
}
