//! Operations of pixels that have learned numbers for each channel.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::fill_halo;
use super::ops::load;
use crate::graph::{Border, Op};
use crate::weights::Weights;

/// [`Op::Prelu`] or [`Op::LayerNorm`] with its numbers.
#[derive(Clone, Debug)]
pub struct Learned {
    pub op: Op,
    /// `[blocks of channels]`, 0 beyond the channels, as is the bias.
    pub weight: Vec<Block>,
    pub bias: Vec<Block>,
}

impl Learned {
    /// The parameters of the layer `name`, if `op` has any.
    pub fn new(op: &Op, name: &str, weights: &Weights) -> Option<Self> {
        let blocks = |kind: &str| {
            let lanes = |values: &[f32]| {
                let mut block = Block::default();
                block.0[..values.len()].copy_from_slice(values);
                block
            };
            weights.parameter(name, kind).chunks(LANES).map(lanes).collect()
        };
        matches!(op, Op::Prelu | Op::LayerNorm { .. }).then(|| Self {
            op: *op,
            weight: blocks("weight"),
            bias: blocks("bias"),
        })
    }

    /// Writes row `y`, with halo, to `out`, a row of `layout` or a strip of one.
    pub fn run_row(
        &self,
        level: Level,
        border: Border,
        sources: Sources<'_>,
        input: &Layout,
        layout: &Layout,
        y: usize,
        out: &mut [Block],
    ) {
        dispatch!(level, simd => self.row(simd, sources, input, layout, y, out));
        fill_halo(border, layout, out);
    }

    #[inline(always)]
    fn row<S: Simd>(
        &self,
        simd: S,
        sources: Sources<'_>,
        input: &Layout,
        layout: &Layout,
        y: usize,
        out: &mut [Block],
    ) {
        let (stride, halo) = (layout.stride(), layout.halo);
        match self.op {
            Op::LayerNorm { epsilon } => {
                for x in 0..layout.shape.width {
                    let pixel = |b: usize| &sources.pixels(input, y, b)[x];
                    let moments = Moments::new(simd, layout.shape.channels, epsilon, pixel);
                    for (b, (weight, bias)) in self.weight.iter().zip(&self.bias).enumerate() {
                        let normal = moments.normal(simd, pixel(b));
                        let value = normal.mul_add(load(simd, weight), load(simd, bias));
                        out[b * stride + halo + x].0 = value.to_array();
                    }
                }
            }
            _ => {
                for (b, slopes) in self.weight.iter().enumerate() {
                    let (slopes, zero) = (load(simd, slopes), f32x16::splat(simd, 0.0));
                    let out = &mut out[b * stride + halo..][..layout.shape.width];
                    for (out, x) in out.iter_mut().zip(sources.pixels(input, y, b)) {
                        let x = load(simd, x);
                        out.0 = x.simd_gt(zero).select(x, x * slopes).to_array();
                    }
                }
            }
        }
    }
}

/// What normalises the channels of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Moments {
    pub mean: f32,
    /// 1 / √(variance + epsilon).
    pub scale: f32,
}

impl Moments {
    /// The values of a pixel of `channels`; `pixel` gives the blocks.
    #[inline(always)]
    pub fn new<'a, S: Simd>(
        simd: S,
        channels: usize,
        epsilon: f32,
        pixel: impl Fn(usize) -> &'a Block,
    ) -> Self {
        let mean = sum(simd, channels, |b| load(simd, pixel(b))) / channels as f32;
        let square = |b: usize| {
            let difference = load(simd, pixel(b)) - mean;
            difference * difference
        };
        let variance = sum(simd, channels, square) / channels as f32;
        Self { mean, scale: 1.0 / (variance + epsilon).sqrt() }
    }

    /// The normalised channels of a block.
    #[inline(always)]
    pub fn normal<S: Simd>(self, simd: S, block: &Block) -> f32x16<S> {
        (load(simd, block) - self.mean) * self.scale
    }
}

/// The sum of the first `channels` of the lanes of all blocks; lanes beyond them may hold anything. `block` is called at one
/// place here, or might not be inlined where vectors are enabled.
#[inline(always)]
pub fn sum<S: Simd>(simd: S, channels: usize, block: impl Fn(usize) -> f32x16<S>) -> f32 {
    let (mut sums, mut rest) = (f32x16::splat(simd, 0.0), 0.0);
    for b in 0..channels.div_ceil(LANES) {
        let (values, left) = (block(b), channels - b * LANES);
        if left >= LANES {
            sums += values;
        } else {
            rest = values.to_array()[..left].iter().sum();
        }
    }
    sums.to_array().iter().sum::<f32>() + rest
}
