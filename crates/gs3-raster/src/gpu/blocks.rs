//! Exact blocks: pixels of the native image, made from the splats of a low-resolution frame; see `cpu/blocks.rs`.

use gs3_compute::{Bound, Buffer, GpuError};
use gs3_scene::block_grid;

/// Invocations of a workgroup that makes exact blocks, one a pixel: sixteen blocks.
pub const BLOCK_PIXELS: u32 = 256;

/// The name of the stage of exact blocks.
pub const BLOCKS_STAGE: &str = "blocks";

/// Bytes of a pixel of the image that blocks are written into: four halves.
const IMAGE_PIXEL_BYTES: u64 = 8;

/// Bytes of a block's entry that says whether the block is made.
const CHOSEN_BYTES: u64 = 4;

/// Which blocks of 4×4 pixels are made, and the image that they are written into. Frames that alternate between images
/// have an object for each.
#[derive(Debug)]
pub struct GpuBlocks {
    /// A u32 for each block, row by row: not 0 if the block is made.
    pub(super) chosen: Buffer,
    pub(super) image: Buffer,
    /// Number of the frame that `blend` is bound to, among all frames; 0 for none.
    pub(super) frame: u64,
    /// One kernel per band.
    pub(super) blend: Vec<Bound>,
}

impl GpuBlocks {
    /// `chosen` has a u32 for each block of the image, row by row ([`gs3_scene::block_grid`]): not 0 if the block is made.
    /// `image` has four halves for each pixel, row by row: RGB, display-encoded, and 0.
    #[must_use]
    pub const fn new(chosen: Buffer, image: Buffer) -> Self {
        Self { chosen, image, frame: 0, blend: Vec::new() }
    }

    /// Checks that the buffers hold a picture of `size`.
    pub(super) fn check(&self, size: [u32; 2]) -> Result<(), GpuError> {
        let area = |[width, height]: [usize; 2]| width as u64 * height as u64;
        let size = size.map(|side| side as usize);
        let needs = [
            ("chosen", &self.chosen, area(block_grid(size)) * CHOSEN_BYTES),
            ("image", &self.image, area(size) * IMAGE_PIXEL_BYTES),
        ];
        match needs.into_iter().find(|(_, buffer, bytes)| buffer.bytes() < *bytes) {
            None => Ok(()),
            Some((name, buffer, bytes)) => Err(GpuError::Bindings {
                kernel: "exact blocks".to_owned(),
                expected: format!("{bytes} bytes of {name}"),
                actual: buffer.bytes().to_string(),
            }),
        }
    }
}
