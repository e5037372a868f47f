//! Sizes of a tile and of its memory.

/// Pixels of a tile along x, a multiple of 16. (At 1920×1080 256 takes half a millisecond more, as samples are
/// reprojected for each tile; 640×48 is alike, but then the samples of kriging leave the second cache, which takes 9 ms
/// more on foliage.)
pub(crate) const TILE_WIDTH: usize = 480;

/// Pixels of a tile along y. Width and height are large against a sample's reach, because samples that reach two
/// tiles are added twice.
pub(crate) const TILE_HEIGHT: usize = 32;

/// Pixels beside those of the tile, for what reaches beyond it: as many as a cell of samples or a sample's reach may
/// need.
pub(crate) const PAD_X: usize = 8;

/// The same above and below.
pub(crate) const PAD_Y: usize = 2;

/// Pixels that are made beside those wanted, because the correction of a pixel needs its neighbours.
pub(crate) const RING: usize = 1;

/// Most pixels in a row that are made.
pub(crate) const SPAN: usize = TILE_WIDTH + 2 * RING;

/// Pixels of four vectors, so that one division and one root serve sixteen pixels.
pub(crate) const RUN: usize = 16;

/// Pixels from one row of a tile to the next: room for whole runs.
pub(crate) const STRIDE: usize = SPAN.next_multiple_of(RUN) + 2 * PAD_X;

/// Rows of memory.
pub(crate) const ROWS: usize = TILE_HEIGHT + 2 * RING + 2 * PAD_Y;
