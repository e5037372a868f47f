//! How the engine stores tensors: 16 channels of a pixel together.

use bytemuck::{Pod, Zeroable};

use crate::graph::Shape;

/// Channels that are computed together.
pub const LANES: usize = 16;

/// 16 channels of a pixel: a cache line, so that no load of one touches two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub struct Block(pub [f32; LANES]);

/// What a tensor's numbers are, and in what order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numbers {
    /// `hCw16c`: rows, in them blocks of channels, in them pixels, in them 16 channels. Lanes beyond the channels
    /// hold anything.
    #[default]
    F32,
    /// `hwC16c`, rounded, for convolutions on tiles: rows, in them pixels, in them all channels, zeros beyond them. A
    /// row ends with a block of zeros, as tiles see more than pixels.
    Bf16,
}

/// A tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Size without borders; of a strip, width is the strip's.
    pub shape: Shape,
    /// Pixels before and after each row that repeat its border or are zero.
    pub halo: usize,
    /// Place in the arena, or in the thread's scratch memory, in blocks.
    pub start: usize,
    /// Where and how much of it there is.
    pub room: Storage,
    pub numbers: Numbers,
}

/// How much of a tensor is kept, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// All of its rows, in the arena.
    Whole {
        /// Blocks of other tensors between its rows.
        beside: usize,
    },
    /// The last of its rows that were computed, in the memory of a thread.
    Ring {
        /// Blocks of other tensors between its rows.
        beside: usize,
        /// Bits of a row's number that tell its place.
        mask: usize,
    },
    /// Of one row the pixels that are being computed, in scratch memory.
    Strip,
}

impl Layout {
    /// A whole tensor at `start`, alone.
    pub fn whole(shape: Shape, halo: usize, start: usize) -> Self {
        Self { shape, halo, start, room: Storage::Whole { beside: 0 }, numbers: Numbers::F32 }
    }

    /// Blocks of channels.
    pub fn blocks(&self) -> usize {
        self.shape.channels.div_ceil(LANES)
    }

    /// Pixels of a row with its halo.
    pub fn stride(&self) -> usize {
        self.shape.width + 2 * self.halo
    }

    /// Blocks of memory of a row.
    pub fn row_len(&self) -> usize {
        let len = self.blocks() * self.stride();
        match self.numbers {
            Numbers::F32 => len,
            Numbers::Bf16 => len.div_ceil(2) + 1,
        }
    }

    /// Blocks of the tensor.
    pub fn len(&self) -> usize {
        self.shape.height * self.row_len()
    }
}

/// Memory that is being written part by part: the remaining part.
#[derive(Clone, Copy, Debug, Default)]
pub struct Remainder<'a> {
    before: &'a [Block],
    after: &'a [Block],
    /// Where `after` begins.
    resume: usize,
}

impl<'a> Remainder<'a> {
    /// Splits `memory` into the `len` blocks from `start` and all others.
    pub fn split(memory: &'a mut [Block], start: usize, len: usize) -> (&'a mut [Block], Self) {
        let (before, rest) = memory.split_at_mut(start);
        let (out, after) = rest.split_at_mut(len);
        (out, Self { before, after, resume: start + len })
    }

    #[inline(always)]
    fn get(&self, start: usize, len: usize) -> &'a [Block] {
        match start.checked_sub(self.resume) {
            Some(start) => &self.after[start..][..len],
            None => &self.before[start..][..len],
        }
    }
}

/// What can be read while a tensor is being written: whole rows, or those pixels of a row that a strip has.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    arena: Remainder<'a>,
    ring: Remainder<'a>,
    strips: Remainder<'a>,
    /// The pixel of a row with which the strip begins.
    x: usize,
}

impl<'a> Sources<'a> {
    /// All of `arena`, in which nothing is being written, for whole rows.
    pub fn all(arena: &'a [Block]) -> Self {
        Self::rows(Remainder { before: arena, after: &[], resume: arena.len() })
    }

    /// Splits `arena` into the blocks of `layout` and all others, for whole rows.
    pub fn split(arena: &'a mut [Block], layout: &Layout) -> (&'a mut [Block], Self) {
        let (out, rest) = Remainder::split(arena, layout.start, layout.len());
        (out, Self::rows(rest))
    }

    fn rows(arena: Remainder<'a>) -> Self {
        Self { arena, ring: Remainder::default(), strips: Remainder::default(), x: 0 }
    }

    /// For the strip from pixel `x` on.
    pub fn strip(arena: Remainder<'a>, ring: Remainder<'a>, strips: Remainder<'a>, x: usize) -> Self {
        Self { arena, ring, strips, x }
    }

    /// The first pixel of what is computed.
    #[inline(always)]
    pub fn x(&self) -> usize {
        self.x
    }

    /// Row `y` of a tensor, with halo, or what there is of it.
    #[inline(always)]
    pub fn row(&self, layout: &Layout, y: usize) -> &'a [Block] {
        let len = layout.row_len();
        match layout.room {
            Storage::Whole { beside } => self.arena.get(layout.start + y * (len + beside), len),
            Storage::Ring { beside, mask } => self.ring.get(layout.start + (y & mask) * (len + beside), len),
            Storage::Strip => self.strips.get(layout.start, len),
        }
    }

    /// Where in a block's part of [`Sources::row`] the first pixel of what is computed is.
    #[inline(always)]
    pub fn first(&self, layout: &Layout) -> usize {
        match layout.room {
            Storage::Whole { .. } | Storage::Ring { .. } => layout.halo + self.x,
            Storage::Strip => 0,
        }
    }

    /// Block `b` of channels of row `y`, from the first pixel of what is computed to the end of the image or strip.
    #[inline(always)]
    pub fn pixels(&self, layout: &Layout, y: usize, b: usize) -> &'a [Block] {
        let line = &self.row(layout, y)[b * layout.stride()..][..layout.stride()];
        &line[self.first(layout)..line.len() - layout.halo]
    }

    /// Block `b` of channels of row `y` of a whole tensor, without halo: `[width]`.
    #[inline(always)]
    pub fn line(&self, layout: &Layout, y: usize, b: usize) -> &'a [Block] {
        &self.row(layout, y)[b * layout.stride() + layout.halo..][..layout.shape.width]
    }

    /// Channel `c` of pixel (x, y) of a whole tensor.
    #[inline(always)]
    pub fn at(&self, layout: &Layout, x: usize, y: usize, c: usize) -> f32 {
        self.line(layout, y, c / LANES)[x].0[c % LANES]
    }
}
