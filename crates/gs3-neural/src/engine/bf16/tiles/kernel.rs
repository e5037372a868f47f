//! What runs on tiles.

#![allow(unsafe_code, reason = "instructions that not every machine has")]

use std::arch::asm;
use std::arch::x86_64::{
    __m256bh, __m256i, _mm256_mask_storeu_epi16, _mm256_store_si256, _mm512_load_ps, _mm512_maskz_cvtneps_pbh,
};
use std::cell::RefCell;
use std::marker::PhantomData;

use super::super::Unit;
use super::{BUFFER, Block, Border, DEPTH, Input, LANES, Layout, ROWS, STEPS, Sources, Tile, Tiles, group};
use crate::engine::conv::Seen;

/// Bytes of a row of a tile.
const ROW: usize = 64;

const _: () = assert!(size_of::<Tile>() == ROWS * ROW && size_of::<Block>() == ROW && LANES == ROWS);

/// 16 channels of a pixel.
type Rounded = [u16; LANES];

/// Memory of a thread.
#[repr(C, align(64))]
struct Buffer {
    /// What a strip sees, rounded.
    seen: [u16; BUFFER],
    /// What it sees beyond an image that zeros surround.
    zeros: [u16; BUFFER],
    places: [Place; STEPS],
}

/// Where the numbers of a step are.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Place {
    /// Those of the strip's first pixel.
    first: *const u16,
    /// Bytes from the numbers of one pixel to the numbers of the next.
    pixel: usize,
}

thread_local! {
    static BUFFER_OF_THREAD: RefCell<Box<Buffer>> = RefCell::new(Box::new(Buffer {
        seen: [0; BUFFER],
        zeros: [0; BUFFER],
        places: [Place { first: std::ptr::null(), pixel: 0 }; STEPS],
    }));
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

/// The configuration of the thread's tiles, the shapes that [`row`] needs: setting them takes as long as a dozen
/// products, so it is done once for many rows. Compiled code does not use tiles, so they stay as they are set until
/// this is dropped. A thread has one at a time.
#[derive(Debug)]
pub struct TileConfig {
    /// Other threads have tiles of their own.
    thread: PhantomData<*const ()>,
}

impl TileConfig {
    /// Sets the shapes, if the machine has tiles.
    pub fn new() -> Self {
        if Unit::Amx.is_available() {
            // SAFETY: the machine has them and the process may use them; it reads 64 bytes.
            unsafe { asm!("ldtilecfg [{}]", in(reg) SHAPES.0.as_ptr(), options(nostack, readonly)) };
        }
        Self { thread: PhantomData }
    }
}

impl Drop for TileConfig {
    /// Gives the tiles back: otherwise the system would save them at each change of threads.
    fn drop(&mut self) {
        if Unit::Amx.is_available() {
            // SAFETY: as above.
            unsafe { asm!("tilerelease", options(nostack, nomem)) };
        }
    }
}

/// Writes a strip of `width` pixels to `row` of `whole`, which has numbers in bf16, from pixel `x` on.
pub fn store(strip: &[Block], width: usize, row: &mut [Block], whole: &Layout, x: usize) {
    let pixels = &mut pixels_mut(row)[(whole.halo + x) * whole.blocks()..][..width * whole.blocks()];
    for (b, blocks) in strip.chunks_exact(width).enumerate() {
        let channels = (whole.shape.channels - b * LANES).min(LANES);
        // SAFETY: layouts of bf16 are only made where `Unit::is_available` found the instructions.
        unsafe { round_blocks(blocks, channels, pixels[b..].iter_mut().step_by(whole.blocks())) };
    }
}

/// Fills the pixels beside `row` of `layout`, which has numbers in bf16, according to `border`, and the numbers
/// beyond them that a tile reads.
pub fn fill_halo(border: Border, layout: &Layout, row: &mut [Block]) {
    let (halo, width, blocks) = (layout.halo, layout.shape.width, layout.blocks());
    let (pixels, beyond) = pixels_mut(row).split_at_mut(layout.stride() * blocks);
    let (before, rest) = pixels.split_at_mut(halo * blocks);
    let (inside, after) = rest.split_at_mut(width * blocks);
    for (side, edge) in [(before, 0), (after, width - 1)] {
        for pixel in side.chunks_exact_mut(blocks) {
            match border {
                Border::Zero => pixel.fill([0; LANES]),
                Border::Replicate => pixel.copy_from_slice(&inside[edge * blocks..][..blocks]),
            }
        }
    }
    beyond.fill([0; LANES]);
}

fn pixels_mut(row: &mut [Block]) -> &mut [Rounded] {
    bytemuck::cast_slice_mut(row)
}

/// Rounds `blocks`, in which lanes beyond the channels hold anything: they become 0.
#[target_feature(enable = "avx512f,avx512bf16")]
fn round_blocks<'a>(blocks: &[Block], channels: usize, to: impl Iterator<Item = &'a mut Rounded>) {
    let mask = (u32::MAX >> (32 - channels)) as u16;
    for (from, to) in blocks.iter().zip(to) {
        // SAFETY: a block is as large as a vector and aligned to its size; so is `to`, half as large, in a row of
        // blocks.
        unsafe {
            let pixel = _mm512_maskz_cvtneps_pbh(mask, _mm512_load_ps(from.0.as_ptr()));
            _mm256_store_si256(to.as_mut_ptr().cast(), std::mem::transmute::<__m256bh, __m256i>(pixel));
        }
    }
}

/// Writes row `y` to `out`, a strip of `layout`, before the activation.
pub fn row(
    tiles: &Tiles,
    _: &TileConfig,
    sources: Sources<'_>,
    layout: &Layout,
    y: isize,
    out: &mut [Block],
) {
    BUFFER_OF_THREAD.with_borrow_mut(|buffer| {
        let Buffer { seen, zeros, places } = &mut **buffer;
        // SAFETY: `Tiles` are only made where `Unit::is_available` found both sets of instructions. Tiles are
        // configured. Places point to numbers that `find` has found.
        unsafe {
            if !tiles.segments.is_empty() {
                round(tiles, sources, y, seen);
            }
            let places = find(tiles, sources, y, [seen, zeros], places);
            multiply(tiles, places, layout, out);
        }
    });
}

/// Rounds what the strip sees to `buffer`, `[rows, columns, numbers of a pixel]`.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512bf16")]
fn round(tiles: &Tiles, sources: Sources<'_>, y: isize, buffer: &mut [u16; BUFFER]) {
    let Tiles { conv, border, segments, starts, inputs, columns, .. } = tiles;
    let seen = Seen { conv, border: *border, sources };
    // The buffer is the last input.
    let pixel = inputs.last().map_or(0, |input| input.channels.len());
    let len = columns * pixel;
    for (line, numbers) in buffer.chunks_exact_mut(len).take(conv.kernel).enumerate() {
        for (k, segment) in segments.iter().enumerate() {
            let Some(pixels) = seen.pixels(segment, line, y, 0) else {
                numbers.fill(0);
                break;
            };
            // Lanes beyond the channels hold anything: they become 0, and are written up to the next segment.
            let (start, next) = (starts[k], *starts.get(k + 1).unwrap_or(&pixel));
            let count = (next - start).min(LANES);
            let [there, written] = [segment.channels, count].map(|count| (u32::MAX >> (32 - count)) as u16);
            for (to, from) in numbers.chunks_exact_mut(pixel).zip(pixels) {
                let to = &mut to[start..][..count];
                // SAFETY: a block is as large as a vector and aligned to its size; what is written is as long as `to`.
                unsafe {
                    let pixel = _mm512_maskz_cvtneps_pbh(there, _mm512_load_ps(from.0.as_ptr()));
                    let pixel = std::mem::transmute::<__m256bh, __m256i>(pixel);
                    _mm256_mask_storeu_epi16(to.as_mut_ptr().cast(), written, pixel);
                }
            }
            if start + count < next {
                numbers.chunks_exact_mut(pixel).for_each(|to| to[start + count..next].fill(0));
            }
        }
    }
    // The last step of the last pixel may see beyond: anything there is multiplied with 0, but must be a number.
    buffer[conv.kernel * len..][..DEPTH].fill(0);
}

/// The places of all steps in row `y`: in the buffer, in tensors, or in `zeros`. Behind each are the numbers of all
/// pixels that the strip sees from there on, and as many as a tile's row has.
fn find<'a>(
    tiles: &Tiles,
    sources: Sources<'_>,
    y: isize,
    [buffer, zeros]: [&[u16; BUFFER]; 2],
    places: &'a mut [Place; STEPS],
) -> &'a [Place] {
    let Tiles { conv, border, inputs, steps, columns, .. } = tiles;
    let line_of = |Input { stored, channels }: &Input, line: usize| -> &[u16] {
        let pixel = channels.len();
        let (numbers, first): (&[u16], usize) = match stored {
            None => (buffer, line * columns),
            Some(layout) => {
                let place = y + (line * conv.dilation) as isize - conv.reach() as isize;
                let inside = place.clamp(0, layout.shape.height as isize - 1);
                match *border == Border::Zero && place != inside {
                    true => (zeros, 0),
                    // The halo is at least as wide as the window's reach.
                    false => (
                        bytemuck::cast_slice(sources.row(layout, inside as usize)),
                        sources.first(layout) - conv.reach(),
                    ),
                }
            }
        };
        &numbers[first * pixel..][..columns * pixel + DEPTH]
    };
    let mut line: (usize, usize, &[u16]) = (usize::MAX, 0, &[]);
    for (place, step) in places.iter_mut().zip(steps) {
        if (line.0, line.1) != (step.input, step.line) {
            line = (step.input, step.line, line_of(&inputs[step.input], step.line));
        }
        let pixel = inputs[step.input].channels.len() * size_of::<u16>();
        *place = Place { first: line.2[step.start..].as_ptr(), pixel };
    }
    &places[..steps.len()]
}

/// All sums of the strip, to `out`.
///
/// # Safety
/// The thread has a [`TileConfig`]. `places` belong to the steps of `tiles` for a strip of `layout`.
unsafe fn multiply(tiles: &Tiles, places: &[Place], layout: &Layout, out: &mut [Block]) {
    let (width, stride) = (layout.shape.width, layout.stride());
    let (mut first, mut weights) = (0, &tiles.weights[..]);
    while first < tiles.output_blocks {
        let count = group(tiles.output_blocks - first);
        let (these, others) = weights.split_at(count * (1 + places.len()));
        let most = if count == 2 { 2 } else { 3 };
        let mut x = 0;
        while x < width {
            // As many tiles of pixels as there are tiles for their sums, or one. The last tile overlaps the tiles
            // before. The shared pixels get the same values again.
            let many = if width - x >= most * ROWS { most } else { 1 };
            let start = x.min(width - many * ROWS);
            let out = &mut out[first * stride + layout.halo + start..][..(count - 1) * stride + many * ROWS];
            let product = Product { places, start, weights: these, stride };
            // SAFETY: as the caller says.
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
}

/// One or two blocks of outputs of some tiles of pixels.
struct Product<'a> {
    places: &'a [Place],
    /// The first pixel.
    start: usize,
    weights: &'a [Tile],
    /// Blocks from one block of outputs to the next.
    stride: usize,
}

/// A product of tiles of pixels and one or two blocks of outputs. Tile 5 holds pixels, 6 and 7 weights, which are
/// given by their place in bytes, as are tiles of pixels by that in a block of outputs, and each tile of sums by that
/// of its bias.
macro_rules! product {
    (
        $name:ident, $blocks:literal, [$($tile:literal: $weights:literal),+]:
        $($pixels:literal [$($sum:literal by $factor:literal from $bias:literal to $out:literal),+])+
    ) => {
        /// # Safety
        /// The thread has a [`TileConfig`], and behind all places are the numbers that the steps see.
        unsafe fn $name(&self, out: &mut [Block]) {
            let [first, second] = [0, ($blocks - 1) * self.stride].map(|start| out[start..].as_mut_ptr());
            // SAFETY: `weights` has `$blocks` tiles for the bias and for each of the places. Rows of a tile of pixels
            // are a pixel apart, as are pixels behind the places. `out` has as many pixels as the tiles, in each of
            // `$blocks` blocks.
            unsafe {
                asm!(
                    $($(concat!("tileloadd tmm", $sum, ", [{weights} + {row} + ", $bias, "]"),)+)+
                    "2:",
                    "add {weights}, {step}",
                    $(concat!("tileloadd tmm", $tile, ", [{weights} + {row} + ", $weights, "]"),)+
                    "mov {pixel}, [{places} + 8]",
                    "mov {pixels}, {start}",
                    "imul {pixels}, {pixel}",
                    "add {pixels}, [{places}]",
                    "mov {next}, {pixel}",
                    // 16 pixels.
                    "shl {next}, 4",
                    $(
                        "tileloadd tmm5, [{pixels} + {pixel}]",
                        $(concat!("tdpbf16ps tmm", $sum, ", tmm5, tmm", $factor),)+
                        "add {pixels}, {next}",
                    )+
                    "add {places}, 16",
                    "dec {count}",
                    "jnz 2b",
                    $($(concat!("tilestored [{", $out, "} + {row} + ", $pixels, "], tmm", $sum),)+)+
                    // For those that do not store there.
                    "/* {second} */",
                    weights = inout(reg) self.weights.as_ptr() => _,
                    places = inout(reg) self.places.as_ptr() => _,
                    count = inout(reg) self.places.len() => _,
                    pixels = out(reg) _,
                    pixel = out(reg) _,
                    next = out(reg) _,
                    start = in(reg) self.start,
                    step = in(reg) $blocks * size_of::<Tile>(),
                    row = in(reg) ROW,
                    first = in(reg) first,
                    second = in(reg) second,
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                );
            }
        }
    };
}

const _: () = assert!(size_of::<Place>() == 16 && ROWS == 1 << 4);

impl Product<'_> {
    product!(two_by_two, 2, [6: 0, 7: 1024]:
        0 [0 by 6 from 0 to "first", 1 by 7 from 1024 to "second"]
        1024 [2 by 6 from 0 to "first", 3 by 7 from 1024 to "second"]);
    product!(two_by_one, 2, [6: 0, 7: 1024]: 0 [0 by 6 from 0 to "first", 1 by 7 from 1024 to "second"]);
    product!(one_by_three, 1, [6: 0]:
        0 [0 by 6 from 0 to "first"] 1024 [1 by 6 from 0 to "first"] 2048 [2 by 6 from 0 to "first"]);
    product!(one_by_one, 1, [6: 0]: 0 [0 by 6 from 0 to "first"]);
}
