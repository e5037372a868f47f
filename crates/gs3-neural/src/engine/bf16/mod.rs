//! Convolutions in bf16 with sums in f32, on x86 CPUs that multiply bf16.
//!
//! There is a kernel for each of the two instructions that processors have for it ([`Unit`]). A row of a convolution
//! rounds what it sees of tensors in f32 to a buffer of the thread; tensors that only AMX reads are stored in bf16.
//!
//! All `unsafe` code of the engine is in this folder: instructions that the compiler cannot know the machine has, and
//! prefetching.

#![cfg_attr(
    not(target_arch = "x86_64"),
    allow(dead_code, reason = "no unit is available, so nothing is made or run")
)]

mod pairs;
mod tiles;
mod unit;

pub use pairs::prefetch;
pub use tiles::{TileConfig, Tiles, fill_halo, store};
pub use unit::Unit;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::{Segment, Source};
use super::math::activate;
use super::ops::load;
use crate::graph::Activation;
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

impl Bf16Convolution {
    /// The convolution of `source` on `unit`, if the machine has it. None if f32 is faster: on images of few columns,
    /// or with more inputs than caches hold.
    pub fn new(unit: Unit, source: &Source<'_>) -> Option<Self> {
        let kernel = match unit {
            _ if !unit.is_available() => None,
            Unit::Avx512Bf16 => Pairs::new(source).map(Kernel::Pairs),
            Unit::Amx => Tiles::new(source).map(Kernel::Tiles),
        };
        Some(Self { activation: source.conv.activation, kernel: kernel? })
    }

    /// Whether it runs on tiles: faster with a [`TileConfig`] that is there already.
    pub fn is_on_tiles(&self) -> bool {
        matches!(self.kernel, Kernel::Tiles(_))
    }

    /// Writes row `y` to `out`, a row of `layout` or a strip of one; its halo is left.
    pub fn run_row(
        &self,
        level: Level,
        tile_config: Option<&TileConfig>,
        sources: Sources<'_>,
        layout: &Layout,
        y: usize,
        out: &mut [Block],
    ) {
        match &self.kernel {
            Kernel::Pairs(pairs) => pairs.run_row(sources, layout, y as isize, out),
            Kernel::Tiles(tiles) => match tile_config {
                Some(tile_config) => tiles.run_row(tile_config, sources, layout, y as isize, out),
                None => tiles.run_row(&TileConfig::new(), sources, layout, y as isize, out),
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
