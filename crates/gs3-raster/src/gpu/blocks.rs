//! Low-resolution frames, and exact blocks beside them: pixels of the native image, made from the frame's splats; see
//! `cpu/blocks.rs`.

use gs3_compute::{Bound, Buffer, GpuError, Recorder};
use gs3_scene::{BLOCK_SIDE, Camera, Size, block_grid};

use super::view::Native;
use super::{GpuGBuffer, GpuRasterError, GpuRasterizer, check};
use crate::settings::{Culling, Outputs, RasterError, RasterSettings};
use crate::view::View;

/// Invocations of a workgroup that makes exact blocks, one a pixel: sixteen blocks.
pub const BLOCK_PIXELS: u32 = 256;

/// The name of the stage of exact blocks.
pub const BLOCKS_STAGE: &str = "blocks";

/// Bytes of a pixel of the image that blocks are written into: four halves.
const IMAGE_PIXEL_BYTES: u64 = 8;

/// Bytes of a block's entry that says whether the block is made.
const CHOSEN_BYTES: u64 = 4;

/// Bytes of the samples of a block: three vectors of four f32 for each pixel.
pub const EXACT_BLOCK_BYTES: u64 = (BLOCK_SIDE * BLOCK_SIDE * 3 * size_of::<[f32; 4]>()) as u64;

/// A low-resolution frame.
#[derive(Clone, Copy, Debug)]
pub struct LowResolution<'a> {
    /// The camera of the native image.
    pub camera: &'a Camera,
    /// How many times coarser the frame is.
    pub scale: u32,
    /// Whether [`GpuRasterizer::record_blocks`] follows. Splats that lie between samples are projected as well then.
    pub has_blocks: bool,
}

/// Which blocks of 4×4 pixels are made, and the image that they are written into. Frames that alternate between images
/// have an object for each.
#[derive(Debug)]
pub struct GpuBlocks {
    chosen: Buffer,
    image: Buffer,
    samples: Buffer,
    /// Number of the frame that `blend` is bound to, among all frames; 0 for none.
    frame: u64,
    /// One kernel per band.
    blend: Vec<Bound>,
}

impl GpuBlocks {
    /// `chosen` has a u32 for each block of the image, row by row ([`gs3_scene::block_grid`]): the block's number among the
    /// blocks to be made, from 1 on, or 0 if the block is not made. `image` has four halves for each pixel, row by row: RGB,
    /// display-encoded, and 0.
    ///
    /// `samples` takes what [`gs3_scene::ExactBlock`] holds, as f32, of as many blocks as it has room for
    /// ([`EXACT_BLOCK_BYTES`] each), in the order of their numbers. It has three arrays of `[blocks, 16, 4]`: RGB,
    /// display-encoded, and median depth z, world units, 0 for none; ∂RGB/∂x per pixel of the image and 0; ∂RGB/∂y and 0.
    /// Pixels beyond the edges of the image are not written.
    #[must_use]
    pub const fn new(chosen: Buffer, image: Buffer, samples: Buffer) -> Self {
        Self { chosen, image, samples, frame: 0, blend: Vec::new() }
    }

    /// Checks that the buffers hold a picture of `size`.
    pub(super) fn check(&self, size: Size) -> Result<(), GpuError> {
        let [columns, rows] = block_grid(size);
        let needs = [
            ("chosen", &self.chosen, (columns * rows) as u64 * CHOSEN_BYTES),
            ("image", &self.image, size.pixels() * IMAGE_PIXEL_BYTES),
            ("samples", &self.samples, EXACT_BLOCK_BYTES),
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

impl GpuRasterizer {
    /// As [`Self::record`] of the low-resolution camera. Samples are the same with and without exact blocks.
    ///
    /// # Errors
    /// As [`Self::record`]; with exact blocks, as [`crate::Rasterizer::rasterize_low_resolution`].
    pub fn record_low_resolution(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: LowResolution<'_>,
        settings: &RasterSettings,
        out: &mut GpuGBuffer,
    ) -> Result<(), GpuRasterError> {
        check(settings)?;
        let near = self.scene.details().near;
        let camera = frame.camera.low_resolution(frame.scale);
        // The limits come from the native image. Where the scale does not divide the size, the low-resolution camera has others.
        let View { jacobian_limits, .. } = View::new(frame.camera, settings, near);
        let view = View { jacobian_limits, ..View::new(&camera, settings, near) };
        if frame.has_blocks {
            settings.check_blocks(frame.scale)?;
        }
        let native = frame.has_blocks.then_some(Native { scale: frame.scale, size: frame.camera.size() });
        self.record_view(recorder, camera.size(), &view, native, settings, out)
    }

    /// Whether [`Self::record_blocks`] makes the native image's pixels. [`Culling::Aabb3Sigma`] and [`Culling::Adr`] cut
    /// splats at tiles. A low-resolution frame and the native image have different tiles.
    #[must_use]
    pub const fn makes_blocks(&self) -> bool {
        !matches!(self.culling, Culling::Aabb3Sigma | Culling::Adr)
    }

    /// Records exact blocks of the frame of [`Self::record_low_resolution`] recorded last, which had
    /// [`LowResolution::has_blocks`]: the pixels of the chosen blocks are written into the image, with the native image's
    /// colours but for rounding, and their samples into the samples. Other pixels keep their values.
    ///
    /// # Errors
    /// [`RasterError::NoFrame`] if no such frame was recorded, the frame had only colour, or the rasterizer makes no blocks;
    /// [`GpuRasterError::Gpu`] if
    /// the buffers are too small for the camera's picture, or the device fails.
    pub fn record_blocks(
        &mut self,
        recorder: &mut Recorder<'_>,
        blocks: &mut GpuBlocks,
    ) -> Result<(), GpuRasterError> {
        let (true, Some(Native { scale, size }), Some(frame)) =
            (self.makes_blocks(), self.native, &self.frame)
        else {
            return Err(RasterError::NoFrame.into());
        };
        if frame.plan.outputs == Outputs::Color {
            return Err(RasterError::NoFrame.into());
        }
        blocks.check(size)?;
        if blocks.frame != self.frame_number {
            let kernel = self.kernels.blend_blocks(&self.gpu, &frame.plan)?;
            let buffers = [&blocks.chosen, &blocks.image, &blocks.samples];
            blocks.blend = frame.bind_blocks(&self.gpu, &self.fixed, &self.arena, &kernel, buffers)?;
            blocks.frame = self.frame_number;
        }
        frame.record_blocks(recorder, &blocks.blend, scale);
        Ok(())
    }
}
