//! Images to tensors and back: blocks of pixels are the channels of one, as [`Op::PixelUnshuffle`] orders them.
//!
//! [`Op::PixelUnshuffle`]: crate::graph::Op::PixelUnshuffle

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x4, f32x16};

use super::block::{Block, LANES, Layout, Sources};

/// What an image is to a tensor.
#[derive(Clone, Copy, Debug)]
pub struct Exchange {
    /// The side of a block of pixels.
    pub factor: usize,
    /// Channels of the image.
    pub channels: usize,
    /// Columns of the tensor.
    pub width: usize,
    /// The first of its channels that the image makes or is made of; 0 where blocks of pixels are channels.
    pub first: usize,
}

impl Exchange {
    /// The exchange of a whole tensor of `layout`. Its channels are the channels of blocks of `factor`² pixels.
    pub fn new(layout: &Layout, factor: usize) -> Self {
        let channels = layout.shape.channels / (factor * factor);
        Self { factor, channels, width: layout.shape.width, first: 0 }
    }

    /// Numbers of the image that a row of the tensor is made of.
    pub fn row_len(&self) -> usize {
        self.width * self.factor * self.factor * self.channels
    }

    /// The lines of `image` that `count` pixels of row `y` from `x` on are made of; none beyond its end.
    pub fn strip<'a>(
        &self,
        image: &'a [f32],
        [x, y]: [usize; 2],
        count: usize,
    ) -> impl Iterator<Item = &'a [f32]> {
        let per_pixel = self.factor * self.channels;
        let lines = image.chunks_exact(self.width * per_pixel).skip(y * self.factor).take(self.factor);
        let end = (x + count).min(self.width);
        lines.map(move |line| &line[x * per_pixel..end * per_pixel])
    }

    /// Writes the pixels of row `y` from `x` on to `out`, a row of `layout` or a strip of one; its halo is left.
    pub fn import_row(
        &self,
        level: Level,
        image: &[f32],
        [x, y]: [usize; 2],
        layout: &Layout,
        out: &mut [Block],
    ) {
        dispatch!(level, simd => self.import(simd, image, [x, y], layout, out));
    }

    #[inline(always)]
    fn import<S: Simd>(
        &self,
        simd: S,
        image: &[f32],
        [x, y]: [usize; 2],
        layout: &Layout,
        out: &mut [Block],
    ) {
        if self.factor == 1 && self.channels < LANES {
            return self.import_lanes(simd, image, [x, y], layout, out);
        }
        let image = &image[y * self.row_len()..][..self.row_len()];
        match (self.factor, self.channels) {
            (4, 4) => self.import_fours::<S, 4, 16>(simd, image, x, layout, out),
            (4, 3) => self.import_fours::<S, 3, 12>(simd, image, x, layout, out),
            (4, 1) => self.import_fours::<S, 1, 4>(simd, image, x, layout, out),
            (2, 4) => self.import_twos::<S, 4, 8>(simd, image, x, layout, out),
            (2, 3) => self.import_twos::<S, 3, 6>(simd, image, x, layout, out),
            (2, 1) => self.import_twos::<S, 1, 2>(simd, image, x, layout, out),
            (1, channels) if channels.is_multiple_of(LANES) && self.first == 0 => {
                self.import_blocks(image, x, layout, out);
            }
            _ => self.import_any(image, x, layout, out, |out, v| *out = v),
        }
    }

    /// [`Exchange::import_row`] of pixels that are whole blocks.
    #[inline(always)]
    fn import_blocks(&self, image: &[f32], x: usize, layout: &Layout, out: &mut [Block]) {
        let (blocks, _) = image[x * self.channels..].as_chunks::<LANES>();
        for (b, out) in out.chunks_exact_mut(layout.stride()).enumerate() {
            let out = &mut out[layout.halo..][..layout.shape.width];
            let numbers = blocks[b..].iter().step_by(self.channels / LANES);
            out.iter_mut().zip(numbers).for_each(|(out, numbers)| out.0 = *numbers);
        }
    }

    /// [`Exchange::import_row`] of pixels of few channels: sixteen numbers around them are read, and put where they
    /// belong among those that are there. (Loops over single lanes become scatters, which are slower.)
    #[inline(always)]
    fn import_lanes<S: Simd>(
        &self,
        simd: S,
        image: &[f32],
        [x, y]: [usize; 2],
        layout: &Layout,
        out: &mut [Block],
    ) {
        let (channels, pixel) = (self.channels, y * self.width + x);
        for b in self.first / LANES..(self.first + channels).div_ceil(LANES) {
            // Number l of what is read is the channel of lane l.
            let lanes = |l: usize| (self.first..self.first + channels).contains(&(b * LANES + l));
            let first = (pixel * channels + b * LANES).checked_sub(self.first);
            let len = (layout.shape.width - 1) * channels + LANES;
            let Some(numbers) = first.and_then(|first| image.get(first..first + len)) else {
                // At the beginning or the end of the image.
                let image = &image[y * self.row_len()..][..self.row_len()];
                return self.import_any(image, x, layout, out, |out, v| *out = v);
            };
            let is_there: [f32; LANES] = std::array::from_fn(|l| if lanes(l) { 1.0 } else { 0.0 });
            let is_there = f32x16::load_array_ref(simd, &is_there).simd_gt(0.0);
            let out = &mut out[b * layout.stride() + layout.halo..][..layout.shape.width];
            for (k, out) in out.iter_mut().enumerate() {
                let numbers = f32x16::from_slice(simd, &numbers[k * channels..][..LANES]);
                out.0 = is_there.select(numbers, f32x16::load_array_ref(simd, &out.0)).to_array();
            }
        }
    }

    /// [`Exchange::import_row`] of any sizes; `write` puts each number into its place.
    pub fn import_any(
        &self,
        image: &[f32],
        x: usize,
        layout: &Layout,
        out: &mut [Block],
        write: impl Fn(&mut f32, f32),
    ) {
        let Self { factor, channels, .. } = *self;
        let lines = image.chunks_exact(self.width * factor * channels);
        for (i, line) in lines.enumerate() {
            for k in 0..factor * channels {
                let c = self.first + k % channels * factor * factor + i * factor + k / channels;
                let out = &mut out[c / LANES * layout.stride() + layout.halo..][..layout.shape.width];
                let numbers = line[x * factor * channels + k..].iter().step_by(factor * channels);
                for (out, v) in out.iter_mut().zip(numbers) {
                    write(&mut out.0[c % LANES], *v);
                }
            }
        }
    }

    /// [`Exchange::import_row`] for 4×4 pixels of `C` channels, where each channel becomes a block. `N` = 4 · `C`
    /// numbers of a row of the image are side by side.
    #[inline(always)]
    fn import_fours<S: Simd, const C: usize, const N: usize>(
        &self,
        simd: S,
        image: &[f32],
        x: usize,
        layout: &Layout,
        out: &mut [Block],
    ) {
        let width = layout.shape.width;
        let mut lines = image.chunks_exact(self.width * N).map(|line| &line.as_chunks::<N>().0[x..][..width]);
        let mut next = || lines.next().unwrap_or_default();
        let lines = [next(), next(), next(), next()];
        for k in 0..width.min(lines[3].len()) {
            let rows = lines.map(|line| {
                let run = &line[k];
                if C == 1 {
                    [f32x4::from_slice(simd, &run[..4]); 4]
                } else {
                    simd.load_four_interleaved_f32x4(&std::array::from_fn(|lane| match lane % 4 {
                        c if c < C => run[lane / 4 * C + c],
                        _ => 0.0,
                    }))
                }
            });
            for c in 0..C {
                out[c * layout.stride() + layout.halo + k].0 = joined(simd, rows.map(|row| row[c]));
            }
        }
    }

    /// The same for 2×2 pixels, which make one block.
    #[inline(always)]
    fn import_twos<S: Simd, const C: usize, const N: usize>(
        &self,
        simd: S,
        image: &[f32],
        x: usize,
        layout: &Layout,
        out: &mut [Block],
    ) {
        let (above, below) = image.split_at(self.width * N);
        let [above, below] = [above, below].map(|line| &line.as_chunks::<N>().0[x..]);
        let out = &mut out[layout.halo..][..layout.shape.width];
        for ((out, above), below) in out.iter_mut().zip(above).zip(below) {
            let channels = simd.load_four_interleaved_f32x4(&std::array::from_fn(|lane| {
                let row = if lane < 8 { above } else { below };
                match lane % 4 {
                    c if c < C => row[lane / 4 % 2 * C + c],
                    _ => 0.0,
                }
            }));
            out.0 = joined(simd, channels);
        }
    }

    /// Writes `count` pixels of row `y` of a tensor, or of several side by side, all but the last of whole blocks,
    /// from where `sources` begin, to the rows of the image that they make.
    pub fn export_row(
        &self,
        level: Level,
        sources: Sources<'_>,
        layouts: &[Layout],
        y: usize,
        count: usize,
        image: &mut [f32],
    ) {
        let pixels = |b: usize| {
            let (mut layouts, mut b) = (layouts, b);
            while let [layout, rest @ ..] = layouts
                && b >= layout.blocks()
                && !rest.is_empty()
            {
                (layouts, b) = (rest, b - layout.blocks());
            }
            &sources.pixels(&layouts[0], y, b)[..count]
        };
        dispatch!(level, simd => self.export(simd, pixels, sources.x(), image));
    }

    #[inline(always)]
    fn export<'a, S: Simd>(
        &self,
        simd: S,
        pixels: impl Fn(usize) -> &'a [Block],
        x: usize,
        image: &mut [f32],
    ) {
        match (self.factor, self.channels) {
            (4, 4) => self.export_4x4x4(simd, pixels, x, image),
            (4, 3) => self.export_runs::<4, 3, 12>(pixels, x, image),
            (4, 1) => self.export_runs::<4, 1, 4>(pixels, x, image),
            (2, 4) => self.export_runs::<2, 4, 8>(pixels, x, image),
            (2, 3) => self.export_runs::<2, 3, 6>(pixels, x, image),
            (1, channels) if channels.is_multiple_of(LANES) => self.export_blocks(pixels, x, image),
            _ => self.export_any(pixels, x, image),
        }
    }

    #[inline(always)]
    fn export_blocks<'a>(&self, pixels: impl Fn(usize) -> &'a [Block], x: usize, image: &mut [f32]) {
        let (blocks, _) = image[x * self.channels..].as_chunks_mut::<LANES>();
        for b in 0..self.channels / LANES {
            let numbers = blocks[b..].iter_mut().step_by(self.channels / LANES);
            numbers.zip(pixels(b)).for_each(|(numbers, pixel)| *numbers = pixel.0);
        }
    }

    #[inline(always)]
    fn export_any<'a>(&self, pixels: impl Fn(usize) -> &'a [Block], x: usize, image: &mut [f32]) {
        let Self { factor, channels, .. } = *self;
        for (i, line) in image.chunks_exact_mut(self.width * factor * channels).enumerate() {
            for k in 0..factor * channels {
                let c = k % channels * factor * factor + i * factor + k / channels;
                let numbers = line[x * factor * channels + k..].iter_mut().step_by(factor * channels);
                numbers.zip(pixels(c / LANES)).for_each(|(out, pixel)| *out = pixel.0[c % LANES]);
            }
        }
    }

    #[inline(always)]
    fn export_runs<'a, const F: usize, const C: usize, const N: usize>(
        &self,
        pixels: impl Fn(usize) -> &'a [Block],
        x: usize,
        image: &mut [f32],
    ) {
        for (i, line) in image.chunks_exact_mut(self.width * N).enumerate() {
            let runs = &mut line.as_chunks_mut::<N>().0[x..];
            for c in 0..C {
                let first = c * F * F + i * F;
                for (run, pixel) in runs.iter_mut().zip(pixels(first / LANES)) {
                    if let Some(lanes) = pixel.0[first % LANES..].first_chunk::<F>() {
                        (0..F).for_each(|j| run[j * C + c] = lanes[j]);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn export_4x4x4<'a, S: Simd>(
        &self,
        simd: S,
        pixels: impl Fn(usize) -> &'a [Block],
        x: usize,
        image: &mut [f32],
    ) {
        let [a, b, c, d] = [0, 1, 2, 3].map(pixels);
        for (i, line) in image.chunks_exact_mut(self.width * LANES).enumerate() {
            let runs = &mut line.as_chunks_mut::<LANES>().0[x..];
            for ((((run, a), b), c), d) in runs.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                let lanes = |block: &Block| f32x4::from_slice(simd, &block.0[i * 4..i * 4 + 4]);
                simd.store_four_interleaved_f32x4([lanes(a), lanes(b), lanes(c), lanes(d)], run);
            }
        }
    }
}

/// Four numbers each, one after the other.
#[inline(always)]
pub fn joined<S: Simd>(simd: S, [a, b, c, d]: [f32x4<S>; 4]) -> [f32; LANES] {
    simd.combine_f32x8(simd.combine_f32x4(a, b), simd.combine_f32x4(c, d)).to_array()
}

/// Copies numbers; their count is a multiple of four.
#[inline(always)]
pub fn copy_fours<S: Simd>(simd: S, from: &[f32], to: &mut [f32]) {
    for (from, to) in from.chunks_exact(4).zip(to.chunks_exact_mut(4)) {
        f32x4::from_slice(simd, from).store_slice(to);
    }
}
