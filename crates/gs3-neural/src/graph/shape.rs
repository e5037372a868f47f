//! Shapes of tensors.

use std::fmt;
use std::ops::Range;

/// The largest side of an image in pixels, and the most channels of a tensor: products of three such numbers and four
/// bytes stay far below what 64 bits hold.
pub(super) const MAX_SIDE: usize = 1 << 15;

/// Size of a tensor, channels last: `hwc`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Channels.
    pub channels: usize,
}

impl Shape {
    /// Numbers in a tensor of this shape.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pixels() * self.channels
    }

    /// Whether a tensor of this shape holds nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rows × columns.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.height * self.width
    }

    pub(super) fn with_channels(self, channels: usize) -> Self {
        Self { channels, ..self }
    }

    pub(super) fn same_size(&self, other: &Self) -> bool {
        (self.height, self.width) == (other.height, other.width)
    }
}

/// The rows and columns of an image that [`Op::AveragePool`](super::Op::AveragePool) sees at (x, y) of its result.
pub(crate) fn pooled(shape: Shape, at: [usize; 2], side: usize, stride: usize) -> [Range<usize>; 2] {
    let range = |at: usize, length: usize| {
        let (centre, reach) = (at * stride, side / 2);
        centre.saturating_sub(reach)..(centre + reach + 1).min(length)
    };
    [range(at[1], shape.height), range(at[0], shape.width)]
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}×{}×{}", self.height, self.width, self.channels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;

    #[test]
    fn windows_of_an_average_lie_around_their_pixels_and_within_the_image() {
        let shape = Shape { height: 7, width: 8, channels: 1 };
        for (at, rows, columns) in [([0, 0], 0..3, 0..3), ([1, 1], 1..6, 1..6), ([2, 2], 4..7, 4..8)] {
            assert_eq!(pooled(shape, at, 5, 3), [rows.clone(), columns.clone()]);
            let expected: Vec<_> = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).collect();
            assert_eq!(reference::pooled(shape, at, 5, 3).collect::<Vec<_>>(), expected);
        }
    }
}
