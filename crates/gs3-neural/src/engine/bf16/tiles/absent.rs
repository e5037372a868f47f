//! Of processors without tiles: nothing is called, as no [`Tiles`] are made.

use super::{Block, Border, Layout, Sources, Tiles};

/// Nothing.
#[derive(Debug)]
pub struct TileConfig;

impl TileConfig {
    /// Nothing.
    pub fn new() -> Self {
        Self
    }
}

/// Nothing.
pub fn row(_: &Tiles, _: &TileConfig, _: Sources<'_>, _: &Layout, _: isize, _: &mut [Block]) {}

/// Nothing.
pub fn store(_: &[Block], _: usize, _: &mut [Block], _: &Layout, _: usize) {}

/// Nothing.
pub fn fill_halo(_: Border, _: &Layout, _: &mut [Block]) {}
