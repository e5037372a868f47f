//! Convolutions in bf16 with sums in f32, on x86 machines whose processors multiply bf16.
//!
//! Tensors stay f32: a row of a convolution rounds what it sees of its inputs to bf16, in a buffer of the thread. Two kernels
//! go on from there, for the two instructions that processors have for it ([`Unit`]).
//!
//! All `unsafe` code of the engine is in this folder: instructions that the compiler cannot know the machine has.

#![cfg_attr(
    not(target_arch = "x86_64"),
    allow(dead_code, reason = "no unit is available, so nothing is made or run")
)]

mod pairs;
mod tiles;
mod unit;

pub use tiles::{Shaped, Tiles, fill_halo, store};
pub use unit::Unit;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::Segment;
use super::math::activate;
use super::ops::load;
use crate::graph::{Activation, Border, Conv2d};
use pairs::Pairs;

/// A convolution ready to run in bf16.
#[derive(Clone, Debug)]
pub struct Bf16Convolution {
    activation: Activation,
    kernel: Kernel,
}

#[derive(Clone, Debug)]
enum Kernel {
    Pairs(Pairs),
    Tiles(Tiles),
}

/// What a convolution is made from: that of `inputs`, concatenated, in strips of `width` pixels, with `weights` `oihw` and
/// `bias`, empty where there is none.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    pub conv: Conv2d,
    pub border: Border,
    pub inputs: &'a [Layout],
    pub width: usize,
    pub weights: &'a [f32],
    pub bias: &'a [f32],
}

impl Bf16Convolution {
    /// That of `source` on `unit`, if the machine has it; none where f32 is better: on images of few columns, or with more
    /// inputs than caches hold.
    pub fn new(unit: Unit, source: &Source<'_>) -> Option<Self> {
        let kernel = match unit {
            _ if !unit.is_available() => None,
            Unit::Pairs => Pairs::new(source).map(Kernel::Pairs),
            Unit::Tiles => Tiles::new(source).map(Kernel::Tiles),
        };
        Some(Self { activation: source.conv.activation, kernel: kernel? })
    }

    /// Whether it runs faster with [`Shaped`] tiles.
    pub fn is_on_tiles(&self) -> bool {
        matches!(self.kernel, Kernel::Tiles(_))
    }

    /// Writes row `y` to `out`, a row of `layout` or a strip of one; its halo is left.
    pub fn run_row(
        &self,
        level: Level,
        shaped: Option<&Shaped>,
        sources: Sources<'_>,
        layout: &Layout,
        y: usize,
        out: &mut [Block],
    ) {
        match &self.kernel {
            Kernel::Pairs(pairs) => pairs.run_row(sources, layout, y as isize, out),
            Kernel::Tiles(tiles) => match shaped {
                Some(shaped) => tiles.run_row(shaped, sources, layout, y as isize, out),
                None => tiles.run_row(&Shaped::new(), sources, layout, y as isize, out),
            },
        }
        if self.activation != Activation::Identity {
            dispatch!(level, simd => for block in &mut *out {
                block.0 = activate(simd, self.activation, load(simd, block)).to_array();
            });
        }
    }
}

impl Source<'_> {
    /// The weight of input channel `i` of all for output channel `o`, rounded.
    fn weight(&self, o: usize, i: usize, tap: usize) -> u16 {
        let channels: usize = self.inputs.iter().map(|layout| layout.shape.channels).sum();
        rounded(self.weights[(o * channels + i) * self.taps() + tap])
    }

    fn taps(&self) -> usize {
        self.conv.kernel * self.conv.kernel
    }

    fn output_blocks(&self) -> usize {
        self.conv.outputs.div_ceil(LANES)
    }

    /// `[output blocks]`, 0 beyond the channels.
    fn bias(&self) -> Vec<Block> {
        let lane = |o: usize| self.bias.get(o).copied().unwrap_or(0.0);
        (0..self.output_blocks()).map(|b| Block(std::array::from_fn(|l| lane(b * LANES + l)))).collect()
    }
}

/// What of an input a row of a window sees.
#[derive(Clone, Copy, Debug)]
struct Seen<'a> {
    conv: &'a Conv2d,
    border: Border,
    sources: Sources<'a>,
}

impl<'a> Seen<'a> {
    /// The pixels of `segment` from the first that row `line` of the window around pixel `x` of row `y` sees on; none where
    /// these are zero.
    fn pixels(&self, segment: &Segment, line: usize, y: isize, x: usize) -> Option<&'a [Block]> {
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

/// 16 output channels × a pair of input channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
struct PairWeights([u16; 2 * LANES]);

/// The nearest bf16, of two the even one; weights are finite.
fn rounded(value: f32) -> u16 {
    let bits = value.to_bits();
    // Half a unit of the last place that stays, less one bit unless that place is odd.
    let half = 0x7FFF + (bits >> 16 & 1);
    // The largest finite numbers would become infinite: they stay.
    (bits.checked_add(half).filter(|sum| sum & 0x7F80_0000 != 0x7F80_0000).unwrap_or(bits) >> 16) as u16
}

#[cfg(test)]
mod tests;
