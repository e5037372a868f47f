//! Images and G-buffers in device memory.

use std::sync::{Arc, OnceLock};

use gs3_compute::{Buffer, Gpu, GpuError, Recorder, Use, wgpu};
use gs3_scene::{Image, Size};
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
    size: Size,
    pixels: Buffer,
    /// The rows as far apart as textures want them, once a texture wanted some.
    rows: Arc<OnceLock<Buffer>>,
}

impl GpuImage {
    /// An image of zeros.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if frames cannot have this size, or the device has too little memory.
    pub fn new(gpu: &Gpu, size: Size) -> Result<Self, GpuReconstructError> {
        check_frame_size(size)?;
        let bytes = size.pixels() * IMAGE_PIXEL_BYTES;
        Ok(Self { size, pixels: gpu.buffer("image", Use::Storage, bytes)?, rows: Arc::default() })
    }

    /// Width and height in pixels.
    #[must_use]
    pub const fn size(&self) -> Size {
        self.size
    }

    /// The pixels' buffer.
    #[must_use]
    pub const fn pixels(&self) -> &Buffer {
        &self.pixels
    }

    /// Length in bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.size.pixels() * IMAGE_PIXEL_BYTES
    }

    /// Decodes `bytes`, read back from such an image, into `out`, which is resized.
    pub fn decode(&self, bytes: &[u8], out: &mut Image) {
        let [width, height] = self.size.to_usize();
        out.resize(width, height);
        let pixels = out.pixels_mut().par_chunks_mut(DECODED);
        pixels.zip(bytes.par_chunks(DECODED * IMAGE_PIXEL_BYTES as usize)).for_each(|(pixels, bytes)| {
            let halves = bytes.chunks_exact(2).map(|half| f16::from_le_bytes([half[0], half[1]]));
            pixels.as_flattened_mut().iter_mut().zip(halves).for_each(|(to, half)| *to = half.to_f32());
        });
    }

    /// Records a copy of the image to `texture`, for programs that draw frames. The texture has format `Rgba16Float`, the
    /// size of the image, one sample a pixel, and usage `COPY_DST`. Its alpha is the uncertainty: draw the texture without blending.
    ///
    /// Images with a width that is no multiple of 32 need a copy of their own, made at the first call, as rows of
    /// textures begin at multiples of 256 bytes.
    ///
    /// # Errors
    /// [`GpuError::Refused`] for any other texture; otherwise if the copy cannot be made.
    pub fn copy_to_texture(
        &self,
        gpu: &Gpu,
        recorder: &mut Recorder<'_>,
        texture: &wgpu::Texture,
    ) -> Result<(), GpuError> {
        const EXPECTED: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
        let refused =
            |message: String| GpuError::Refused { what: "a texture for a frame".to_owned(), message };
        let Size { width, height } = self.size;
        let expected = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        if texture.size() != expected {
            return Err(refused(format!("expected {expected:?}, found {:?}", texture.size())));
        }
        if texture.format() != EXPECTED {
            return Err(refused(format!("expected {EXPECTED:?}, found {:?}", texture.format())));
        }
        if texture.sample_count() != 1 {
            return Err(refused(format!("expected 1 sample a pixel, found {}", texture.sample_count())));
        }
        if !texture.usage().contains(wgpu::TextureUsages::COPY_DST) {
            return Err(refused(format!("expected usage COPY_DST, found {:?}", texture.usage())));
        }
        let row = u64::from(width) * IMAGE_PIXEL_BYTES;
        let apart = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT.into());
        if row == apart {
            recorder.copy_to_texture(&self.pixels.slice(), apart as u32, texture);
            return Ok(());
        }
        let rows = match self.rows.get() {
            Some(rows) => rows,
            None => {
                let made = gpu.buffer("rows of a texture", Use::Storage, apart * u64::from(height))?;
                self.rows.get_or_init(|| made)
            }
        };
        for y in 0..u64::from(height) {
            recorder.copy(&self.pixels.part(y * row, row), &rows.part(y * apart, row));
        }
        recorder.copy_to_texture(&rows.slice(), apart as u32, texture);
        Ok(())
    }

    /// Reads the image back into `out`, which is resized. The call waits for the device. Inside a frame, use
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

/// The planes of an LR G-buffer that reconstruction reads, in device memory, from any renderer: four f32 a pixel, row
/// by row, `[height, width, 4]`.
#[derive(Clone, Copy, Debug)]
pub struct GpuPlanes<'a> {
    /// Colour, display-encoded RGB; the fourth number is not read.
    pub color_alpha: &'a Buffer,
    /// ∂colour/∂x per LR pixel, and the median depth along z in world units, 0 where there is no surface.
    pub dx_median: &'a Buffer,
    /// ∂colour/∂y per LR pixel; the fourth number is not read.
    pub dy_expected: &'a Buffer,
}

/// Bytes of a pixel of a plane: four f32.
const PLANE_PIXEL_BYTES: u64 = 16;

impl GpuPlanes<'_> {
    /// Checks that the planes hold an LR frame of `size`.
    pub(super) fn check(&self, size: Size) -> Result<(), GpuError> {
        let min = size.pixels() * PLANE_PIXEL_BYTES;
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
