//! Convolutions 1×1 and 3×3 with zero borders.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x16};
use rayon::prelude::*;

use super::features::{Features, RUN};

/// Output channels computed together: 4 channels × 4 vectors of pixels are 16 accumulators, half the registers.
const GROUP: usize = 4;
const LANES: usize = 16;

/// A convolution, `side`×`side` (1 or 3).
#[derive(Clone, Debug)]
pub(super) struct Conv {
    inputs: usize,
    outputs: usize,
    side: usize,
    /// `[outputs / GROUP, inputs, side², GROUP]`, outputs rounded up with zeros.
    weights: Vec<f32>,
    /// `[outputs]`, rounded up with zeros.
    bias: Vec<f32>,
}

impl Conv {
    /// From weights `[outputs, inputs, side, side]` and bias `[outputs]` (none: zeros), whose lengths fit.
    pub fn new(outputs: usize, inputs: usize, side: usize, weights: &[f32], bias: Option<&[f32]>) -> Self {
        let groups = outputs.div_ceil(GROUP);
        let taps = side * side;
        let mut packed = vec![0.0; groups * inputs * taps * GROUP];
        for o in 0..outputs {
            for i in 0..inputs {
                for t in 0..taps {
                    packed[((o / GROUP * inputs + i) * taps + t) * GROUP + o % GROUP] =
                        weights[(o * inputs + i) * taps + t];
                }
            }
        }
        let mut padded = vec![0.0; groups * GROUP];
        if let Some(bias) = bias {
            padded[..outputs].copy_from_slice(bias);
        }
        Self { inputs, outputs, side, weights: packed, bias: padded }
    }

    /// The convolution of `input`, which has `inputs` channels.
    pub fn apply(&self, input: &Features) -> Features {
        let mut output = Features::new(self.outputs, input.width, input.height);
        let level = Level::new();
        output.rows_mut().for_each(|(y, row)| {
            dispatch!(level, simd => self.row(simd, input, y as isize, row));
        });
        output
    }

    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, input: &Features, y: isize, out: &mut [f32]) {
        let stride = input.stride;
        let reach = (self.side / 2) as isize;
        let rows = [input.row(y - reach), input.row(y), input.row(y + reach)];
        let taps = self.side * self.side;
        for (group, out) in out.chunks_mut(GROUP * stride).enumerate() {
            let weights = &self.weights[group * self.inputs * taps * GROUP..][..self.inputs * taps * GROUP];
            for start in (0..stride - 2).step_by(RUN) {
                let mut sums = [[f32x16::splat(simd, 0.0); RUN / LANES]; GROUP];
                for (g, sums) in sums.iter_mut().enumerate() {
                    *sums = [f32x16::splat(simd, self.bias[group * GROUP + g]); RUN / LANES];
                }
                for (i, weights) in weights.chunks_exact(taps * GROUP).enumerate() {
                    for (t, weights) in weights.chunks_exact(GROUP).enumerate() {
                        // A 1×1 convolution reads the centre row and column.
                        let (dy, dx) = if self.side == 1 { (1, 1) } else { (t / 3, t % 3) };
                        let at = i * stride + start + dx;
                        let line = &rows[dy][at..];
                        for v in 0..RUN / LANES {
                            let values = f32x16::from_slice(simd, &line[v * LANES..(v + 1) * LANES]);
                            for (sums, weight) in sums.iter_mut().zip(weights) {
                                sums[v] = values.mul_add(*weight, sums[v]);
                            }
                        }
                    }
                }
                for (sums, channel) in sums.iter().zip(out.chunks_exact_mut(stride)) {
                    for (v, sum) in sums.iter().enumerate() {
                        sum.store_slice(&mut channel[1 + start + v * LANES..1 + start + (v + 1) * LANES]);
                    }
                }
            }
            // What was computed beyond the image is border again.
            for channel in out.chunks_exact_mut(stride) {
                channel[1 + input.width..].fill(0.0);
            }
        }
    }
}
