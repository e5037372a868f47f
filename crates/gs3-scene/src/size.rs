//! Width and height.

use std::fmt::{self, Display};

/// Width and height of a picture in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Size {
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Size {
    /// A size of `width` × `height` pixels.
    #[must_use]
    pub const fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// The size of rows in memory. A side beyond u32 counts as the largest u32.
    #[must_use]
    pub fn of(width: usize, height: usize) -> Self {
        let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
        Self { width: side(width), height: side(height) }
    }

    /// Number of pixels.
    #[must_use]
    pub const fn pixels(self) -> u64 {
        self.width as u64 * self.height as u64
    }

    /// The size whose sides are `side` of this one's.
    #[must_use]
    pub fn map(self, side: impl Fn(u32) -> u32) -> Self {
        Self { width: side(self.width), height: side(self.height) }
    }

    /// Width and height, for buffers of devices and for files.
    #[must_use]
    pub const fn to_array(self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Width and height, for places in memory.
    #[must_use]
    pub const fn to_usize(self) -> [usize; 2] {
        [self.width as usize, self.height as usize]
    }
}

impl Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl From<[u32; 2]> for Size {
    fn from([width, height]: [u32; 2]) -> Self {
        Self { width, height }
    }
}

impl From<(u32, u32)> for Size {
    fn from((width, height): (u32, u32)) -> Self {
        Self { width, height }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_keep_their_places() {
        let size = Size::new(1920, 1080);
        assert_eq!(size, Size::from([1920, 1080]));
        assert_eq!((size, size.to_string().as_str()), (Size::of(1920, 1080), "1920x1080"));
        assert_eq!((size.to_array(), size.to_usize()), ([1920, 1080], [1920, 1080]));
        assert_eq!(size.map(|side| side / 4), Size::new(480, 270));
        // Beyond u32: all pixels of the largest image, and a side in memory that no image has.
        assert_eq!(Size::new(u32::MAX, u32::MAX).pixels(), u64::from(u32::MAX).pow(2));
        assert_eq!(Size::of(usize::MAX, 2), Size::new(u32::MAX, 2));
    }
}
