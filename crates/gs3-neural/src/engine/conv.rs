//! Convolution with bias and activation.
//!
//! A thread computes a strip of a row; of it, up to 24 vectors at a time stay in registers: pixels × 16 output
//! channels. Each weight vector is loaded once for all of them and each number of the input once for all output
//! channels and all columns of the window, so the multiply-add units are the limit: with all that it reads in the
//! first cache a 3×3 convolution reaches 85 to 91 % of their peak on Granite Rapids. Inputs of several tensors are
//! read where they lie: concatenation costs nothing.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::block::{Block, LANES, Layout, Sources};
use super::math::activate;
use super::ops::load;
use crate::graph::{Activation, Border, Conv2d};

/// `body` for each constant `index` below `count`, at most 26. Loops are unrolled too late by the compiler: sums that a
/// loop indexes stay in memory, which costs more than half of the speed.
macro_rules! unrolled {
    ($count:expr, $index:ident => $body:block) => {
        unrolled!(@ $count, $index, $body, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25)
    };
    (@ $count:expr, $index:ident, $body:block, $($k:literal)*) => {
        $({
            const $index: usize = $k;
            if $index < $count $body
        })*
    };
}
pub(crate) use unrolled;

/// A convolution ready to run.
#[derive(Clone, Debug)]
pub struct Convolution {
    conv: Conv2d,
    border: Border,
    /// 16 or fewer channels of an input each, in the order of the weights.
    segments: Vec<Segment>,
    /// `[groups of output blocks, segments, rows of the window, channels of the segment, columns, blocks of the
    /// group]`.
    weights: Vec<Block>,
    /// `[output blocks]`.
    bias: Vec<Block>,
}

/// A block of channels of an input.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Of the tensor.
    pub layout: Layout,
    /// Which block of its channels.
    pub block: usize,
    /// How many of its channels.
    pub channels: usize,
}

impl Segment {
    /// The segments of `inputs`, in the order of the weights.
    pub fn all(inputs: &[Layout]) -> Vec<Self> {
        let mut segments = Vec::new();
        for layout in inputs {
            for block in 0..layout.blocks() {
                let channels = (layout.shape.channels - block * LANES).min(LANES);
                segments.push(Self { layout: *layout, block, channels });
            }
        }
        segments
    }
}

/// The inputs for building a convolution: the convolution of `inputs`, concatenated, in strips of `width` pixels,
/// with `weights` `oihw` and `bias`, which is empty if there is none.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    pub conv: Conv2d,
    pub border: Border,
    pub inputs: &'a [Layout],
    pub width: usize,
    pub weights: &'a [f32],
    pub bias: &'a [f32],
}

/// What of an input a row of a window sees.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    pub conv: &'a Conv2d,
    pub border: Border,
    pub sources: Sources<'a>,
}

impl<'a> Seen<'a> {
    /// The pixels of `segment` from the first that row `line` of the window around pixel `x` of row `y` sees on; none
    /// where these are zero.
    #[inline(always)]
    pub fn pixels(&self, segment: &Segment, line: usize, y: isize, x: usize) -> Option<&'a [Block]> {
        let Segment { layout, block, .. } = segment;
        let reach = self.conv.reach();
        let place = y + (line * self.conv.dilation) as isize - reach as isize;
        let inside = place.clamp(0, layout.shape.height as isize - 1);
        if self.border == Border::Zero && place != inside {
            return None;
        }
        let row = &self.sources.row(layout, inside as usize)[block * layout.stride()..][..layout.stride()];
        // The halo is at least as wide as the window's reach.
        Some(&row[x + self.sources.first(layout) - reach..])
    }
}

/// Output blocks computed together when `left` are left: three or two, so that each number of the input is used often.
pub fn group(left: usize) -> usize {
    match left {
        1 => 1,
        _ if left.is_multiple_of(3) => 3,
        _ => 2,
    }
}

impl Convolution {
    /// The convolution of `inputs`, concatenated, with `weights` `oihw` and `bias`, empty where there is none.
    pub fn new(conv: Conv2d, border: Border, inputs: &[Layout], weights: &[f32], bias: &[f32]) -> Self {
        let segments = Segment::all(inputs);
        let channels: usize = segments.iter().map(|s| s.channels).sum();
        let taps = conv.kernel * conv.kernel;
        let blocks = conv.outputs.div_ceil(LANES);
        let mut packed = Vec::with_capacity(blocks * taps * channels);
        let mut first = 0;
        while first < blocks {
            let count = group(blocks - first);
            let mut channel = 0;
            for segment in &segments {
                for step in 0..conv.kernel * segment.channels * conv.kernel {
                    let (row, column) = (step / (segment.channels * conv.kernel), step % conv.kernel);
                    let i = channel + step / conv.kernel % segment.channels;
                    let tap = row * conv.kernel + column;
                    for block in first..first + count {
                        packed.push(Block(std::array::from_fn(|lane| {
                            let o = block * LANES + lane;
                            if o < conv.outputs { weights[(o * channels + i) * taps + tap] } else { 0.0 }
                        })));
                    }
                }
                channel += segment.channels;
            }
            first += count;
        }
        let lane = |o: usize| bias.get(o).copied().unwrap_or(0.0);
        let bias = (0..blocks).map(|b| Block(std::array::from_fn(|l| lane(b * LANES + l)))).collect();
        Self { conv, border, segments, weights: packed, bias }
    }

    /// Columns of the window side by side, or 0 if they are apart.
    fn columns(&self) -> usize {
        if self.conv.dilation == 1 { self.conv.kernel } else { 0 }
    }

    /// Writes row `y`, which may lie outside the image, to `out`, a row of `layout` or a strip of one; its halo is
    /// left.
    pub fn run_row(&self, level: Level, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        dispatch!(level, simd => self.row(simd, sources, layout, y, out));
    }

    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        let channels: usize = self.segments.iter().map(|s| s.channels).sum();
        let per_block = channels * self.conv.kernel * self.conv.kernel;
        let (mut first, mut weights) = (0, &self.weights[..]);
        while first < self.bias.len() {
            let count = group(self.bias.len() - first);
            let (these, others) = weights.split_at(count * per_block);
            let bias = &self.bias[first..first + count];
            let out = &mut out[first * layout.stride()..][..count * layout.stride()];
            let job = Job { conv: self, sources, layout, y, weights: these, bias };
            // With 32 registers of 16 lanes 24 are sums, or 18 if 9 hold weights; with 32 of 4 or 16 of 8 lanes fewer
            // fit.
            let is_wide = <S::f32s as SimdBase<S>>::LEN == LANES;
            match (is_wide, self.columns(), count) {
                (true, 1, 3) => job.pixels::<S, 1, 3, 8, 4, 2>(simd, out),
                (true, 1, 2) => job.pixels::<S, 1, 2, 12, 6, 3>(simd, out),
                (true, 1, _) => job.pixels::<S, 1, 1, 24, 12, 6>(simd, out),
                (true, 3, 3) => job.pixels::<S, 3, 3, 6, 3, 2>(simd, out),
                (true, 3, 2) => job.pixels::<S, 3, 2, 12, 6, 3>(simd, out),
                (true, 3, _) => job.pixels::<S, 3, 1, 24, 12, 6>(simd, out),
                (true, _, 3) => job.pixels::<S, 0, 3, 8, 4, 2>(simd, out),
                (true, _, 2) => job.pixels::<S, 0, 2, 12, 6, 3>(simd, out),
                (true, _, _) => job.pixels::<S, 0, 1, 24, 12, 6>(simd, out),
                (false, _, 3) => job.pixels::<S, 0, 3, 2, 1, 1>(simd, out),
                (false, _, 2) => job.pixels::<S, 0, 2, 3, 1, 1>(simd, out),
                (false, _, _) => job.pixels::<S, 0, 1, 6, 3, 1>(simd, out),
            }
            weights = others;
            first += count;
        }
        let activation = self.conv.activation;
        if activation != Activation::Identity {
            for line in out.chunks_exact_mut(layout.stride()) {
                for block in &mut line[layout.halo..][..layout.shape.width] {
                    block.0 = activate(simd, activation, load(simd, block)).to_array();
                }
            }
        }
    }
}

/// A group of output blocks of a row.
struct Job<'a> {
    conv: &'a Convolution,
    sources: Sources<'a>,
    layout: &'a Layout,
    y: isize,
    weights: &'a [Block],
    bias: &'a [Block],
}

impl Job<'_> {
    /// All pixels of the row, `P` at a time, then what is left by `HALF` and `QUARTER` of that.
    #[inline(always)]
    fn pixels<
        S: Simd,
        const COLUMNS: usize,
        const V: usize,
        const P: usize,
        const HALF: usize,
        const QUARTER: usize,
    >(
        &self,
        simd: S,
        out: &mut [Block],
    ) {
        let width = self.layout.shape.width;
        if width < QUARTER {
            for x in 0..width {
                self.run::<S, COLUMNS, V, 1>(simd, x, out);
            }
            return;
        }
        let mut x = 0;
        while x + P <= width {
            self.run::<S, COLUMNS, V, P>(simd, x, out);
            x += P;
        }
        while x + HALF <= width {
            self.run::<S, COLUMNS, V, HALF>(simd, x, out);
            x += HALF;
        }
        while x < width {
            // The last ones overlap those before, which get the same values again.
            self.run::<S, COLUMNS, V, QUARTER>(simd, x.min(width - QUARTER), out);
            x += QUARTER;
        }
    }

    /// `P` pixels from `x`, before the activation. All indices into their sums are constants, so that they stay in
    /// registers until the end.
    #[inline(always)]
    fn run<S: Simd, const COLUMNS: usize, const V: usize, const P: usize>(
        &self,
        simd: S,
        x: usize,
        out: &mut [Block],
    ) {
        let Convolution { conv, border, segments, .. } = self.conv;
        let seen = Seen { conv, border: *border, sources: self.sources };
        let mut sums = [[f32x16::splat(simd, 0.0); P]; V];
        unrolled!(V, BLOCK => { sums[BLOCK] = [load(simd, &self.bias[BLOCK]); P]; });
        let mut weights = self.weights;
        for segment in segments {
            let steps = segment.channels * conv.kernel;
            for ky in 0..conv.kernel {
                let (row_weights, rest) = weights.split_at(steps * V);
                weights = rest;
                let Some(row) = seen.pixels(segment, ky, self.y, x) else { continue };
                if COLUMNS > 0 {
                    // Each number is loaded once and multiplied with the weights of all columns through which a pixel
                    // sees it.
                    let (Some(first), rest) = (row.first_chunk::<P>(), &row[P..P + COLUMNS - 1]) else {
                        continue;
                    };
                    let (taps, _) = row_weights.as_chunks::<V>().0.as_chunks::<COLUMNS>();
                    for (channel, taps) in taps.iter().enumerate() {
                        let mut vectors = [[f32x16::splat(simd, 0.0); V]; COLUMNS];
                        for (vectors, tap) in vectors.iter_mut().zip(taps) {
                            unrolled!(V, BLOCK => { vectors[BLOCK] = load(simd, &tap[BLOCK]); });
                        }
                        unrolled!(P + COLUMNS - 1, SEEN => {
                            let pixel = if SEEN < P { &first[SEEN % P] } else { &rest[SEEN.saturating_sub(P)] };
                            let value = f32x16::splat(simd, pixel.0[channel % LANES]);
                            unrolled!(V, BLOCK => {
                                // The first column sees it for the pixel one to its right, the last for that to its
                                // left.
                                let sums = &mut sums[BLOCK];
                                if let (Some(sum), Some(w)) = (sums.get_mut(SEEN), vectors.first()) {
                                    *sum = value.mul_add(w[BLOCK], *sum);
                                }
                                if let (Some(sum), Some(w)) = (sums.get_mut(SEEN.wrapping_sub(1)), vectors.get(1)) {
                                    *sum = value.mul_add(w[BLOCK], *sum);
                                }
                                if let (Some(sum), Some(w)) = (sums.get_mut(SEEN.wrapping_sub(2)), vectors.get(2)) {
                                    *sum = value.mul_add(w[BLOCK], *sum);
                                }
                            });
                        });
                    }
                    continue;
                }
                // One loop over the taps of all channels, not one for each channel.
                let (mut tap, mut channel, end) = (0, 0, conv.kernel * conv.dilation);
                for w in row_weights.as_chunks::<V>().0 {
                    let Some(pixels) = row[tap..].first_chunk::<P>() else { continue };
                    unrolled!(P, PIXEL => {
                        let value = f32x16::splat(simd, pixels[PIXEL].0[channel % LANES]);
                        unrolled!(V, BLOCK => {
                            sums[BLOCK][PIXEL] = value.mul_add(load(simd, &w[BLOCK]), sums[BLOCK][PIXEL]);
                        });
                    });
                    tap += conv.dilation;
                    channel = if tap == end { channel + 1 } else { channel };
                    tap = if tap == end { 0 } else { tap };
                }
            }
        }
        let stride = self.layout.stride();
        unrolled!(V, BLOCK => {
            let out = &mut out[BLOCK * stride + self.layout.halo + x..];
            if let Some(out) = out.first_chunk_mut::<P>() {
                unrolled!(P, PIXEL => { out[PIXEL].0 = sums[BLOCK][PIXEL].to_array(); });
            }
        });
    }
}

/// Fills the pixels beside each row of `out` as `border` says.
pub fn fill_halo(border: Border, layout: &Layout, out: &mut [Block]) {
    if layout.halo == 0 {
        return;
    }
    let (halo, width) = (layout.halo, layout.shape.width);
    for line in out.chunks_exact_mut(layout.stride()) {
        let (first, last) = match border {
            Border::Zero => (Block::default(), Block::default()),
            Border::Replicate => (line[halo], line[halo + width - 1]),
        };
        line[..halo].fill(first);
        line[halo + width..].fill(last);
    }
}
