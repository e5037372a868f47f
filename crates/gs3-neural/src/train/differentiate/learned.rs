//! Adjoints of operations with learned numbers for each channel.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::ops::Write;
use crate::engine::block::{Block, Layout, Sources};
use crate::engine::learned::{Learned, Moments, sum};
use crate::engine::ops::load;
use crate::graph::Op;

/// The adjoint of [`Op::Prelu`] or [`Op::LayerNorm`].
pub struct Adjoint<'a> {
    pub learned: &'a Learned,
    /// Results of the forward pass.
    pub values: &'a [Block],
    /// The input's.
    pub input: &'a Layout,
    /// Where the derivative by the result is.
    pub v: &'a Layout,
}

impl Adjoint<'_> {
    /// Replaces the derivative by the result, in `v`, by that by the input, and adds those by weight and bias,
    /// `[blocks of channels]`.
    pub fn run(&self, level: Level, v: &mut [Block], v_weight: &mut [Block], v_bias: &mut [Block]) {
        dispatch!(level, simd => self.run_on(simd, v, v_weight, v_bias));
    }

    #[inline(always)]
    fn run_on<S: Simd>(&self, simd: S, v: &mut [Block], v_weight: &mut [Block], v_bias: &mut [Block]) {
        let values = Sources::all(self.values);
        let v = &mut v[self.v.start..][..self.v.len()];
        let (stride, halo) = (self.v.stride(), self.v.halo);
        for (y, row) in v.chunks_exact_mut(self.v.row_len()).enumerate() {
            if let Op::LayerNorm { epsilon } = self.learned.op {
                for x in 0..self.v.shape.width {
                    let pixel = |b: usize| &values.pixels(self.input, y, b)[x];
                    let moments = Moments::new(simd, self.v.shape.channels, epsilon, pixel);
                    self.normal(simd, moments, pixel, |b| b * stride + halo + x, row, [v_weight, v_bias]);
                }
                continue;
            }
            for (b, (slopes, v_slopes)) in self.learned.weight.iter().zip(&mut *v_weight).enumerate() {
                let (slopes, zero) = (load(simd, slopes), f32x16::splat(simd, 0.0));
                let line = &mut row[b * stride + halo..][..self.v.shape.width];
                let mut sums = zero;
                for (v, x) in line.iter_mut().zip(values.pixels(self.input, y, b)) {
                    let (x, v_result) = (load(simd, x), load(simd, v));
                    let positive = x.simd_gt(zero);
                    v.0 = positive.select(v_result, v_result * slopes).to_array();
                    sums += positive.select(zero, v_result * x);
                }
                v_slopes.0 = (load(simd, v_slopes) + sums).to_array();
            }
        }
    }

    /// A pixel of normalisation. With x̂ the normalised channels and w = v · weight: (w − mean(w) − x̂ mean(w x̂)) ·
    /// scale.
    #[inline(always)]
    fn normal<'a, S: Simd>(
        &self,
        simd: S,
        moments: Moments,
        pixel: impl Fn(usize) -> &'a Block,
        place: impl Fn(usize) -> usize,
        row: &mut [Block],
        [v_weight, v_bias]: [&mut [Block]; 2],
    ) {
        let channels = self.v.shape.channels;
        let weight = &self.learned.weight[..];
        let mean =
            sum(simd, channels, |b| load(simd, &row[place(b)]) * load(simd, &weight[b])) / channels as f32;
        let along = sum(simd, channels, |b| {
            load(simd, &row[place(b)]) * load(simd, &weight[b]) * moments.normal(simd, pixel(b))
        }) / channels as f32;
        for b in 0..weight.len() {
            let (v, x) = (load(simd, &row[place(b)]), moments.normal(simd, pixel(b)));
            let weighed = v * load(simd, &weight[b]);
            v_weight[b].0 = v.mul_add(x, load(simd, &v_weight[b])).to_array();
            v_bias[b].0 = (v + load(simd, &v_bias[b])).to_array();
            row[place(b)].0 = ((weighed - mean - x * along) * moments.scale).to_array();
        }
    }

    /// Writes what [`Adjoint::run`] left to the derivative by the input, `out`.
    pub fn hand_on(&self, level: Level, v: Sources<'_>, layout: &Layout, out: &mut [Block], write: Write) {
        dispatch!(level, simd => {
            for (y, row) in out.chunks_exact_mut(layout.row_len()).enumerate() {
                for (b, line) in row.chunks_exact_mut(layout.stride()).enumerate() {
                    let from = v.pixels(self.v, y, b);
                    write.each(simd, &mut line[layout.halo..][..layout.shape.width], |x| load(simd, &from[x]));
                }
            }
        });
    }
}
