//! The positions of the native image that a frame samples.

use gs3_scene::{Camera, Size};

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::cover::TileSamples;
use crate::settings::{RasterSettings, Window};
use crate::view::first_sample;

/// Stride of the tiles of blocks that belong to no low-resolution frame. It is the default scale. So tiles have the same size
/// with and without such a frame.
const BLOCK_STRIDE: usize = 4;

/// A lattice of sample positions: every `stride`-th pixel of the native image, along both axes.
///
/// A frame rasterized at its own size has a stride of one. A low-resolution frame of stride S has the same splats as
/// the native image, so [`super::Rasterizer::rasterize_blocks`] can share them.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    /// Pixels of the native image between samples.
    pub stride: usize,
    /// Position of the first sample in pixels of the native image; negative in a margin.
    pub first: [f32; 2],
    /// Pixels of the native image left of and above position `(0, 0)`.
    pub before: [usize; 2],
    /// Position of the first pixel that splats' rectangles count from: negative in a margin.
    pub origin: [f32; 2],
    /// Columns and rows of samples.
    pub size: [usize; 2],
}

impl Grid {
    /// Every pixel of an image of `size`.
    pub const fn native(size: Size) -> Self {
        Self { stride: 1, first: [0.0; 2], before: [0; 2], origin: [0.0; 2], size: size.to_usize() }
    }

    /// Every pixel of `window` of an image, at its position in the image.
    pub fn window(window: Window) -> Self {
        let origin = [window.left, window.top].map(|side| side as f32);
        Self { first: origin, origin, ..Self::native(window.size()) }
    }

    /// The samples of the low-resolution frame of `camera`, `scale` times coarser, under `settings` of that frame.
    pub fn low_resolution(camera: &Camera, scale: u32, settings: &RasterSettings) -> Self {
        let lr = camera.low_resolution(scale);
        let margin = settings.margin;
        let before = [margin.left, margin.top].map(|side| (side * scale) as usize);
        let first = first_sample(scale, settings.jitter);
        let first = [0, 1].map(|a| first[a] as f32 - before[a] as f32);
        let size = margin.padded(lr.size()).to_usize();
        let origin = before.map(|side| -(side as f32));
        Self { stride: scale as usize, first, before, origin, size }
    }

    /// No samples: tiles of [`BLOCK_STRIDE`]² native tiles, for blocks of an image of `size`.
    pub const fn of_blocks(size: Size) -> Self {
        let [width, height] = size.to_usize();
        let size = [width.div_ceil(BLOCK_STRIDE), height.div_ceil(BLOCK_STRIDE)];
        Self { stride: BLOCK_STRIDE, first: [0.0; 2], before: [0; 2], origin: [0.0; 2], size }
    }

    /// Columns and rows of tiles.
    pub const fn tiles(&self) -> [usize; 2] {
        [self.size[0].div_ceil(TILE_WIDTH), self.size[1].div_ceil(TILE_HEIGHT)]
    }

    /// Pixels of the native image that a tile spans.
    pub const fn tile_size(&self) -> [usize; 2] {
        [TILE_WIDTH * self.stride, TILE_HEIGHT * self.stride]
    }

    /// The first pixel of tile `(column, row)`, in the coordinates of splats' rectangles.
    pub const fn tile_corner(&self, tile: [usize; 2]) -> [usize; 2] {
        let [width, height] = self.tile_size();
        [tile[0] * width, tile[1] * height]
    }

    /// The samples of tile `(column, row)`.
    pub fn tile_samples(&self, tile: [usize; 2]) -> TileSamples {
        let corner = self.tile_corner(tile);
        let corner = [0, 1].map(|a| corner[a] as f32 + self.first[a]);
        TileSamples { pitch: self.stride as f32, corner }
    }
}
