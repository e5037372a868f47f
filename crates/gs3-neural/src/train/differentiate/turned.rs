//! The derivative by a convolution's inputs: the forward kernel with the weights turned round.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch};

use super::ops::Write;
use super::plan::{Step, Target, extension, targets};
use crate::engine::block::{Block, LANES, Layout, Sources};
use crate::engine::conv::Convolution;
use crate::engine::ops::load;
use crate::graph::{Activation, Border, Conv2d, Shape};

/// A convolution from derivatives by a result to those by its inputs. Inputs by which none are needed are left out.
///
/// Where the forward pass repeats the border, the copies beside the image have derivatives too. They are computed as if
/// the image were so much larger, and added to those by the pixels that they are copies of.
#[derive(Clone, Debug)]
pub struct Turned {
    convolution: Convolution,
    targets: Vec<Target>,
    /// Pixels on each side of the image that are copies of the border.
    extension: usize,
    /// A row of the results, the copies included, a block for each target.
    row: Layout,
}

impl Turned {
    /// The turned convolution of the convolution `step`, with `weights` `oihw`; none if no derivatives are needed.
    pub fn new(border: Border, conv: &Conv2d, step: &Step, steps: &[Step], weights: &[f32]) -> Option<Self> {
        let targets = targets(step, steps);
        let v = step.v.filter(|_| !targets.is_empty())?;
        let extension = extension(border, conv);
        let (taps, outputs) = (conv.kernel * conv.kernel, targets.len() * LANES);
        let channels: usize = step.layouts.iter().map(|layout| layout.shape.channels).sum();
        let mut turned = vec![0.0; outputs * conv.outputs * taps];
        for (target, turned) in targets.iter().zip(turned.chunks_exact_mut(LANES * conv.outputs * taps)) {
            for (i, turned) in turned.chunks_exact_mut(conv.outputs * taps).take(target.channels).enumerate()
            {
                for (o, turned) in turned.chunks_exact_mut(taps).enumerate() {
                    let weights = &weights[(o * channels + target.first + i) * taps..][..taps];
                    turned.iter_mut().zip(weights.iter().rev()).for_each(|(t, w)| *t = *w);
                }
            }
        }
        let conv = Conv2d { outputs, bias: false, activation: Activation::Identity, ..*conv };
        // The derivative with the zeros beside it: where copies are, zeros are the image.
        let width = v.shape.width + 2 * extension;
        let wide = Layout::whole(Shape { width, ..v.shape }, v.halo - extension, v.start);
        let convolution = Convolution::new(conv, Border::Zero, &[wide], &turned, &[]);
        let row = Layout::whole(Shape { height: 1, width, channels: outputs }, 0, 0);
        Some(Self { convolution, targets, extension, row })
    }

    /// Blocks of memory for a row.
    pub fn row_len(&self) -> usize {
        self.row.row_len()
    }

    /// The rows to be run: the image's rows, and the rows of the copies above and below.
    pub fn rows(&self) -> Range<isize> {
        let height = self.targets.first().map_or(0, |target| target.v.shape.height);
        -(self.extension as isize)..(height + self.extension) as isize
    }

    /// Adds row `y` to the derivatives by inputs, which are in `v` like that by the result, or writes it where they are
    /// not `begun`. Rows come in order. `row` is of [`Turned::row_len`].
    pub fn run_row(&self, level: Level, y: isize, v: &mut [Block], row: &mut [Block], begun: &[bool]) {
        self.convolution.run_row(level, Sources::all(v), &self.row, y, row);
        let first = self.rows().start;
        for (k, (target, line)) in self.targets.iter().zip(row.chunks_exact(self.row.stride())).enumerate() {
            let layout = &target.v;
            let place = y.clamp(0, layout.shape.height as isize - 1);
            let same = |other: &Target| (other.step, other.block) == (target.step, target.block);
            // Row 0 comes first as the uppermost copy; other copies come to rows that are there.
            let again = y > first && (y <= 0 || y > place);
            let write = match begun[target.step] || self.targets[..k].iter().any(same) || again {
                true => Write::Add,
                false => Write::Set,
            };
            let start = layout.start + place as usize * layout.row_len() + target.block * layout.stride();
            let out = &mut v[start + layout.halo..][..layout.shape.width];
            dispatch!(level, simd => fold(simd, line, self.extension, out, write));
        }
    }

    /// Notes that the derivatives by inputs are `begun`.
    pub fn finish(&self, begun: &mut [bool]) {
        self.targets.iter().for_each(|target| begun[target.step] = true);
    }
}

/// Brings a line with `extension` copies on each side to the line of the image.
#[inline(always)]
fn fold<S: Simd>(simd: S, line: &[Block], extension: usize, out: &mut [Block], write: Write) {
    let width = out.len();
    write.each(simd, out, |x| load(simd, &line[extension + x]));
    let (before, after) = (&line[..extension], &line[extension + width..]);
    for (copies, place) in [(before, 0), (after, width - 1)] {
        for copy in copies {
            out[place].0 = (load(simd, &out[place]) + load(simd, copy)).to_array();
        }
    }
}
