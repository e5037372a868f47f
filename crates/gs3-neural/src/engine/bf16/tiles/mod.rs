//! The kernel for tiles (AMX): one instruction multiplies 16 pixels × 32 channels by 32 channels × 16 outputs. In the
//! same time, vectors do a sixteenth of this in f32.
//!
//! The kernel reads pixels with channels side by side in bf16, pixel after pixel. So the part of a pixel in a row of
//! a window is one run of numbers, and the next pixel's run follows. A run is multiplied 32 numbers at a time; the
//! last ones are padded with zeros. Tiles overlap in memory: the rows of a tile begin a pixel apart. Tensors that
//! only such convolutions read are stored in this layout ([`Numbers::Bf16`]). Other tensors are rounded into a buffer
//! of the thread, again for each row of the window.

#[cfg_attr(not(target_arch = "x86_64"), path = "absent.rs")]
mod kernel;

pub use kernel::{TileConfig, fill_halo, store};

use super::{PairWeights, Segment, Source};
use crate::engine::block::{Block, LANES, Layout, Numbers, Sources};
use crate::graph::{Border, Conv2d};

/// Rows of a tile: pixels, or pairs of channels.
const ROWS: usize = 16;

/// Numbers of a row of a tile of bf16.
const DEPTH: usize = 32;

/// Most numbers that a strip reads, 64 KiB of bf16: with more, weights would not fit the second-level cache of small
/// CPUs. Wider convolutions stay f32.
const BUFFER: usize = 32 * 1024;

/// Most products of a pixel: a few more than fit the buffer in strips of 48 pixels.
const STEPS: usize = 128;

/// A convolution ready to run on tiles.
#[derive(Clone, Debug)]
pub struct Tiles {
    conv: Conv2d,
    border: Border,
    /// What is rounded to the buffer, and where in a pixel of that each begins.
    segments: Vec<Segment>,
    starts: Vec<usize>,
    inputs: Vec<Input>,
    steps: Vec<Step>,
    /// Pixels that a strip sees in a row.
    columns: usize,
    /// `[groups of output blocks, bias and steps, blocks of the group]`: the bias is a tile with equal rows.
    weights: Vec<Tile>,
    output_blocks: usize,
}

/// What pixels are read from.
#[derive(Clone, Debug)]
struct Input {
    /// The layout of a tensor stored in bf16; none for the buffer.
    stored: Option<Layout>,
    /// For each number of a pixel, its channel among the channels of all inputs, if it has one.
    channels: Vec<Option<usize>>,
}

/// A product of all pixels.
#[derive(Clone, Copy, Debug)]
struct Step {
    input: usize,
    /// Row of the window.
    line: usize,
    /// Where its 32 numbers begin, from the first that the row of the window sees.
    start: usize,
}

/// A tile of weights or, bit for bit, of f32.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
struct Tile([PairWeights; ROWS]);

/// Blocks of outputs computed together when `left` are left.
fn group(left: usize) -> usize {
    left.min(2)
}

impl Tiles {
    /// Whether a convolution of tensors of these numbers of `channels` is for tiles, in strips of `width` pixels: not
    /// if they are narrower than a tile or see more than the buffer holds.
    pub fn takes(conv: &Conv2d, channels: impl Iterator<Item = usize>, width: usize) -> bool {
        let pixel: usize = channels.map(|channels| channels.next_multiple_of(LANES)).sum();
        let (columns, taps) = (width + 2 * conv.reach(), conv.kernel * conv.kernel);
        let fits = conv.kernel * columns * pixel + DEPTH <= BUFFER && taps * pixel.div_ceil(LANES) <= STEPS;
        width >= ROWS && fits
    }

    /// The tiles of `source`; none if tiles do not fit it.
    pub fn new(source: &Source<'_>) -> Option<Self> {
        let Source { conv, border, .. } = *source;
        let all = source.inputs.iter().map(|layout| layout.shape.channels);
        if !Self::takes(&conv, all, source.width) {
            return None;
        }
        let (mut segments, mut starts, mut joined) = (Vec::new(), Vec::new(), Vec::new());
        let (mut inputs, mut channel) = (Vec::new(), 0);
        for layout in source.inputs {
            let channels = layout.shape.channels;
            match layout.numbers {
                Numbers::F32 => {
                    for segment in Segment::all(std::slice::from_ref(layout)) {
                        starts.push(joined.len());
                        let first = channel + segment.block * LANES;
                        joined.extend((0..segment.channels).map(|c| Some(first + c)));
                        // Pairs are multiplied at once.
                        joined.resize(joined.len().next_multiple_of(2), None);
                        segments.push(segment);
                    }
                }
                Numbers::Bf16 => {
                    let mut of_pixel: Vec<_> = (0..channels).map(|c| Some(channel + c)).collect();
                    of_pixel.resize(layout.blocks() * LANES, None);
                    inputs.push(Input { stored: Some(*layout), channels: of_pixel });
                }
            }
            channel += channels;
        }
        if !segments.is_empty() {
            // Of a tile's rows, only every second row then crosses a cache line: loading the tile takes 20 cycles. It
            // would take 8 with no row crossing, and 50 with all rows crossing; a product takes 16.
            joined.resize(joined.len().next_multiple_of(LANES), None);
            inputs.push(Input { stored: None, channels: joined });
        }
        // Neighbouring columns of a window are one run; others are one each.
        let (runs, columns_of_run) = if conv.dilation == 1 { (1, conv.kernel) } else { (conv.kernel, 1) };
        // Of each number of a step its tap and channel, if it has a weight.
        let (mut steps, mut numbers) = (Vec::new(), Vec::new());
        for (k, Input { channels, .. }) in inputs.iter().enumerate() {
            let pixel = channels.len();
            for (line, run) in (0..conv.kernel).flat_map(|line| (0..runs).map(move |run| (line, run))) {
                for first in (0..columns_of_run * pixel).step_by(DEPTH) {
                    steps.push(Step { input: k, line, start: run * conv.dilation * pixel + first });
                    numbers.push(std::array::from_fn::<_, DEPTH, _>(|k| {
                        let (column, number) = ((first + k) / pixel, (first + k) % pixel);
                        let tap = line * conv.kernel + run * columns_of_run + column;
                        channels[number].filter(|_| column < columns_of_run).map(|channel| (tap, channel))
                    }));
                }
            }
        }
        let (bias, output_blocks) = (source.bias(), source.output_blocks());
        let mut weights = Vec::new();
        let mut first = 0;
        while first < output_blocks {
            let blocks = first..first + group(output_blocks - first);
            weights.extend(blocks.clone().map(|block| Tile::of_sums(&bias[block])));
            for numbers in &numbers {
                weights.extend(blocks.clone().map(|block| {
                    Tile::of_weights(|k, lane| match (numbers[k], block * LANES + lane) {
                        (Some((tap, channel)), output) if output < conv.outputs => {
                            source.weight(output, channel, tap)
                        }
                        _ => 0,
                    })
                }));
            }
            first = blocks.end;
        }
        let columns = source.width + 2 * conv.reach();
        Some(Self { conv, border, segments, starts, inputs, steps, columns, weights, output_blocks })
    }

    /// Writes row `y` to `out`, a strip of `layout`, before the activation.
    pub fn run_row(
        &self,
        tile_config: &TileConfig,
        sources: Sources<'_>,
        layout: &Layout,
        y: isize,
        out: &mut [Block],
    ) {
        kernel::row(self, tile_config, sources, layout, y, out);
    }
}

impl Tile {
    /// Of weights of number `k` of a step for a lane of outputs.
    fn of_weights(weight: impl Fn(usize, usize) -> u16) -> Self {
        let row = |row: usize| PairWeights(std::array::from_fn(|k| weight(2 * row + k % 2, k / 2)));
        Self(std::array::from_fn(row))
    }

    /// The bias tile: every pixel has the sums `block`.
    fn of_sums(block: &Block) -> Self {
        let halves = |k: usize| (block.0[k / 2].to_bits() >> (16 * (k % 2))) as u16;
        Self([PairWeights(std::array::from_fn(halves)); ROWS])
    }
}
