//! Convolutions in bf16 with sums in f32, on machines with AVX-512 BF16: twice the multiply-adds of f32 on those of AMD
//! ([`super::Arithmetic::fastest`]).
//!
//! Tensors stay f32. Of each row the inputs that a run of pixels sees are rounded to bf16, two channels a 32-bit number, in a
//! buffer of the thread; that costs as much as a few per cent of the multiply-adds. From there it is the f32 kernel with
//! pairs of channels: sums of pixels × 16 output channels stay in registers.
//!
//! All `unsafe` code of the engine is here: vector instructions that the compiler cannot know the machine has.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::{Segment, group};
use super::math::activate;
use super::ops::load;
use crate::graph::{Activation, Border, Conv2d};

/// Pixels of a run: a multiple of all numbers of pixels whose sums stay in registers.
const RUN: usize = 48;

/// Blocks of 16 channels of pixels that a run sees at most: 32 KiB of bf16, the first cache. Wider convolutions stay f32.
const BUFFER: usize = 1024;

/// Pairs of channels of a block.
const PAIRS: usize = LANES / 2;

/// 16 output channels × a pair of input channels.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
struct Weights([u16; 2 * LANES]);

/// A convolution ready to run in bf16.
#[derive(Clone, Debug)]
pub struct Bf16Convolution {
    conv: Conv2d,
    border: Border,
    segments: Vec<Segment>,
    /// `[groups of output blocks, segments, taps, pairs of channels, blocks of the group]`.
    weights: Vec<Weights>,
    /// Where the buffer of a run has what each segment, tap and pair of its first pixel sees: one loop goes over them all, as
    /// those over the pairs of a tap would be too short.
    places: Vec<usize>,
    /// `[output blocks]`.
    bias: Vec<Block>,
}

impl Bf16Convolution {
    /// The convolution of `inputs`, concatenated, in strips of `width` pixels, with `weights` `oihw` and `bias`, empty where
    /// there is none; none where the machine lacks the instructions or f32 is better: on images of few columns, or with more
    /// inputs than the first cache holds.
    pub fn new(
        conv: Conv2d,
        border: Border,
        inputs: &[Layout],
        width: usize,
        weights: &[f32],
        bias: &[f32],
    ) -> Option<Self> {
        let segments = Segment::all(inputs);
        let blocks_seen = segments.len() * conv.kernel * (RUN + 2 * conv.reach());
        if !(is_available() && width >= RUN && blocks_seen <= BUFFER) {
            return None;
        }
        let channels: usize = segments.iter().map(|s| s.channels).sum();
        let taps = conv.kernel * conv.kernel;
        let blocks = conv.outputs.div_ceil(LANES);
        let weight = |o: usize, i: usize, tap: usize| weights[(o * channels + i) * taps + tap];
        let mut packed = Vec::new();
        let mut first = 0;
        while first < blocks {
            let count = group(blocks - first);
            let mut channel = 0;
            for segment in &segments {
                for tap in 0..taps {
                    for pair in 0..segment.channels.div_ceil(2) {
                        for block in first..first + count {
                            packed.push(Weights(std::array::from_fn(|k| {
                                let (o, i) = (block * LANES + k / 2, 2 * pair + k % 2);
                                // The pair of an odd last channel has no weight.
                                let is_there = o < conv.outputs && i < segment.channels;
                                if is_there { rounded(weight(o, channel + i, tap)) } else { 0 }
                            })));
                        }
                    }
                }
                channel += segment.channels;
            }
            first += count;
        }
        let lane = |o: usize| bias.get(o).copied().unwrap_or(0.0);
        let bias = (0..blocks).map(|b| Block(std::array::from_fn(|l| lane(b * LANES + l)))).collect();
        let columns = RUN + 2 * conv.reach();
        let mut places = Vec::new();
        for (k, segment) in segments.iter().enumerate() {
            for tap in 0..taps {
                let line = k * conv.kernel + tap / conv.kernel;
                let pixel = line * columns + tap % conv.kernel * conv.dilation;
                places.extend((0..segment.channels.div_ceil(2)).map(|pair| pixel * PAIRS + pair));
            }
        }
        Some(Self { conv, border, segments, weights: packed, places, bias })
    }

    /// Writes row `y` to `out`, a row of `layout` or a strip of one; its halo is left.
    pub fn run_row(&self, level: Level, sources: Sources<'_>, layout: &Layout, y: usize, out: &mut [Block]) {
        kernel::row(self, sources, layout, y as isize, out);
        if self.conv.activation != Activation::Identity {
            dispatch!(level, simd => for block in &mut *out {
                block.0 = activate(simd, self.conv.activation, load(simd, block)).to_array();
            });
        }
    }
}

/// The nearest bf16, of two the even one; weights are finite.
fn rounded(value: f32) -> u16 {
    let bits = value.to_bits();
    // Half a unit of the last place that stays, less one bit unless that place is odd.
    let half = 0x7FFF + (bits >> 16 & 1);
    // The largest finite numbers would become infinite: they stay.
    (bits.checked_add(half).filter(|sum| sum & 0x7F80_0000 != 0x7F80_0000).unwrap_or(bits) >> 16) as u16
}

#[cfg(target_arch = "x86_64")]
fn is_available() -> bool {
    is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bf16")
}

#[cfg(not(target_arch = "x86_64"))]
fn is_available() -> bool {
    false
}

/// Whether bf16 is faster than f32 here.
pub fn gains() -> bool {
    is_available() && vendor() == *b"AuthenticAMD"
}

/// Who made the processor: leaf 0 of `cpuid`, its text in registers b, d, c.
#[cfg(target_arch = "x86_64")]
fn vendor() -> [u8; 12] {
    let leaf = core::arch::x86_64::__cpuid(0);
    let mut name = [0; 12];
    for (bytes, register) in name.chunks_exact_mut(4).zip([leaf.ebx, leaf.edx, leaf.ecx]) {
        bytes.copy_from_slice(&register.to_le_bytes());
    }
    name
}

#[cfg(not(target_arch = "x86_64"))]
fn vendor() -> [u8; 12] {
    [0; 12]
}

#[cfg(not(target_arch = "x86_64"))]
mod kernel {
    use super::{Bf16Convolution, Block, Layout, Sources};

    /// There is none: no [`Bf16Convolution`] is made.
    pub fn row(_: &Bf16Convolution, _: Sources<'_>, _: &Layout, _: isize, _: &mut [Block]) {}
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "vector instructions that not every machine has")]
mod kernel {
    use std::cell::RefCell;

    use std::arch::x86_64::{
        __m256bh, __m256i, __m512, __m512bh, __m512i, _mm256_store_si256, _mm512_dpbf16_ps, _mm512_load_ps,
        _mm512_load_si512, _mm512_maskz_cvtneps_pbh, _mm512_set1_epi32, _mm512_setzero_ps, _mm512_store_ps,
    };

    use super::{
        BUFFER, Bf16Convolution, Block, Border, Layout, PAIRS, RUN, Segment, Sources, Weights, group,
    };
    use crate::engine::conv::unrolled;

    /// What a run sees: for each pixel 16 channels, a pair in each number.
    #[repr(C, align(32))]
    struct Buffer([u32; BUFFER * PAIRS]);

    thread_local! {
        static BUFFER_OF_THREAD: RefCell<Box<Buffer>> = RefCell::new(Box::new(Buffer([0; BUFFER * PAIRS])));
    }

    /// Writes row `y` to `out`, a row of `layout`, before the activation; its halo is left.
    pub fn row(conv: &Bf16Convolution, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        BUFFER_OF_THREAD.with_borrow_mut(|buffer| {
            // SAFETY: a `Bf16Convolution` is only made where `is_available` found the instructions of `run_row`.
            unsafe { run_row(conv, sources, layout, y, out, buffer) }
        });
    }

    #[target_feature(enable = "avx512f,avx512bf16")]
    fn run_row(
        conv: &Bf16Convolution,
        sources: Sources<'_>,
        layout: &Layout,
        y: isize,
        out: &mut [Block],
        buffer: &mut Buffer,
    ) {
        for start in (0..layout.shape.width).step_by(RUN) {
            // The last run overlaps that before, whose pixels get the same values again.
            let x = start.min(layout.shape.width - RUN);
            round(conv, sources, y, x, buffer);
            let (mut first, mut weights) = (0, &conv.weights[..]);
            while first < conv.bias.len() {
                let count = group(conv.bias.len() - first);
                let (these, others) = weights.split_at(count * conv.places.len());
                let job = Job { places: &conv.places, buffer, weights: these, bias: &conv.bias[first..] };
                let out = &mut out[first * layout.stride() + layout.halo + x..];
                match count {
                    3 => job.run::<3, 8>(layout.stride(), out),
                    2 => job.run::<2, 12>(layout.stride(), out),
                    _ => job.run::<1, 24>(layout.stride(), out),
                }
                weights = others;
                first += count;
            }
        }
    }

    /// Rounds what pixels `x..x + RUN` of row `y` see to `buffer`, `[segments, rows, RUN and what the window reaches beside]`.
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn round(conv: &Bf16Convolution, sources: Sources<'_>, y: isize, x: usize, buffer: &mut Buffer) {
        let Bf16Convolution { conv, border, segments, .. } = conv;
        let columns = RUN + 2 * conv.reach();
        let lines = buffer.0.as_chunks_mut::<PAIRS>().0.chunks_exact_mut(columns);
        for (k, line) in lines.take(segments.len() * conv.kernel).enumerate() {
            let (Segment { layout, block, channels }, ky) = (&segments[k / conv.kernel], k % conv.kernel);
            let place = y + (ky * conv.dilation) as isize - conv.reach() as isize;
            let inside = place.clamp(0, layout.shape.height as isize - 1);
            if *border == Border::Zero && place != inside {
                line.fill([0; PAIRS]);
                continue;
            }
            // The halo is at least as wide as the window's reach. Lanes beyond the channels hold anything: they become 0.
            let row = &sources.row(layout, inside as usize)[block * layout.stride()..][..layout.stride()];
            let mask = (u32::MAX >> (32 - channels)) as u16;
            for (to, from) in line.iter_mut().zip(&row[x + sources.first(layout) - conv.reach()..]) {
                // SAFETY: both are as large as the vectors that are loaded and stored, and aligned to their size: the buffer
                // and blocks by their types.
                unsafe {
                    let pixel = _mm512_maskz_cvtneps_pbh(mask, _mm512_load_ps(from.0.as_ptr()));
                    _mm256_store_si256(
                        to.as_mut_ptr().cast(),
                        std::mem::transmute::<__m256bh, __m256i>(pixel),
                    );
                }
            }
        }
    }

    /// A group of output blocks of a run.
    struct Job<'a> {
        places: &'a [usize],
        buffer: &'a Buffer,
        weights: &'a [Weights],
        bias: &'a [Block],
    }

    impl Job<'_> {
        /// `V` blocks of all pixels, `P` at a time, to `out`, in which blocks are `stride` apart. As in f32, all indices into
        /// sums are constants.
        #[target_feature(enable = "avx512f,avx512bf16")]
        fn run<const V: usize, const P: usize>(&self, stride: usize, out: &mut [Block]) {
            for x in (0..RUN).step_by(P) {
                let mut sums: [[__m512; P]; V] = [[_mm512_setzero_ps(); P]; V];
                unrolled!(V, BLOCK => { sums[BLOCK] = [load_bias(&self.bias[BLOCK]); P]; });
                let seen = &self.buffer.0[x * PAIRS..];
                for (place, w) in self.places.iter().zip(self.weights.as_chunks::<V>().0) {
                    let Some(pairs) = seen.get(*place..*place + (P - 1) * PAIRS + 1) else { continue };
                    let mut vectors = [zero_pairs(); V];
                    unrolled!(V, BLOCK => { vectors[BLOCK] = load(&w[BLOCK]); });
                    unrolled!(P, PIXEL => {
                        let value = pairs_of(_mm512_set1_epi32(pairs[PIXEL * PAIRS] as i32));
                        unrolled!(V, BLOCK => {
                            sums[BLOCK][PIXEL] =
                                _mm512_dpbf16_ps(sums[BLOCK][PIXEL], vectors[BLOCK], value);
                        });
                    });
                }
                unrolled!(V, BLOCK => {
                    if let Some(out) = out[BLOCK * stride + x..].first_chunk_mut::<P>() {
                        unrolled!(P, PIXEL => { store(&mut out[PIXEL], sums[BLOCK][PIXEL]); });
                    }
                });
            }
        }
    }

    #[target_feature(enable = "avx512f")]
    fn zero_pairs() -> __m512bh {
        pairs_of(_mm512_set1_epi32(0))
    }

    #[target_feature(enable = "avx512f")]
    fn pairs_of(bits: __m512i) -> __m512bh {
        // SAFETY: both are 512 bits, of which any are valid.
        unsafe { std::mem::transmute::<__m512i, __m512bh>(bits) }
    }

    #[target_feature(enable = "avx512f")]
    fn load(weights: &Weights) -> __m512bh {
        // SAFETY: 64 bytes, aligned to as many.
        pairs_of(unsafe { _mm512_load_si512(weights.0.as_ptr().cast()) })
    }

    #[target_feature(enable = "avx512f")]
    fn load_bias(bias: &Block) -> __m512 {
        // SAFETY: 64 bytes, aligned to as many.
        unsafe { _mm512_load_ps(bias.0.as_ptr()) }
    }

    #[target_feature(enable = "avx512f")]
    fn store(block: &mut Block, vector: __m512) {
        // SAFETY: 64 bytes, aligned to as many.
        unsafe { _mm512_store_ps(block.0.as_mut_ptr(), vector) }
    }
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn numbers_are_rounded_to_the_nearest() {
        // 1 + 2⁻⁷ is the next number after 1: half-way between them the even one, 1, and beyond it the other.
        for (value, expected) in [
            (1.0, 0x3F80),
            (1.0 + 2.0_f32.powi(-8), 0x3F80),
            (1.0 + 2.0_f32.powi(-8) + 2.0_f32.powi(-20), 0x3F81),
            (1.0 + 3.0 * 2.0_f32.powi(-8), 0x3F82),
            (-2.5, 0xC020),
            (0.0, 0),
            (f32::MAX, 0x7F7F),
        ] {
            assert_eq!(rounded(value), expected, "{value}");
        }
    }
}
