//! The G-buffer in device memory.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use gs3_compute::{Bound, Buffer, Gpu, GpuError, Use, now};
use gs3_scene::{GBuffer, Geometry, Gradients, Image, Margin, Planes, Size};

use super::crop::BoundCrop;
use super::plan::PIXEL_BYTES;
use crate::settings::Outputs;

/// Bytes read back at a time.
const STEP_BYTES: u64 = 32 << 20;

/// The output of a frame in device memory: planes of four f32 a pixel, row by row, `[height, width, 4]`. If there is
/// memory for margins, rows lie [`Self::stride`] pixels apart. Later stages read the buffers in the same submission
/// or in a later one.
///
/// With two G-buffers, the previous frame is kept while the next frame is made.
#[derive(Default)]
pub struct GpuGBuffer {
    size: Size,
    /// Capacity in pixels, per row and per column.
    room: Size,
    jitter: [f32; 2],
    margin: Margin,
    /// Number of these planes among all planes ever made; 0 for none.
    made: u64,
    /// The planes by their names in the shaders.
    planes: Vec<(&'static str, Buffer)>,
    pub(super) target: Target,
    pub(super) crop: BoundCrop,
}

impl fmt::Debug for GpuGBuffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuGBuffer").field("size", &self.size).finish_non_exhaustive()
    }
}

/// Number of planes made by all G-buffers, counted from 1. A picture uses it to identify the planes that it is copied
/// from.
static MADE: AtomicU64 = AtomicU64::new(1);

/// Blending into a G-buffer.
#[derive(Default)]
pub struct Target {
    /// Number of the frame that it is bound to, among all frames; 0 for none.
    pub frame: u64,
    /// One kernel per band.
    pub blend: Vec<Bound>,
}

/// Names of the planes of `outputs`.
const fn plane_names(outputs: Outputs) -> &'static [&'static str] {
    match outputs {
        Outputs::Color => &["color_alpha"],
        Outputs::Samples | Outputs::GBuffer => &["color_alpha", "dx_median", "dy_expected", "normal"],
        Outputs::GBufferMixed => &["color_alpha", "dx_median", "dy_expected", "normal", "dxdy"],
    }
}

impl GpuGBuffer {
    /// The size, the margin included; 0x0 before the first frame.
    #[must_use]
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Distance of the planes' rows, in pixels.
    #[must_use]
    pub const fn stride(&self) -> u32 {
        self.room.width
    }

    /// The margin beyond the edges of the picture.
    #[must_use]
    pub const fn margin(&self) -> Margin {
        self.margin
    }

    /// Offset of the samples from the pixel centres, pixels.
    #[must_use]
    pub const fn jitter(&self) -> [f32; 2] {
        self.jitter
    }

    /// Colour, display-encoded RGB over the background, and alpha.
    #[must_use]
    pub fn color_alpha(&self) -> Option<&Buffer> {
        self.plane("color_alpha")
    }

    /// ∂colour/∂x per pixel, and the median depth along z in world units, 0 where there is no surface.
    #[must_use]
    pub fn dx_median(&self) -> Option<&Buffer> {
        self.plane("dx_median")
    }

    /// ∂colour/∂y per pixel, and the expected depth along z in world units, 0 where there is no surface.
    #[must_use]
    pub fn dy_expected(&self) -> Option<&Buffer> {
        self.plane("dy_expected")
    }

    /// The view-space normal, accumulated with the blending weights, and 0.
    #[must_use]
    pub fn normal(&self) -> Option<&Buffer> {
        self.plane("normal")
    }

    /// ∂²colour/∂x∂y, and 0.
    #[must_use]
    pub fn dxdy(&self) -> Option<&Buffer> {
        self.plane("dxdy")
    }

    pub(super) fn planes(&self) -> &[(&'static str, Buffer)] {
        &self.planes
    }

    pub(super) const fn made(&self) -> u64 {
        self.made
    }

    /// Stores the size, margin and jitter of the next frame.
    pub(super) fn set(&mut self, size: Size, margin: Margin, jitter: [f32; 2]) {
        (self.size, self.margin, self.jitter) = (size, margin, jitter);
    }

    /// Allocates the planes of `outputs` for `room` pixels.
    pub(super) fn fit(&mut self, gpu: &Gpu, outputs: Outputs, room: Size) -> Result<(), GpuError> {
        let names = plane_names(outputs);
        if self.room == room && self.planes.iter().map(|(name, _)| *name).eq(names.iter().copied()) {
            return Ok(());
        }
        *self = Self::default();
        let bytes = room.pixels() * PIXEL_BYTES;
        for name in names {
            self.planes.push((*name, gpu.buffer(name, Use::Storage, bytes)?));
        }
        self.room = room;
        self.made = MADE.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Reads everything back into `out`, which gets the size and the planes. The call waits for the device.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails; in a browser [`Self::read_async`] is for it.
    pub fn read(&self, gpu: &Gpu, out: &mut GBuffer) -> Result<(), GpuError> {
        now(self.read_async(gpu, out))
    }

    /// Reads everything back, as [`Self::read`] does, without blocking a browser.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub async fn read_async(&self, gpu: &Gpu, out: &mut GBuffer) -> Result<(), GpuError> {
        (out.jitter, out.margin) = (self.jitter, self.margin);
        self.read_into(gpu, self.color_alpha(), &mut out.color, Some(&mut out.alpha)).await?;
        if self.dx_median().is_none() {
            out.gradients = None;
            out.geometry = None;
            return Ok(());
        }
        let Gradients { color_dx, color_dy, color_dxy } =
            out.gradients.get_or_insert_with(Gradients::default);
        let geometry = out.geometry.get_or_insert_with(Geometry::default);
        self.read_into(gpu, self.dx_median(), color_dx, Some(&mut geometry.depth_median)).await?;
        self.read_into(gpu, self.dy_expected(), color_dy, Some(&mut geometry.depth_expected)).await?;
        self.read_into(gpu, self.normal(), &mut geometry.normal, None).await?;
        match self.dxdy() {
            Some(dxdy) => {
                self.read_into(gpu, Some(dxdy), color_dxy.get_or_insert_with(Planes::default), None).await?
            }
            None => *color_dxy = None,
        }
        Ok(())
    }

    /// Reads colour and alpha back as an image. The future waits for the device.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub async fn read_image(&self, gpu: &Gpu, out: &mut Image) -> Result<(), GpuError> {
        let [width, height] = self.size.to_usize();
        out.resize(width, height);
        self.read_runs(gpu, self.color_alpha(), |first, pixels| {
            out.pixels_mut()[first..first + pixels.len()].copy_from_slice(pixels);
        })
        .await
    }

    fn plane(&self, name: &str) -> Option<&Buffer> {
        self.planes.iter().find(|(n, _)| *n == name).map(|(_, buffer)| buffer)
    }

    /// Three planes and a fourth one from one buffer.
    async fn read_into(
        &self,
        gpu: &Gpu,
        from: Option<&Buffer>,
        rgb: &mut Planes<3>,
        mut fourth: Option<&mut Planes<1>>,
    ) -> Result<(), GpuError> {
        let [width, height] = self.size.to_usize();
        let count = width * height;
        rgb.resize(width, height);
        if let Some(fourth) = &mut fourth {
            fourth.resize(width, height);
        }
        self.read_runs(gpu, from, |first, pixels| {
            for (i, [r, g, b, a]) in (first..).zip(pixels) {
                let data = rgb.data_mut();
                (data[i], data[count + i], data[2 * count + i]) = (*r, *g, *b);
                if let Some(fourth) = &mut fourth {
                    fourth.data_mut()[i] = *a;
                }
            }
        })
        .await
    }

    /// Calls `take` with runs of the pixels of `plane`, and the index of each run's first pixel.
    async fn read_runs(
        &self,
        gpu: &Gpu,
        plane: Option<&Buffer>,
        mut take: impl FnMut(usize, &[[f32; 4]]),
    ) -> Result<(), GpuError> {
        let Some(plane) = plane else { return Ok(()) };
        let [width, height] = self.size.to_usize();
        // Whole rows; the picture may be a part of each row.
        let row_bytes = u64::from(self.stride()) * PIXEL_BYTES;
        let rows = (STEP_BYTES / row_bytes).max(1) as usize;
        for first in (0..height).step_by(rows) {
            let count = rows.min(height - first);
            let part = plane.part(first as u64 * row_bytes, count as u64 * row_bytes);
            let pixels = gpu.read_async::<[f32; 4]>(&part).await?;
            for (y, row) in (first..).zip(pixels.chunks(self.stride() as usize)) {
                take(y * width, &row[..width]);
            }
        }
        Ok(())
    }
}
