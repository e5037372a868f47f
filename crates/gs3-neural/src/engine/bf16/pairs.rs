//! The kernel for pairs (AVX-512 BF16): as the f32 kernel, but each vector multiplies pairs of channels, so that it
//! does twice the multiply-adds where it starts as often, on processors of AMD.
//!
//! In the buffer a pixel has 16 channels of each block of the inputs, two channels a 32-bit number; rounding to it
//! costs as much as a few per cent of the multiply-adds. Sums of pixels × 16 output channels stay in registers.

use super::{PairWeights, Segment, Source};
use crate::engine::block::{Block, LANES, Layout, Sources};
use crate::engine::conv::group;
use crate::graph::{Border, Conv2d};

/// Pixels of a run: a multiple of all numbers of pixels with sums in registers.
const RUN: usize = 48;

/// Blocks of 16 channels of pixels that a run sees at most: 32 KiB of bf16, the first cache. Wider convolutions stay
/// f32.
const BUFFER: usize = 1024;

/// Pairs of channels of a block.
const PAIRS: usize = LANES / 2;

/// A convolution ready to run on pairs.
#[derive(Clone, Debug)]
pub struct Pairs {
    conv: Conv2d,
    border: Border,
    segments: Vec<Segment>,
    /// `[groups of output blocks, segments, taps, pairs of channels, blocks of the group]`.
    weights: Vec<PairWeights>,
    /// Where the buffer of a run has what each segment, tap and pair of its first pixel sees: one loop goes over them
    /// all, as those over the pairs of a tap would be too short.
    places: Vec<usize>,
    /// `[output blocks]`.
    bias: Vec<Block>,
}

impl Pairs {
    /// The convolution of `source`; none on images of few columns, or with more inputs than the first-level cache
    /// holds.
    pub fn new(source: &Source<'_>) -> Option<Self> {
        let conv = source.conv;
        let segments = Segment::all(source.inputs);
        let blocks_seen = segments.len() * conv.kernel * (RUN + 2 * conv.reach());
        if source.width < RUN || blocks_seen > BUFFER {
            return None;
        }
        let mut packed = Vec::new();
        let mut first = 0;
        while first < source.output_blocks() {
            let count = group(source.output_blocks() - first);
            let mut channel = 0;
            for segment in &segments {
                for tap in 0..source.taps() {
                    for pair in 0..segment.channels.div_ceil(2) {
                        for block in first..first + count {
                            packed.push(PairWeights(std::array::from_fn(|k| {
                                let (o, i) = (block * LANES + k / 2, 2 * pair + k % 2);
                                // The pair of an odd last channel has no weight.
                                let is_there = o < conv.outputs && i < segment.channels;
                                if is_there { source.weight(o, channel + i, tap) } else { 0 }
                            })));
                        }
                    }
                }
                channel += segment.channels;
            }
            first += count;
        }
        let columns = RUN + 2 * conv.reach();
        let mut places = Vec::new();
        for (k, segment) in segments.iter().enumerate() {
            for tap in 0..source.taps() {
                let line = k * conv.kernel + tap / conv.kernel;
                let pixel = line * columns + tap % conv.kernel * conv.dilation;
                places.extend((0..segment.channels.div_ceil(2)).map(|pair| pixel * PAIRS + pair));
            }
        }
        Some(Self { conv, border: source.border, segments, weights: packed, places, bias: source.bias() })
    }

    /// Writes row `y` to `out`, a row of `layout` or a strip of one, before the activation; its halo is left.
    pub fn run_row(&self, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        kernel::row(self, sources, layout, y, out);
    }
}

/// Asks for `numbers` to be brought into the second cache.
pub fn prefetch(numbers: &[f32]) {
    kernel::prefetch(numbers);
}

#[cfg(not(target_arch = "x86_64"))]
mod kernel {
    use super::{Block, Layout, Pairs, Sources};

    /// No [`Pairs`] are made that it would serve.
    pub fn prefetch(_: &[f32]) {}

    /// There is none: no [`Pairs`] are made.
    pub fn row(_: &Pairs, _: Sources<'_>, _: &Layout, _: isize, _: &mut [Block]) {}
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "vector instructions that not every machine has")]
mod kernel {
    use std::cell::RefCell;

    use std::arch::x86_64::{
        __m256bh, __m256i, __m512, __m512bh, __m512i, _MM_HINT_T1, _mm_prefetch, _mm256_store_si256,
        _mm512_dpbf16_ps, _mm512_load_ps, _mm512_load_si512, _mm512_maskz_cvtneps_pbh, _mm512_set1_epi32,
        _mm512_setzero_ps, _mm512_store_ps,
    };

    use super::{BUFFER, Block, LANES, Layout, PAIRS, PairWeights, Pairs, RUN, Sources, group};
    use crate::engine::conv::Seen;
    use crate::engine::conv::unrolled;

    /// What a run sees: for each pixel 16 channels, a pair in each number.
    #[repr(C, align(32))]
    struct Buffer([u32; BUFFER * PAIRS]);

    thread_local! {
        static BUFFER_OF_THREAD: RefCell<Box<Buffer>> = RefCell::new(Box::new(Buffer([0; BUFFER * PAIRS])));
    }

    /// As [`super::prefetch`].
    #[inline(always)]
    pub fn prefetch(numbers: &[f32]) {
        for line in numbers.chunks(LANES) {
            // SAFETY: a hint, which neither reads nor faults, at any address; the instruction (SSE) is part of
            // x86-64.
            unsafe { _mm_prefetch::<_MM_HINT_T1>(line.as_ptr().cast()) };
        }
    }

    /// As [`Pairs::run_row`].
    pub fn row(conv: &Pairs, sources: Sources<'_>, layout: &Layout, y: isize, out: &mut [Block]) {
        BUFFER_OF_THREAD.with_borrow_mut(|buffer| {
            // SAFETY: `Pairs` are only made where `Unit::is_available` found the instructions of `run_row`.
            unsafe { run_row(conv, sources, layout, y, out, buffer) }
        });
    }

    #[target_feature(enable = "avx512f,avx512bf16")]
    fn run_row(
        conv: &Pairs,
        sources: Sources<'_>,
        layout: &Layout,
        y: isize,
        out: &mut [Block],
        buffer: &mut Buffer,
    ) {
        for start in (0..layout.shape.width).step_by(RUN) {
            // The last run overlaps the run before. The shared pixels get the same values again.
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

    /// Rounds what pixels `x..x + RUN` of row `y` see to `buffer`, `[segments, rows, RUN and what the window reaches
    /// beside]`.
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn round(conv: &Pairs, sources: Sources<'_>, y: isize, x: usize, buffer: &mut Buffer) {
        let Pairs { conv, border, segments, .. } = conv;
        let seen = Seen { conv, border: *border, sources };
        let columns = RUN + 2 * conv.reach();
        let lines = buffer.0.as_chunks_mut::<PAIRS>().0.chunks_exact_mut(columns);
        for (k, line) in lines.take(segments.len() * conv.kernel).enumerate() {
            let segment = &segments[k / conv.kernel];
            let Some(pixels) = seen.pixels(segment, k % conv.kernel, y, x) else {
                line.fill([0; PAIRS]);
                continue;
            };
            // Lanes beyond the channels hold anything: they become 0.
            let mask = (u32::MAX >> (32 - segment.channels)) as u16;
            for (to, from) in line.iter_mut().zip(pixels) {
                // SAFETY: both are as large as the vectors that are loaded and stored, and aligned to their size: the
                // buffer and blocks by their types.
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
        weights: &'a [PairWeights],
        bias: &'a [Block],
    }

    impl Job<'_> {
        /// `V` blocks of all pixels, `P` at a time, to `out`, in which blocks are `stride` apart. As in f32, all
        /// indices into sums are constants.
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
        // SAFETY: both types are 512 bits, and all bit patterns are valid.
        unsafe { std::mem::transmute::<__m512i, __m512bh>(bits) }
    }

    #[target_feature(enable = "avx512f")]
    fn load(weights: &PairWeights) -> __m512bh {
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
