//! The derivative by a convolution's weights and bias.
//!
//! Sums over all pixels of output channel × input channel × tap. Of them up to 16 vectors stay in registers while some
//! rows pass by: up to 3 blocks of 16 output channels × 4 input channels of a tap, or 2 × 8. A vector of the
//! derivative by the result is loaded once for all of these input channels, a number of the input once for all
//! blocks.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::math::derivative;
use crate::engine::block::{Block, LANES, Layout, Sources};
use crate::engine::conv::{Segment, group, unrolled};
use crate::engine::ops::load;
use crate::graph::{Activation, Border, Conv2d};

/// Most rows that are summed at a time.
pub const ROWS: usize = 8;

/// The derivative by the sum before the activation from that by the result: both `v`, rows of `layout` from `first` on,
/// with the zeros beside each. `result` is the activation's. Adds those by the bias to `v_bias`, `[output blocks]`.
pub fn through_activation(
    level: Level,
    activation: Activation,
    result: (Sources<'_>, &Layout),
    layout: &Layout,
    first: usize,
    v: &mut [Block],
    v_bias: &mut [Block],
) {
    dispatch!(level, simd => through_activation_on(simd, activation, result, layout, first, v, v_bias));
}

#[inline(always)]
fn through_activation_on<S: Simd>(
    simd: S,
    activation: Activation,
    (values, result): (Sources<'_>, &Layout),
    layout: &Layout,
    first: usize,
    v: &mut [Block],
    v_bias: &mut [Block],
) {
    for (y, row) in v.chunks_exact_mut(layout.row_len()).enumerate() {
        for (b, (line, v_bias)) in row.chunks_exact_mut(layout.stride()).zip(&mut *v_bias).enumerate() {
            let (beside, rest) = line.split_at_mut(layout.halo);
            let (line, after) = rest.split_at_mut(layout.shape.width);
            beside.fill(Block::default());
            after.fill(Block::default());
            let mut sum = f32x16::splat(simd, 0.0);
            for (v, y) in line.iter_mut().zip(values.pixels(result, first + y, b)) {
                let y = load(simd, y);
                let v_sum = load(simd, v) * derivative(simd, activation, y, y);
                v.0 = v_sum.to_array();
                sum += v_sum;
            }
            v_bias.0 = (load(simd, v_bias) + sum).to_array();
        }
    }
}

/// A convolution with the derivatives of its weights being summed.
#[derive(Clone, Debug)]
pub struct WeightSums<'a> {
    pub conv: &'a Conv2d,
    pub border: Border,
    /// Its inputs.
    pub inputs: &'a [Layout],
}

impl WeightSums<'_> {
    fn channels(&self) -> usize {
        self.inputs.iter().map(|layout| layout.shape.channels).sum()
    }

    /// Blocks of memory for all sums.
    pub fn len(&self) -> usize {
        self.conv.outputs.div_ceil(LANES) * self.conv.kernel * self.conv.kernel * self.channels()
    }

    /// Adds to `sums`, `[groups of output blocks, segments, taps, channels of the segment, blocks of the group]`, what
    /// `rows`, at most [`ROWS`], of the inputs, in `values`, and of the derivative by the sums before the activation,
    /// in `v`, give.
    pub fn run(
        &self,
        level: Level,
        values: Sources<'_>,
        v: (Sources<'_>, &Layout),
        rows: Range<usize>,
        sums: &mut [Block],
    ) {
        let segments = Segment::all(self.inputs);
        let pass = Pass { of: self, segments: &segments, values, v: v.0, v_layout: v.1, rows };
        dispatch!(level, simd => pass.run(simd, sums));
    }

    /// Adds `sums` to `v_weights`, `oihw`.
    pub fn unpack(&self, sums: &[Block], v_weights: &mut [f32]) {
        let (taps, channels) = (self.conv.kernel * self.conv.kernel, self.channels());
        let blocks = self.conv.outputs.div_ceil(LANES);
        let mut sums = sums.iter();
        let mut first = 0;
        while first < blocks {
            let count = group(blocks - first);
            let mut channel = 0;
            for segment in Segment::all(self.inputs) {
                for tap in 0..taps {
                    for i in channel..channel + segment.channels {
                        for (block, sum) in (first..first + count).zip(&mut sums) {
                            let lanes = (self.conv.outputs - block * LANES).min(LANES);
                            for (lane, sum) in sum.0[..lanes].iter().enumerate() {
                                v_weights[((block * LANES + lane) * channels + i) * taps + tap] += sum;
                            }
                        }
                    }
                }
                channel += segment.channels;
            }
            first += count;
        }
    }
}

/// Some rows of it.
struct Pass<'a> {
    of: &'a WeightSums<'a>,
    segments: &'a [Segment],
    values: Sources<'a>,
    v: Sources<'a>,
    v_layout: &'a Layout,
    rows: Range<usize>,
}

impl Pass<'_> {
    #[inline(always)]
    fn run<S: Simd>(&self, simd: S, sums: &mut [Block]) {
        let blocks = self.v_layout.blocks();
        let per_block = sums.len() / blocks;
        let (mut first, mut sums) = (0, sums);
        while first < blocks {
            let count = group(blocks - first);
            let (these, others) = sums.split_at_mut(count * per_block);
            match count {
                3 => self.group::<S, 3>(simd, first, these),
                2 => self.group::<S, 2>(simd, first, these),
                _ => self.group::<S, 1>(simd, first, these),
            }
            sums = others;
            first += count;
        }
    }

    /// `V` output blocks from `first`.
    #[inline(always)]
    fn group<S: Simd, const V: usize>(&self, simd: S, first: usize, sums: &mut [Block]) {
        let mut sums = sums;
        for segment in self.segments {
            for tap in 0..self.of.conv.kernel * self.of.conv.kernel {
                let (these, others) = sums.split_at_mut(segment.channels * V);
                let (these, _) = these.as_chunks_mut::<V>();
                self.channels::<S, V>(simd, first, segment, tap, these);
                sums = others;
            }
        }
    }

    /// All channels of `segment` at `tap`.
    #[inline(always)]
    fn channels<S: Simd, const V: usize>(
        &self,
        simd: S,
        first: usize,
        segment: &Segment,
        tap: usize,
        sums: &mut [[Block; V]],
    ) {
        // With 32 registers of 16 lanes 16 are sums (24 leave them: three blocks then take 1.7 times as long); with
        // 16 of 8 lanes or 32 of 4 fewer fit.
        let most = match V {
            3 if <S::f32s as SimdBase<S>>::LEN == LANES => 4,
            _ if <S::f32s as SimdBase<S>>::LEN == LANES => 8,
            1 => 4,
            2 => 2,
            _ => 1,
        };
        let view = View { pass: self, first, segment, tap };
        let (mut i, mut sums) = (0, sums);
        while !sums.is_empty() {
            // Powers of two, so that a group never reaches beyond the 16 channels of a pixel.
            let count = most.min(1 << sums.len().ilog2());
            let (these, others) = sums.split_at_mut(count);
            match count {
                8 => view.sum::<S, V, 8>(simd, i, these),
                4 => view.sum::<S, V, 4>(simd, i, these),
                2 => view.sum::<S, V, 2>(simd, i, these),
                _ => view.sum::<S, V, 1>(simd, i, these),
            }
            i += count;
            sums = others;
        }
    }
}

/// What a tap sees of a block of input channels, and the output blocks from `first`.
struct View<'a> {
    pass: &'a Pass<'a>,
    first: usize,
    segment: &'a Segment,
    tap: usize,
}

impl View<'_> {
    /// Adds the sums of `N` input channels from `i` to `sums`. As in the forward kernel, all indices into registers
    /// are constants.
    #[inline(always)]
    fn sum<S: Simd, const V: usize, const N: usize>(&self, simd: S, i: usize, sums: &mut [[Block; V]]) {
        let Pass { of: WeightSums { conv, border, .. }, values, v, v_layout, rows, .. } = self.pass;
        let layout = &self.segment.layout;
        let (ky, kx) = (self.tap / conv.kernel * conv.dilation, self.tap % conv.kernel * conv.dilation);
        // The halo is at least as wide as the window's reach.
        let start = self.segment.block * layout.stride() + layout.halo - conv.reach() + kx;
        let width = v_layout.shape.width;
        // Found before the sums, so that these need not leave their registers between rows.
        let mut lines: [(&[Block], [&[Block]; V]); ROWS] = [(&[], [&[]; V]); ROWS];
        let mut count = 0;
        for y in rows.clone().take(ROWS) {
            let place = (y + ky) as isize - conv.reach() as isize;
            let inside = place.clamp(0, layout.shape.height as isize - 1);
            if *border == Border::Replicate || place == inside {
                let pixels = &values.row(layout, inside as usize)[start..];
                lines[count] = (pixels, std::array::from_fn(|b| v.pixels(v_layout, y, self.first + b)));
                count += 1;
            }
        }
        let mut vectors = [[f32x16::splat(simd, 0.0); V]; N];
        for (pixels, v) in &lines[..count] {
            // All of one length, so that it is compared once.
            let (pixels, v) = (&pixels[..width], v.map(|v| &v[..width]));
            for x in 0..width {
                let pixel = &pixels[x].0;
                let mut v_sums = [f32x16::splat(simd, 0.0); V];
                unrolled!(V, BLOCK => { v_sums[BLOCK] = load(simd, &v[BLOCK][x]); });
                unrolled!(N, CHANNEL => {
                    let value = f32x16::splat(simd, pixel[(i + CHANNEL) % LANES]);
                    unrolled!(V, BLOCK => {
                        vectors[CHANNEL][BLOCK] = value.mul_add(v_sums[BLOCK], vectors[CHANNEL][BLOCK]);
                    });
                });
            }
        }
        let Some(sums) = sums.first_chunk_mut::<N>() else { return };
        unrolled!(N, CHANNEL => {
            unrolled!(V, BLOCK => {
                let sum = load(simd, &sums[CHANNEL][BLOCK]) + vectors[CHANNEL][BLOCK];
                sums[CHANNEL][BLOCK].0 = sum.to_array();
            });
        });
    }
}
