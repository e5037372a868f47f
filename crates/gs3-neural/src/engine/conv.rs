//! Convolution with bias and activation.
//!
//! A thread computes a row; of it, up to 24 vectors at a time stay in registers: pixels × 16 output channels. Each weight
//! vector is loaded once for all of them and each number of the input once for all output channels, so the multiply-add
//! units are the limit. Inputs of several tensors are read where they lie: concatenation costs nothing.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};
use rayon::prelude::*;

use super::block::{Block, LANES, Layout, Sources};
use super::math::activate;
use crate::graph::{Border, Conv2d};

/// `body` for each constant `index` below `count`, at most 24. Loops are unrolled too late by the compiler: sums that a
/// loop indexes stay in memory, which costs more than half of the speed.
macro_rules! unrolled {
    ($count:expr, $index:ident => $body:block) => {
        unrolled!(@ $count, $index, $body, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23)
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
    /// `[groups of output blocks, segments, taps, channels of the segment, blocks of the group]`: `OIhw16i16o` with the
    /// group's blocks side by side.
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
    /// Those of `inputs`, in the order of the weights.
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
                for tap in 0..taps {
                    for i in channel..channel + segment.channels {
                        for block in first..first + count {
                            packed.push(Block(std::array::from_fn(|lane| {
                                let o = block * LANES + lane;
                                if o < conv.outputs { weights[(o * channels + i) * taps + tap] } else { 0.0 }
                            })));
                        }
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

    /// Writes the convolution to `out`, the blocks of `layout`.
    pub fn run(&self, level: Level, sources: Sources<'_>, layout: &Layout, out: &mut [Block]) {
        out.par_chunks_exact_mut(layout.row_len()).enumerate().for_each(|(y, out)| {
            self.run_row(level, sources, layout, y as isize, out);
            fill_halo(self.border, layout, out);
        });
    }

    /// Writes row `y`, which may lie outside the image, to `out`, a row of `layout`; its halo is left.
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
            // With 32 registers of 16 lanes 24 are sums; with 32 of 4 or 16 of 8 lanes fewer fit.
            if <S::f32s as SimdBase<S>>::LEN == LANES {
                match count {
                    3 => job.pixels::<S, 3, 8, 4, 2>(simd, out),
                    2 => job.pixels::<S, 2, 12, 6, 3>(simd, out),
                    _ => job.pixels::<S, 1, 24, 12, 6>(simd, out),
                }
            } else {
                match count {
                    3 => job.pixels::<S, 3, 2, 1, 1>(simd, out),
                    2 => job.pixels::<S, 2, 3, 1, 1>(simd, out),
                    _ => job.pixels::<S, 1, 6, 3, 1>(simd, out),
                }
            }
            weights = others;
            first += count;
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
    fn pixels<S: Simd, const V: usize, const P: usize, const HALF: usize, const QUARTER: usize>(
        &self,
        simd: S,
        out: &mut [Block],
    ) {
        let width = self.layout.shape.width;
        if width < QUARTER {
            for x in 0..width {
                self.run::<S, V, 1>(simd, x, out);
            }
            return;
        }
        let mut x = 0;
        while x + P <= width {
            self.run::<S, V, P>(simd, x, out);
            x += P;
        }
        while x + HALF <= width {
            self.run::<S, V, HALF>(simd, x, out);
            x += HALF;
        }
        while x < width {
            // The last ones overlap those before, which get the same values again.
            self.run::<S, V, QUARTER>(simd, x.min(width - QUARTER), out);
            x += QUARTER;
        }
    }

    /// `P` pixels from `x`.
    #[inline(always)]
    fn run<S: Simd, const V: usize, const P: usize>(&self, simd: S, x: usize, out: &mut [Block]) {
        let sums = self.sums::<S, V, P>(simd, x);
        let stride = self.layout.stride();
        for (v, sums) in sums.iter().enumerate() {
            let bias = f32x16::load_array_ref(simd, &self.bias[v].0);
            let out = &mut out[v * stride + self.layout.halo + x..][..P];
            for (out, sum) in out.iter_mut().zip(sums) {
                let sum = f32x16::load_array_ref(simd, &sum.0) + bias;
                out.0 = activate(simd, self.conv.conv.activation, sum).to_array();
            }
        }
    }

    /// The sums of `P` pixels from `x`. All indices into them are constants, so that they stay in registers until
    /// the end; they leave as blocks, because a loop over vectors would keep those in memory.
    #[inline(always)]
    fn sums<S: Simd, const V: usize, const P: usize>(&self, simd: S, x: usize) -> [[Block; P]; V] {
        let Convolution { conv, border, segments, .. } = self.conv;
        let mut sums = [[f32x16::splat(simd, 0.0); P]; V];
        let mut weights = self.weights;
        let reach = conv.reach() as isize;
        for segment in segments {
            let tap_len = segment.channels * V;
            for ky in 0..conv.kernel {
                let (row_weights, rest) = weights.split_at(tap_len * conv.kernel);
                weights = rest;
                let last = segment.layout.shape.height as isize - 1;
                let y = self.y + (ky * conv.dilation) as isize - reach;
                let inside = y.clamp(0, last);
                if *border == Border::Zero && y != inside {
                    continue;
                }
                let stride = segment.layout.stride();
                let row =
                    &self.sources.row(&segment.layout, inside as usize)[segment.block * stride..][..stride];
                // The halo is at least as wide as the window's reach.
                let first = x + segment.layout.halo - conv.reach();
                for (kx, tap_weights) in row_weights.chunks_exact(tap_len).enumerate() {
                    let Some(pixels) = row[first + kx * conv.dilation..].first_chunk::<P>() else { continue };
                    let (tap_weights, _) = tap_weights.as_chunks::<V>();
                    for (i, w) in tap_weights.iter().take(LANES).enumerate() {
                        unrolled!(P, PIXEL => {
                            let value = f32x16::splat(simd, pixels[PIXEL].0[i]);
                            unrolled!(V, BLOCK => {
                                let w = f32x16::load_array_ref(simd, &w[BLOCK].0);
                                sums[BLOCK][PIXEL] = value.mul_add(w, sums[BLOCK][PIXEL]);
                            });
                        });
                    }
                }
            }
        }
        let mut blocks = [[Block::default(); P]; V];
        unrolled!(P, PIXEL => {
            unrolled!(V, BLOCK => { blocks[BLOCK][PIXEL].0 = sums[BLOCK][PIXEL].to_array(); });
        });
        blocks
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
