//! The pixels that losses see.

use std::ops::Range;

use super::CHANNELS;

/// The pixels of an HR image that losses see: not those at its border, where the network saw copies of the border
/// instead of what lies beyond the crop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interior {
    width: usize,
    height: usize,
    margin: usize,
}

impl Interior {
    /// What is at least `margin` pixels from the border of an image; none if nothing is, or if the margin is
    /// below 2: what differences of neighbours reach.
    #[must_use]
    pub fn new(height: usize, width: usize, margin: usize) -> Option<Self> {
        (margin >= 2 && height.min(width) > 2 * margin).then_some(Self { width, height, margin })
    }

    /// Numbers in an image.
    #[must_use]
    pub fn len(&self) -> usize {
        self.height * self.width * CHANNELS
    }

    /// Never: there is always a pixel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// RGB values seen.
    #[must_use]
    pub fn count(&self) -> usize {
        3 * (self.height - 2 * self.margin) * (self.width - 2 * self.margin)
    }

    /// Numbers of a row of the image.
    pub(super) fn stride(&self) -> usize {
        self.width * CHANNELS
    }

    /// The rows seen.
    pub(super) fn rows(&self) -> Range<usize> {
        self.margin..self.height - self.margin
    }

    /// The columns seen.
    pub(super) fn columns(&self) -> Range<usize> {
        self.margin..self.width - self.margin
    }

    /// Where the pixels of each row are in an image of one number a pixel.
    pub(super) fn pixel_spans(&self) -> impl Iterator<Item = Range<usize>> {
        let (Range { start, end }, width) = (self.columns(), self.width);
        self.rows().map(move |y| y * width + start..y * width + end)
    }

    /// Where the numbers of each row are, `beyond` pixels more on each side.
    pub(super) fn spans(&self, beyond: usize) -> impl Iterator<Item = Range<usize>> {
        let (Range { start, end }, stride) = (self.columns(), self.stride());
        let rows = self.rows().start - beyond..self.rows().end + beyond;
        rows.map(move |y| y * stride + (start - beyond) * CHANNELS..y * stride + (end + beyond) * CHANNELS)
    }
}
