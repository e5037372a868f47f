//! High-resolution frames.

use rayon::prelude::*;

use crate::size::Size;

/// Pixels that a thread converts at a time: shorter tasks cost more than they convert.
const PIXELS_AT_ONCE: usize = 1 << 14;

/// An RGB frame, `[height, width, 4]` f32: display-encoded red, green, blue (nominally in `[0, 1]`, not clamped) and
/// a fourth value. The producer states the fourth value's meaning (alpha for the rasterizer, uncertainty for the
/// super sampler).
///
/// There are four channels so that one pixel is one aligned 128-bit load wherever history is gathered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 4]>,
}

impl Image {
    /// A black image with a zero fourth channel.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0.0; 4]; width * height] }
    }

    /// An image from its pixels, row by row.
    ///
    /// Returns `None` if `pixels` does not hold `width × height` of them.
    #[must_use]
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 4]>) -> Option<Self> {
        (Some(pixels.len()) == width.checked_mul(height)).then_some(Self { width, height, pixels })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Width and height.
    #[must_use]
    pub fn size(&self) -> Size {
        Size::of(self.width, self.height)
    }

    /// All pixels, row by row, `[height, width]`.
    #[must_use]
    pub fn pixels(&self) -> &[[f32; 4]] {
        &self.pixels
    }

    /// All pixels, row by row, `[height, width]`.
    #[must_use]
    pub fn pixels_mut(&mut self) -> &mut [[f32; 4]] {
        &mut self.pixels
    }

    /// Row `y`, `[width]`.
    #[must_use]
    pub fn row(&self, y: usize) -> &[[f32; 4]] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Makes the image `width`×`height`, reusing its memory. The contents are unspecified afterwards.
    pub fn resize(&mut self, width: usize, height: usize) {
        self.pixels.resize(width * height, [0.0; 4]);
        self.width = width;
        self.height = height;
    }

    /// The image as 8-bit RGB, row by row: clamped to `[0, 1]`, rounded to nearest.
    #[must_use]
    pub fn to_rgb8(&self) -> Vec<u8> {
        // `as` saturates and maps NaN to 0, so hostile values stay in range.
        self.to_rgb_of(|v| (v * 255.0 + 0.5) as u8)
    }

    /// The image as RGB without its fourth channel, row by row, values as they are.
    #[must_use]
    pub fn to_rgb(&self) -> Vec<f32> {
        self.to_rgb_of(|v| v)
    }

    fn to_rgb_of<T: Send>(&self, convert: impl Fn(f32) -> T + Sync) -> Vec<T> {
        let pixels = self.pixels.par_iter().with_min_len(PIXELS_AT_ONCE);
        let rgb: Vec<[T; 3]> = pixels.map(|[r, g, b, _]| [convert(*r), convert(*g), convert(*b)]).collect();
        rgb.into_flattened()
    }
}
