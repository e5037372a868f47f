//! Images and G-buffers in device memory.

use gs3_compute::{Buffer, Gpu, GpuError, Use};
use gs3_scene::Image;
use half::f16;
use rayon::prelude::*;

use super::error::GpuReconstructError;
use super::plan::IMAGE_PIXEL_BYTES;
use crate::error::check_frame_size;

/// Pixels that a thread decodes at a time.
const DECODED: usize = 1 << 14;

/// An HR image in device memory: four halves a pixel, row by row, `[height, width, 4]`: RGB and the uncertainty. A
/// value in `[0, 1]` is off by at most 2⁻¹², a sixteenth of a step of 8-bit displays.
#[derive(Clone, Debug)]
pub struct GpuImage {
    size: [u32; 2],
    pixels: Buffer,
}

impl GpuImage {
    /// An image of zeros of `size`, width and height.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if no frame can have that size, or the device has no room for it.
    pub fn new(gpu: &Gpu, size: [u32; 2]) -> Result<Self, GpuReconstructError> {
        check_frame_size(size)?;
        let bytes = u64::from(size[0]) * u64::from(size[1]) * IMAGE_PIXEL_BYTES;
        Ok(Self { size, pixels: gpu.buffer("image", Use::Storage, bytes)? })
    }

    /// Width and height in pixels.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Its pixels.
    #[must_use]
    pub const fn pixels(&self) -> &Buffer {
        &self.pixels
    }

    /// Its length in bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.size[0] as u64 * self.size[1] as u64 * IMAGE_PIXEL_BYTES
    }

    /// What was read back of such an image as `out`, which takes its size.
    pub fn decode(&self, bytes: &[u8], out: &mut Image) {
        out.resize(self.size[0] as usize, self.size[1] as usize);
        let pixels = out.pixels_mut().par_chunks_mut(DECODED);
        pixels.zip(bytes.par_chunks(DECODED * IMAGE_PIXEL_BYTES as usize)).for_each(|(pixels, bytes)| {
            let halves = bytes.chunks_exact(2).map(|half| f16::from_le_bytes([half[0], half[1]]));
            pixels.as_flattened_mut().iter_mut().zip(halves).for_each(|(to, half)| *to = half.to_f32());
        });
    }

    /// Reads it back into `out`, which takes its size. It waits for the device; a frame's own way back is
    /// [`Recorder::read_back`](gs3_compute::Recorder::read_back) and [`Self::decode`].
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub fn read(&self, gpu: &Gpu, out: &mut Image) -> Result<(), GpuError> {
        let bytes = gpu.read::<u8>(&self.pixels.part(0, self.bytes()))?;
        self.decode(&bytes, out);
        Ok(())
    }
}

/// The planes of an LR G-buffer that reconstruction reads, in device memory, of any renderer: four f32 a pixel, row
/// by row, `[height, width, 4]`.
#[derive(Clone, Copy, Debug)]
pub struct GpuPlanes<'a> {
    /// Colour, display-encoded RGB, and anything.
    pub color_alpha: &'a Buffer,
    /// ∂colour/∂x per LR pixel, and the median depth along z, world units, 0 where nothing was hit.
    pub dx_median: &'a Buffer,
    /// ∂colour/∂y per LR pixel, and anything.
    pub dy_expected: &'a Buffer,
}

/// Bytes of a pixel of a plane: four f32.
const PLANE_PIXEL_BYTES: u64 = 16;

impl GpuPlanes<'_> {
    /// Whether they hold an LR frame of `size`, width and height.
    pub(super) fn check(&self, size: [u32; 2]) -> Result<(), GpuError> {
        let min = u64::from(size[0]) * u64::from(size[1]) * PLANE_PIXEL_BYTES;
        let planes = [
            ("color_alpha", self.color_alpha),
            ("dx_median", self.dx_median),
            ("dy_expected", self.dy_expected),
        ];
        for (name, plane) in planes {
            let actual = plane.bytes();
            if actual < min {
                return Err(GpuError::TooSmall { what: format!("bytes of plane {name}"), min, actual });
            }
        }
        Ok(())
    }
}
