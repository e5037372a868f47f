//! How the engine stores tensors: 16 channels of a pixel together.

use crate::shape::Shape;

/// Channels that are computed together.
pub const LANES: usize = 16;

/// 16 channels of a pixel: a cache line, so that no load of one touches two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(64))]
pub struct Block(pub [f32; LANES]);

/// A tensor in the arena, `hCw16c`: rows, in them blocks of channels, in them pixels, in them 16 channels. Lanes beyond
/// the channels hold anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Size without borders.
    pub shape: Shape,
    /// Pixels before and after each row that repeat its border or are zero.
    pub halo: usize,
    /// Place in the arena, in blocks.
    pub start: usize,
}

impl Layout {
    /// Blocks of channels.
    pub fn blocks(&self) -> usize {
        self.shape.channels.div_ceil(LANES)
    }

    /// Pixels of a row with its halo.
    pub fn stride(&self) -> usize {
        self.shape.width + 2 * self.halo
    }

    /// Blocks of a row.
    pub fn row_len(&self) -> usize {
        self.blocks() * self.stride()
    }

    /// Blocks of the tensor.
    pub fn len(&self) -> usize {
        self.shape.height * self.row_len()
    }
}

/// The arena, or what is left of it while a tensor is being written.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    before: &'a [Block],
    after: &'a [Block],
    /// Where `after` begins in the arena.
    resume: usize,
}

impl<'a> Sources<'a> {
    /// All of `arena`, in which nothing is being written.
    pub fn all(arena: &'a [Block]) -> Self {
        Self { before: arena, after: &[], resume: arena.len() }
    }

    /// Splits `arena` into the blocks of `layout` and all others.
    pub fn split(arena: &'a mut [Block], layout: &Layout) -> (&'a mut [Block], Self) {
        let (before, rest) = arena.split_at_mut(layout.start);
        let (out, after) = rest.split_at_mut(layout.len());
        (out, Sources { before, after, resume: layout.start + layout.len() })
    }

    /// Row `y` of a tensor, with halo.
    #[inline(always)]
    pub fn row(&self, layout: &Layout, y: usize) -> &'a [Block] {
        let (start, len) = (layout.start + y * layout.row_len(), layout.row_len());
        match start.checked_sub(self.resume) {
            Some(start) => &self.after[start..][..len],
            None => &self.before[start..][..len],
        }
    }

    /// Block `b` of channels of row `y`, without halo: `[width]`.
    #[inline(always)]
    pub fn pixels(&self, layout: &Layout, y: usize, b: usize) -> &'a [Block] {
        &self.row(layout, y)[b * layout.stride() + layout.halo..][..layout.shape.width]
    }

    /// Channel `c` of pixel (x, y).
    #[inline(always)]
    pub fn at(&self, layout: &Layout, x: usize, y: usize, c: usize) -> f32 {
        self.pixels(layout, y, c / LANES)[x].0[c % LANES]
    }
}
