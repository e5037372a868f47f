//! Pixels of the native image, rasterized exactly in blocks of 4×4: where reconstruction is not to be trusted.

use crate::size::Size;

/// Side of a block in pixels of the native image: its sixteen pixels are the lanes of one vector.
pub const BLOCK_SIDE: usize = 4;

/// What is known of the sixteen pixels of a block, row by row: exact samples of the native image at its pixel centres.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct ExactBlock {
    /// Colour over the background, display-encoded RGB, not clamped above: the native image's, bit for bit.
    pub color: [[f32; 16]; 3],
    /// ∂colour/∂x per pixel, RGB.
    pub color_dx: [[f32; 16]; 3],
    /// ∂colour/∂y per pixel, RGB.
    pub color_dy: [[f32; 16]; 3],
    /// View-space depth z of the surface at which transmittance falls to one half, world units; 0 where nothing was hit.
    pub depth_median: [f32; 16],
}

impl ExactBlock {
    /// Black and infinitely far.
    pub const EMPTY: Self = Self {
        color: [[0.0; 16]; 3],
        color_dx: [[0.0; 16]; 3],
        color_dy: [[0.0; 16]; 3],
        depth_median: [0.0; 16],
    };
}

/// Exact blocks of one frame.
///
/// Block `[column, row]` holds pixels `4·column..4·column + 4` of rows `4·row..4·row + 4`. What lies beyond the edges of
/// the image is black and infinitely far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExactBlocks {
    /// Columns and rows of the blocks, each at most once.
    pub places: Vec<[u16; 2]>,
    /// Their pixels, in the same order.
    pub blocks: Vec<ExactBlock>,
}

impl ExactBlocks {
    /// Number of blocks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Forgets all blocks and keeps their memory.
    pub fn clear(&mut self) {
        self.places.clear();
        self.blocks.clear();
    }
}

/// Columns and rows of the blocks that cover an image of `size`.
#[must_use]
pub const fn block_grid(size: Size) -> [usize; 2] {
    let [width, height] = size.to_usize();
    [width.div_ceil(BLOCK_SIDE), height.div_ceil(BLOCK_SIDE)]
}
