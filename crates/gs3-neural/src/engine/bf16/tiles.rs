//! The kernel for tiles (AMX): one instruction multiplies 16 pixels × 32 channels by 32 channels × 16 outputs, as fast as 8 to
//! 16 instructions of vectors.
//!
//! In the buffer the channels of a pixel are side by side, those of all inputs, and pixels follow one another. So what a row of
//! a window sees of a pixel is one run of numbers, channels of the next pixel after those of one; it is multiplied 32 at a time,
//! the last ones with zeros. Tiles overlap in memory: rows of one begin a pixel apart.
//!
//! Measured (`examples/speed.rs … bf16`) with two threads of Granite Rapids, whose f32 multiply-adds peak at 430 GFLOP/s and whose
//! tiles at 6,200.

use super::{PairWeights, Segment, Source};
use crate::engine::block::{Block, LANES, Layout, Sources};
use crate::graph::{Border, Conv2d};

/// Rows of a tile: pixels, or pairs of channels.
const ROWS: usize = 16;

/// Numbers of a row of a tile of bf16.
const DEPTH: usize = 32;

/// Numbers that a strip sees at most, 64 KiB of bf16: more would leave no room for weights in the second cache of small
/// processors. Wider convolutions stay f32.
const BUFFER: usize = 32 * 1024;

/// A convolution ready to run on tiles.
#[derive(Clone, Debug)]
pub struct Tiles {
    conv: Conv2d,
    border: Border,
    segments: Vec<Segment>,
    /// Where in a pixel of the buffer each segment begins, and the numbers of a pixel in all: each segment's are even, as
    /// channels are multiplied in pairs.
    starts: Vec<usize>,
    pixel: usize,
    /// Pixels of a line of the buffer.
    columns: usize,
    /// Where in the buffer the 32 numbers of each step begin that the first pixel sees, in bytes.
    places: Vec<usize>,
    /// `[groups of output blocks, bias and steps, blocks of the group, rows of a tile]`: bias as a tile whose rows are equal.
    weights: Vec<Tile>,
    output_blocks: usize,
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
    /// That of `source`; none if its strips are narrower than a tile or see more than the buffer holds.
    pub fn new(source: &Source<'_>) -> Option<Self> {
        let conv = source.conv;
        let segments = Segment::all(source.inputs);
        let mut starts = Vec::new();
        // Of each number of a pixel, its channel.
        let mut channels = Vec::new();
        let mut channel = 0;
        for segment in &segments {
            starts.push(channels.len());
            channels.extend((0..segment.channels).map(|c| Some(channel + c)));
            channels.resize(channels.len().next_multiple_of(2), None);
            channel += segment.channels;
        }
        // So that of a tile's rows only every second lies across two cache lines: loading it takes 20 cycles then, 8 where none
        // does, 50 where all do; a product takes 16.
        let pixel = channels.len().next_multiple_of(DEPTH / 2);
        channels.resize(pixel, None);
        let columns = source.width + 2 * conv.reach();
        if source.width < ROWS || conv.kernel * columns * pixel + DEPTH > BUFFER {
            return None;
        }
        // Neighbouring columns of a window are one run; others are one each.
        let (runs, taps_of_run) = if conv.dilation == 1 { (1, conv.kernel) } else { (conv.kernel, 1) };
        let (mut places, mut steps) = (Vec::new(), Vec::new());
        for line in 0..conv.kernel {
            for run in 0..runs {
                for first in (0..taps_of_run * pixel).step_by(DEPTH) {
                    let start = (line * columns + run * conv.dilation) * pixel + first;
                    places.push(start * size_of::<u16>());
                    // Of each number its tap and channel, if it has a weight.
                    steps.push(std::array::from_fn::<_, DEPTH, _>(|k| {
                        let (tap, number) = ((first + k) / pixel, (first + k) % pixel);
                        let column = run * taps_of_run + tap;
                        (tap < taps_of_run).then_some(())?;
                        channels[number].map(|channel| (line * conv.kernel + column, channel))
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
            for step in &steps {
                weights.extend(blocks.clone().map(|block| {
                    Tile::of_weights(|k, lane| match (step[k], block * LANES + lane) {
                        (Some((tap, channel)), output) if output < conv.outputs => {
                            source.weight(output, channel, tap)
                        }
                        _ => 0,
                    })
                }));
            }
            first = blocks.end;
        }
        let border = source.border;
        Some(Self { conv, border, segments, starts, pixel, columns, places, weights, output_blocks })
    }

    /// Writes row `y` to `out`, a strip of `layout`, before the activation.
    pub fn run_row(&self, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        kernel::row(self, sources, layout, y, out);
    }
}

impl Tile {
    /// Of weights of number `k` of a step for a lane of outputs.
    fn of_weights(weight: impl Fn(usize, usize) -> u16) -> Self {
        let row = |row: usize| PairWeights(std::array::from_fn(|k| weight(2 * row + k % 2, k / 2)));
        Self(std::array::from_fn(row))
    }

    /// Of sums that are those of `block` for all pixels.
    fn of_sums(block: &Block) -> Self {
        let halves = |k: usize| (block.0[k / 2].to_bits() >> (16 * (k % 2))) as u16;
        Self([PairWeights(std::array::from_fn(halves)); ROWS])
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod kernel {
    use super::{Block, Layout, Sources, Tiles};

    /// There is none: no [`Tiles`] are made.
    pub fn row(_: &Tiles, _: Sources<'_>, _: &Layout, _: isize, _: &mut [Block]) {}
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "instructions that not every machine has")]
mod kernel {
    use std::arch::asm;
    use std::arch::x86_64::{
        __m256bh, __m256i, _mm256_mask_storeu_epi16, _mm512_load_ps, _mm512_maskz_cvtneps_pbh,
    };
    use std::cell::RefCell;

    use super::super::Seen;
    use super::{BUFFER, Block, DEPTH, LANES, Layout, ROWS, Sources, Tile, Tiles, group};

    /// Bytes of a row of a tile.
    const ROW: usize = 64;

    /// What a strip sees.
    #[repr(C, align(64))]
    struct Buffer([u16; BUFFER]);

    thread_local! {
        static BUFFER_OF_THREAD: RefCell<Box<Buffer>> = RefCell::new(Box::new(Buffer([0; BUFFER])));
    }

    /// What `LDTILECFG` reads: all eight tiles have 16 rows of 64 bytes.
    #[repr(C, align(64))]
    struct Shapes([u8; 64]);

    static SHAPES: Shapes = {
        let mut bytes = [0; 64];
        // The palette; from byte 16 on 16-bit numbers of bytes of a row, from byte 48 on numbers of rows.
        bytes[0] = 1;
        let mut tile = 0;
        while tile < 8 {
            bytes[16 + 2 * tile] = ROW as u8;
            bytes[48 + tile] = ROWS as u8;
            tile += 1;
        }
        Shapes(bytes)
    };

    /// Writes row `y` to `out`, a strip of `layout`, before the activation.
    pub fn row(tiles: &Tiles, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        BUFFER_OF_THREAD.with_borrow_mut(|buffer| {
            // SAFETY: `Tiles` are only made where `Unit::is_available` found the instructions of both and the right to use tiles.
            unsafe {
                round(tiles, sources, y, buffer);
                multiply(tiles, buffer, layout, out);
            }
        });
    }

    /// Rounds what the strip sees to `buffer`, `[rows, columns, numbers of a pixel]`.
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
    fn round(tiles: &Tiles, sources: Sources<'_>, y: isize, buffer: &mut Buffer) {
        let Tiles { conv, border, segments, starts, pixel, columns, .. } = tiles;
        let seen = Seen { conv, border: *border, sources };
        let len = columns * pixel;
        for (line, numbers) in buffer.0.chunks_exact_mut(len).take(conv.kernel).enumerate() {
            for (k, segment) in segments.iter().enumerate() {
                let Some(pixels) = seen.pixels(segment, line, y, 0) else {
                    numbers.fill(0);
                    break;
                };
                // Lanes beyond the channels hold anything: they become 0, and are written up to the next segment.
                let (start, next) = (starts[k], *starts.get(k + 1).unwrap_or(pixel));
                let count = (next - start).min(LANES);
                let [there, written] =
                    [segment.channels, count].map(|count| (u32::MAX >> (32 - count)) as u16);
                for (to, from) in numbers.chunks_exact_mut(*pixel).zip(pixels) {
                    let to = &mut to[start..][..count];
                    // SAFETY: a block is as large as a vector and aligned to its size; what is written is as long as `to`.
                    unsafe {
                        let pixel = _mm512_maskz_cvtneps_pbh(there, _mm512_load_ps(from.0.as_ptr()));
                        let pixel = std::mem::transmute::<__m256bh, __m256i>(pixel);
                        _mm256_mask_storeu_epi16(to.as_mut_ptr().cast(), written, pixel);
                    }
                }
                if start + count < next {
                    numbers.chunks_exact_mut(*pixel).for_each(|to| to[start + count..next].fill(0));
                }
            }
        }
        // The last step of the last pixel may see beyond: anything there is multiplied with 0, but must be a number.
        buffer.0[conv.kernel * len..][..DEPTH].fill(0);
    }

    /// All sums of the strip, to `out`.
    ///
    /// # Safety
    /// The machine has AMX-BF16 and the process may use it.
    unsafe fn multiply(tiles: &Tiles, buffer: &Buffer, layout: &Layout, out: &mut [Block]) {
        let Tiles { pixel, places, weights, output_blocks, .. } = tiles;
        let (width, stride) = (layout.shape.width, layout.stride());
        // SAFETY: the caller says that it can be run; it reads 64 bytes. Compiled code uses no tiles, so what is set and loaded
        // here stays until the release below.
        unsafe { asm!("ldtilecfg [{}]", in(reg) SHAPES.0.as_ptr(), options(nostack, readonly)) };
        let (mut first, mut weights) = (0, &weights[..]);
        while first < *output_blocks {
            let count = group(output_blocks - first);
            let (these, others) = weights.split_at(count * (1 + places.len()));
            let mut x = 0;
            while x < width {
                // Three tiles of pixels, or one, and the last overlaps those before, which get the same values again.
                let most = if count == 2 { 2 } else { 3 };
                let many = if width - x >= most * ROWS { most } else { 1 };
                let start = x.min(width - many * ROWS);
                let out =
                    &mut out[first * stride + layout.halo + start..][..(count - 1) * stride + many * ROWS];
                let product = Product {
                    places,
                    seen: &buffer.0[start * pixel..],
                    pixel: *pixel,
                    weights: these,
                    stride,
                };
                // SAFETY: as above. Steps see no farther than `round` has written: all places are below the numbers of
                // `conv.kernel` lines, `DEPTH` numbers beyond them included.
                unsafe {
                    match (count, many) {
                        (2, 2) => product.two_by_two(out),
                        (2, _) => product.two_by_one(out),
                        (_, 3) => product.one_by_three(out),
                        _ => product.one_by_one(out),
                    }
                }
                x += many * ROWS;
            }
            weights = others;
            first += count;
        }
        // SAFETY: as above. Without it the system would save tiles at each change of threads.
        unsafe { asm!("tilerelease", options(nostack, nomem)) };
    }

    /// One or two blocks of outputs of some tiles of pixels.
    struct Product<'a> {
        places: &'a [usize],
        /// From the first pixel on.
        seen: &'a [u16],
        /// Numbers of a pixel.
        pixel: usize,
        weights: &'a [Tile],
        /// Blocks from one block of outputs to the next.
        stride: usize,
    }

    /// A product of tiles of pixels and one or two blocks of outputs. Tile 6 holds pixels, 7 weights: for all tiles of pixels, or
    /// for each anew. Weights are given by their place in bytes, as are tiles of pixels by that in a block of outputs, and each
    /// tile of sums by that of its bias.
    macro_rules! product {
        (
            $name:ident, $blocks:literal, [$($tile:literal: $shared:literal),+]:
            $($pixels:literal [$($sum:literal by $factor:literal from $bias:literal to $out:literal),+])+
        ) => {
            /// # Safety
            /// The machine has tiles, their shapes are set, and what all places are the begin of has been written.
            unsafe fn $name(&self, out: &mut [Block]) {
                let [first, second] = [0, ($blocks - 1) * self.stride].map(|start| out[start..].as_mut_ptr());
                // SAFETY: `weights` has `$blocks` tiles for the bias and for each of the places. Rows of a tile of pixels are
                // `pixel` numbers apart, as are pixels in what was written. `out` has as many pixels as the tiles, in each
                // of `$blocks` blocks.
                unsafe {
                    asm!(
                        $($(concat!("tileloadd tmm", $sum, ", [{weights} + {row} + ", $bias, "]"),)+)+
                        "2:",
                        "add {weights}, {step}",
                        "mov {pixels}, [{places}]",
                        "add {pixels}, {seen}",
                        $(concat!("tileloadd tmm", $tile, ", [{weights} + {row} + ", $shared, "]"),)+
                        $(
                            "tileloadd tmm5, [{pixels} + {pixel}]",
                            $(
                                concat!("tdpbf16ps tmm", $sum, ", tmm5, tmm", $factor),
                            )+
                            "add {pixels}, {tile}",
                        )+
                        "add {places}, 8",
                        "dec {count}",
                        "jnz 2b",
                        $($(concat!("tilestored [{", $out, "} + {row} + ", $pixels, "], tmm", $sum),)+)+
                        // For those that do not store there.
                        "/* {second} */",
                        weights = inout(reg) self.weights.as_ptr() => _,
                        places = inout(reg) self.places.as_ptr() => _,
                        count = inout(reg) self.places.len() => _,
                        pixels = out(reg) _,
                        seen = in(reg) self.seen.as_ptr(),
                        pixel = in(reg) self.pixel * size_of::<u16>(),
                        tile = in(reg) ROWS * self.pixel * size_of::<u16>(),
                        step = in(reg) $blocks * size_of::<Tile>(),
                        row = in(reg) ROW,
                        first = in(reg) first,
                        second = in(reg) second,
                        options(nostack),
                    );
                }
            }
        };
    }

    const _: () = assert!(size_of::<Tile>() == ROWS * ROW && size_of::<Block>() == ROW && LANES == ROWS);

    impl Product<'_> {
        product!(two_by_two, 2, [6: 0, 7: 1024]:
            0 [0 by 6 from 0 to "first", 1 by 7 from 1024 to "second"]
            1024 [2 by 6 from 0 to "first", 3 by 7 from 1024 to "second"]);
        product!(two_by_one, 2, [6: 0, 7: 1024]: 0 [0 by 6 from 0 to "first", 1 by 7 from 1024 to "second"]);
        product!(one_by_three, 1, [6: 0]:
            0 [0 by 6 from 0 to "first"] 1024 [1 by 6 from 0 to "first"] 2048 [2 by 6 from 0 to "first"]);
        product!(one_by_one, 1, [6: 0]: 0 [0 by 6 from 0 to "first"]);
    }
}
