//! All sizes of reconstruction on a GPU, from the picture's size and the device's limits: pure functions.

use gs3_compute::{GpuError, Limits};
use gs3_scene::{BLOCK_SIDE, Size, block_grid};

use crate::cpu::nearest::RIM;
use crate::cpu::splat::{COLUMNS, ROWS};
use crate::settings::{MAX_LAYERS, PER_HISTORY};

/// A layer of the history has room for one in so many of the picture's blocks: for the exact blocks of a frame of balanced quality,
/// 6 %.
const PER_LAYER: u32 = 16;

/// Bytes of a block's samples: three arrays of sixteen vectors (`exact_samples` of `blocks.wgsl`).
const EXACT_BLOCK_BYTES: u64 = 3 * BLOCK_PIXELS as u64 * size_of::<[f32; 4]>() as u64;

/// Pixels of a block.
pub const BLOCK_PIXELS: u32 = (BLOCK_SIDE * BLOCK_SIDE) as u32;

/// Bytes of a pixel of an image: four halves.
pub const IMAGE_PIXEL_BYTES: u64 = 8;

/// Sides of the workgroups with one invocation per LR sample.
pub const WORKGROUP: [u32; 2] = [64, 4];

/// Pixels in a row that a workgroup of `warp.wgsl` makes, `PATCHES` patches, and its rows, `LINES`.
pub const WARPED: [u32; 2] = [64, 16];

/// Pixels, in width and height, that a workgroup of `kriging.wgsl` searches for marked ones.
pub const KRIGED: [u32; 2] = [32, 16];

/// Width in pixels made by a workgroup of `tile.wgsl`, with the pixels around the tile.
pub const MADE_WIDTH: u32 = 32;

/// Blocks of 4×4 pixels along a side of the pixels that a workgroup of `tile.wgsl` writes, at most: whole blocks, and parts on
/// both sides.
pub const BLOCKS_ALONG: u32 = (MADE_WIDTH - 2) / BLOCK_SIDE as u32 + 2;

/// Workgroup memory of `tile.wgsl` in bytes: four numbers a made pixel, a flag, and with `expected_errors.wgsl` a number a block.
fn tile_bytes(made_height: u32) -> u32 {
    MADE_WIDTH * made_height * 16 + 16 + BLOCKS_ALONG * BLOCKS_ALONG * 4
}

/// Sizes of super sampling.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SuperSamplePlan {
    /// HR pixels.
    pub size: Size,
    /// LR samples.
    pub lr: Size,
    /// Widest margin that the buffers hold, in LR pixels beyond each edge.
    pub margin: u32,
    /// LR samples with the widest margin.
    pub padded: Size,
    /// HR pixels between samples.
    pub scale: u32,
    /// LR frames in the history, the current frame included.
    pub frames: u32,
    /// Layers: parts of the history with exact blocks of one frame each.
    pub layers: u32,
    /// Exact blocks in a layer.
    pub layer_blocks: u32,
    /// Rows of pixels made by a workgroup of `tile.wgsl`, with the pixels above and below the tile.
    pub made_height: u32,
    /// Workgroups over the LR samples of one frame.
    pub over_samples: [u32; 3],
    /// Workgroups over the LR samples of one frame with the widest margin.
    pub over_around: [u32; 3],
    /// Workgroups over tiles.
    pub over_tiles: [u32; 3],
    /// Workgroups over pixels, to krige the marked pixels.
    pub over_kriged: [u32; 3],
}

/// A buffer and its bytes.
pub type NamedBytes = (&'static str, u64);

fn low_resolution(size: Size, scale: u32) -> Size {
    size.map(|side| side.div_ceil(scale))
}

const fn over(size: Size, groups: [u32; 2]) -> [u32; 3] {
    [size.width.div_ceil(groups[0]), size.height.div_ceil(groups[1]), 1]
}

/// Blocks of 4×4 pixels of a picture.
fn blocks_of(size: Size) -> u32 {
    let [columns, rows] = block_grid(size);
    (columns * rows) as u32
}

/// Workgroups over LR samples.
pub const fn over_samples(lr: Size) -> [u32; 3] {
    over(lr, WORKGROUP)
}

/// Checks that all bindings and dispatches fit the limits.
fn check(limits: &Limits, buffers: &[NamedBytes], dispatches: &[[u32; 3]]) -> Result<(), GpuError> {
    let max = limits.binding_bytes.min(limits.buffer_bytes);
    if let Some((name, actual)) = buffers.iter().find(|(_, bytes)| *bytes > max) {
        return Err(GpuError::TooLarge { what: format!("bytes of buffer {name}"), max, actual: *actual });
    }
    let groups = dispatches.iter().flatten().copied().max().unwrap_or(0);
    if groups > limits.workgroups {
        let (max, actual) = (limits.workgroups.into(), groups.into());
        return Err(GpuError::TooLarge { what: "workgroups of a frame".to_owned(), max, actual });
    }
    Ok(())
}

impl SuperSamplePlan {
    /// The plan for frames of `size`, `scale` (1 to [`crate::MAX_SCALE`]) times the size of their G-buffers, with at
    /// most `margin` LR pixels beyond each edge. `has_blocks` says whether the history holds exact blocks.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if the device cannot bind buffers of this size.
    pub fn new(
        limits: &Limits,
        size: Size,
        scale: u32,
        margin: u32,
        has_blocks: bool,
    ) -> Result<Self, GpuError> {
        // Half as many rows on devices with little workgroup memory; every device has enough for them.
        let fits = |made_height: u32| {
            tile_bytes(made_height) <= limits.workgroup_bytes
                && MADE_WIDTH / 4 * made_height <= limits.workgroup_invocations
        };
        let made_height = if fits(32) { 32 } else { 16 };
        let lr = low_resolution(size, scale);
        let padded = lr.map(|side| side.saturating_add(margin.saturating_mul(2)));
        let blocks = blocks_of(size);
        // No more samples than an LR frame: the same workgroups go over both. Pictures of a few pixels have no layers, and at
        // scale 1 the history is the current frame alone.
        let layer_blocks = blocks.div_ceil(PER_LAYER).min((padded.pixels() / u64::from(BLOCK_PIXELS)) as u32);
        let has_layers = has_blocks && layer_blocks > 0 && scale > 1;
        let layers = if has_layers { blocks.div_ceil(PER_HISTORY).div_ceil(layer_blocks) } else { 0 };
        let layers = layers.min(MAX_LAYERS as u32);
        let mut plan = Self {
            size,
            lr,
            margin,
            padded,
            scale,
            frames: scale * scale,
            layers,
            layer_blocks,
            made_height,
            over_samples: over_samples(lr),
            over_around: over_samples(padded),
            over_tiles: over(size, [MADE_WIDTH - 2, made_height - 2]),
            over_kriged: over(size, KRIGED),
        };
        let check = |plan: &Self| {
            let sources = plan.frames + plan.layers;
            let exact = ("exact samples", u64::from(plan.block_room()) * EXACT_BLOCK_BYTES);
            let all: Vec<_> = plan.buffers().into_iter().chain([exact]).collect();
            check(limits, &all, &[plan.over_around, plan.over_tiles, [sources, 1, 1]])
        };
        // As many exact blocks as the device has room for, none if need be.
        while plan.layers > 0 && check(&plan).is_err() {
            plan.layers -= 1;
        }
        check(&plan)?;
        Ok(plan)
    }

    /// Workgroups over the samples of `sources` LR frames and layers.
    pub fn over_history(&self, sources: u32) -> [u32; 3] {
        let [x, y, _] = self.over_around;
        [x, y, sources]
    }

    /// Samples of remembered LR frames.
    fn lr_samples(&self) -> u64 {
        self.padded.pixels() * u64::from(self.frames)
    }

    /// Exact blocks that the history holds.
    pub fn block_room(&self) -> u32 {
        self.layers * self.layer_blocks
    }

    /// The number of the first sample of layer `layer`.
    pub fn first_of_layer(&self, layer: u32) -> u32 {
        self.lr_samples() as u32 + layer * self.layer_blocks * BLOCK_PIXELS
    }

    /// Bytes of the innovation.
    pub fn innovation_bytes(&self) -> u64 {
        self.lr.pixels() * 16
    }

    /// Bytes of a number for each block of 4×4 pixels.
    pub fn block_bytes(&self) -> u64 {
        u64::from(blocks_of(self.size)) * 4
    }

    /// Number of cells (`cells.wgsl`).
    pub fn cells(&self) -> u64 {
        Size::new(self.size.width + COLUMNS as u32 - 1, self.size.height + ROWS as u32 - 1).pixels()
    }

    /// The buffers that are kept between frames, and the buffers between kernels.
    pub fn buffers(&self) -> [NamedBytes; 16] {
        let samples = self.lr.pixels();
        let remembered = self.lr_samples() + u64::from(self.block_room() * BLOCK_PIXELS);
        let with_rim = self.size.map(|side| side + 2 * RIM as u32);
        [
            ("samples_a", remembered * 8),
            ("samples_b", remembered * 8),
            ("samples_c", remembered * 8),
            ("places", remembered * 8),
            ("landed", remembered * 8),
            ("listed", remembered * 4),
            ("order", remembered * 4),
            ("ordered_places", remembered * 8),
            ("ordered_a", remembered * 8),
            ("cell_ends", self.cells() * 4),
            ("sum", 4),
            ("nearest", with_rim.pixels() * 4),
            ("surface", samples * 32),
            ("errors", samples * 4),
            ("cells", samples * 32),
            ("edge_slopes", (remembered + u64::from(self.block_room())) * 4),
        ]
    }
}

/// Sizes of interpolation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InterpolatePlan {
    /// HR pixels.
    pub size: Size,
    /// LR samples.
    pub lr: Size,
    /// Workgroups over LR samples; of one neighbour.
    pub over_samples: [u32; 3],
    /// Workgroups over HR pixels.
    pub over_pixels: [u32; 3],
}

impl InterpolatePlan {
    /// The plan for frames of `size`, `scale` (1 to [`crate::MAX_SCALE`]) times the size of their G-buffers.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if the device cannot bind buffers of this size.
    pub fn new(limits: &Limits, size: Size, scale: u32) -> Result<Self, GpuError> {
        let lr = low_resolution(size, scale);
        let plan = Self {
            size,
            lr,
            over_samples: over_samples(lr),
            // The first patches may begin up to three pixels before the image.
            over_pixels: over(size.map(|side| side.saturating_add(3)), WARPED),
        };
        let image = ("image", size.pixels() * IMAGE_PIXEL_BYTES);
        let all: Vec<_> = plan.buffers().into_iter().chain([image]).collect();
        check(limits, &all, &[plan.over_samples, plan.over_pixels])?;
        Ok(plan)
    }

    /// Workgroups over the samples of both neighbours.
    pub fn over_neighbors(&self) -> [u32; 3] {
        let [x, y, _] = self.over_samples;
        [x, y, 2]
    }

    /// The buffers between its kernels.
    pub fn buffers(&self) -> [NamedBytes; 3] {
        let samples = self.lr.pixels();
        [("ranges", samples * 16), ("splatted", samples * 4), ("middle", samples * 4)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(binding_bytes: u64, workgroup_bytes: u32) -> Limits {
        Limits { buffer_bytes: 4 * binding_bytes, binding_bytes, workgroup_bytes, ..Limits::LEAST }
    }

    const SIZES: [[u32; 2]; 6] = [[1, 1], [31, 29], [1920, 1080], [4096, 2160], [7680, 4320], [8192, 1]];

    #[test]
    fn every_size_fits_and_is_covered() {
        for workgroup_bytes in [16 << 10, 32 << 10, 48 << 10] {
            let limits = limits(1 << 30, workgroup_bytes);
            for side in SIZES {
                let size = Size::from(side);
                for scale in 1..=crate::MAX_SCALE {
                    let plan = SuperSamplePlan::new(&limits, size, scale, 32, true).unwrap();
                    let tile = [MADE_WIDTH - 2, plan.made_height - 2];
                    for k in 0..2 {
                        assert!(plan.over_tiles[k] * tile[k] >= side[k]);
                        assert!((plan.over_tiles[k] - 1) * tile[k] < side[k]);
                        assert!(plan.over_samples[k] * WORKGROUP[k] >= side[k].div_ceil(scale));
                        assert!(plan.over_around[k] * WORKGROUP[k] >= side[k].div_ceil(scale) + 64);
                    }
                    let bytes = tile_bytes(plan.made_height);
                    assert!(bytes <= workgroup_bytes, "{bytes} of {workgroup_bytes}");
                    let plan = InterpolatePlan::new(&limits, size, scale).unwrap();
                    // Patches begin at most three pixels before the image.
                    assert!(plan.over_pixels[0] * WARPED[0] >= size.width + 3);
                    assert!(plan.over_pixels[1] * WARPED[1] >= size.height + 3);
                }
            }
        }
        assert_eq!(
            SuperSamplePlan::new(&limits(1 << 30, 16 << 10), Size::new(64, 64), 4, 0, true)
                .unwrap()
                .made_height,
            16
        );
    }

    /// The smallest devices make frames of 4096×2160, and refuse larger frames with an error.
    #[test]
    fn the_smallest_devices_take_4k() {
        let small = limits(128 << 20, 32 << 10);
        assert!(SuperSamplePlan::new(&small, Size::new(4096, 2160), 4, 32, true).is_ok());
        assert!(InterpolatePlan::new(&small, Size::new(4096, 2160), 4).is_ok());
        // Larger pictures remember fewer exact blocks, and then none.
        let layers = |width, height| {
            SuperSamplePlan::new(&small, Size::new(width, height), 4, 0, true).map(|plan| plan.layers)
        };
        assert_eq!(layers(4096, 2160), Ok(4));
        assert_eq!(layers(5120, 2880), Ok(2));
        assert_eq!(layers(4096, 4096), Ok(0));
        for refused in [
            SuperSamplePlan::new(&small, Size::new(7680, 4320), 4, 32, true).map(|_| ()),
            InterpolatePlan::new(&small, Size::new(7680, 4320), 4).map(|_| ()),
        ] {
            assert!(matches!(refused, Err(GpuError::TooLarge { max: 134_217_728, .. })), "{refused:?}");
        }
    }
}
