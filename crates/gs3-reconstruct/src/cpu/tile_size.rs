//! Sizes of a tile and of its memory.

/// Pixels of a tile along x, a multiple of 16. (At 1920×1080, 256 takes half a millisecond more, because samples are
/// reprojected for each tile. 640×48 is alike without kriging; with kriging its samples no longer fit the
/// second-level cache, which takes 9 ms more on foliage.)
pub(crate) const TILE_WIDTH: usize = 480;

/// Pixels of a tile along y. Width and height are large compared to a sample's reach, because a sample that reaches
/// two tiles is added twice.
pub(crate) const TILE_HEIGHT: usize = 32;

/// Pixels of padding on the left and right of the tile, for writes beyond it: the most that a cell of samples or a
/// sample's reach needs.
pub(crate) const PAD_X: usize = 8;

/// Pixels of padding above and below the tile.
pub(crate) const PAD_Y: usize = 2;

/// Pixels that are made around the wanted pixels, because the correction of a pixel needs its neighbours.
pub(crate) const RING: usize = 1;

/// Most pixels made per row.
pub(crate) const SPAN: usize = TILE_WIDTH + 2 * RING;

/// Pixels of four vectors, so that one division and one root serve sixteen pixels.
pub(crate) const RUN: usize = 16;

/// Pixels from one row of a tile to the next, with space for whole runs.
pub(crate) const STRIDE: usize = SPAN.next_multiple_of(RUN) + 2 * PAD_X;

/// Number of rows in memory.
pub(crate) const ROWS: usize = TILE_HEIGHT + 2 * RING + 2 * PAD_Y;
