//! Convolutions of one output channel. Their vectors are pixels, not channels: of 16 channels 15 would be wasted.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::{Seen, Segment, Source};
use super::math::activate;
use crate::graph::{Border, Conv2d};

/// Vectors of pixels computed together: one strip.
const VECTORS: usize = 3;

/// Pixels that a window may reach beside them.
const MARGIN: usize = 32;

/// Kernels from which on it is faster: each channel of a row of the window costs a copy of its pixels, each column of
/// it a multiply-add for 16 pixels.
const KERNEL: usize = 5;

/// A convolution ready to run.
#[derive(Clone, Debug)]
pub struct ThinConvolution {
    conv: Conv2d,
    border: Border,
    segments: Vec<Segment>,
    /// `[rows of the window, channels, columns]`.
    weights: Vec<f32>,
    bias: f32,
}

impl ThinConvolution {
    /// Whether it is for `conv` in strips of `width` pixels: if other kernels are slower and vectors hold as many.
    pub fn takes(conv: &Conv2d, width: usize) -> bool {
        let fits = width <= VECTORS * LANES && 2 * conv.reach() <= MARGIN;
        conv.outputs == 1 && conv.kernel >= KERNEL && fits
    }

    /// The convolution of `source`; none if this kernel does not fit it.
    pub fn new(source: &Source<'_>) -> Option<Self> {
        let Source { conv, border, inputs, weights, bias, .. } = *source;
        if !Self::takes(&conv, source.width) {
            return None;
        }
        let segments = Segment::all(inputs);
        let channels: usize = segments.iter().map(|s| s.channels).sum();
        let row = |ky: usize| (0..channels).map(move |c| (c * conv.kernel + ky) * conv.kernel);
        let weights = (0..conv.kernel).flat_map(row).flat_map(|first| &weights[first..][..conv.kernel]);
        let (weights, bias) = (weights.copied().collect(), bias.first().copied().unwrap_or(0.0));
        Some(Self { conv, border, segments, weights, bias })
    }

    /// Writes row `y` to `out`, a strip of `layout`.
    pub fn run_row(&self, level: Level, sources: Sources<'_>, layout: &Layout, y: usize, out: &mut [Block]) {
        dispatch!(level, simd => self.row(simd, sources, layout, y as isize, out));
    }

    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        let Conv2d { kernel, dilation, activation, .. } = self.conv;
        let (width, reach) = (layout.shape.width, self.conv.reach());
        // Beyond the width and the window's reach, numbers go into sums that are never read.
        let mut pixels = [[0.0; VECTORS * LANES + MARGIN]; 2];
        let mut sums = [f32x16::splat(simd, self.bias); VECTORS];
        let mut weights = self.weights.chunks_exact(kernel);
        let seen = Seen { conv: &self.conv, border: self.border, sources };
        for ky in 0..kernel {
            for segment in &self.segments {
                let row = seen.pixels(segment, ky, y, 0).map(|row| &row[..width + 2 * reach]);
                // A pixel is a cache line; two of its channels are processed at once.
                for c in (0..segment.channels).step_by(2) {
                    let is_pair = c + 1 < segment.channels;
                    let pair = [weights.next(), if is_pair { weights.next() } else { None }];
                    let Some(row) = row else { continue };
                    for (k, from) in row.iter().enumerate() {
                        (pixels[0][k], pixels[1][k]) = (from.0[c], from.0[(c + 1) % LANES]);
                    }
                    for (pixels, weights) in pixels.iter().zip(pair.into_iter().flatten()) {
                        for (kx, weight) in weights.iter().enumerate() {
                            let seen = &pixels[kx * dilation..];
                            for (k, sum) in sums.iter_mut().enumerate() {
                                let seen = f32x16::from_slice(simd, &seen[k * LANES..][..LANES]);
                                *sum = seen.mul_add(*weight, *sum);
                            }
                        }
                    }
                }
            }
        }
        for (sum, out) in sums.into_iter().zip(out[layout.halo..][..width].chunks_mut(LANES)) {
            let values = activate(simd, activation, sum).to_array();
            out.iter_mut().zip(values).for_each(|(out, value)| out.0[0] = value);
        }
    }
}
