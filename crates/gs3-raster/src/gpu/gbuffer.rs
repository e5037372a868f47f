//! The G-buffer in device memory.

use gs3_compute::{Bound, Buffer, Gpu, GpuError, Use};
use gs3_scene::{GBuffer, Geometry, Gradients, Image, Planes};

use super::plan::{FramePlan, PIXEL_BYTES};
use crate::settings::Outputs;

/// Bytes read back at a time.
const STEP_BYTES: u64 = 32 << 20;

/// What a frame was rasterized into, in device memory: planes of four f32 a pixel, row by row, `[height, width, 4]`.
/// Later stages read the buffers in the same submission or in a later one.
///
/// Two of them keep the frame before while the next one is made.
#[derive(Default)]
pub struct GpuGBuffer {
    size: [u32; 2],
    jitter: [f32; 2],
    /// By the names that the shaders have for them.
    planes: Vec<(&'static str, Buffer)>,
    pub(super) target: Target,
}

/// Blending into a G-buffer.
#[derive(Default)]
pub struct Target {
    /// Which of all frames it is bound to, 0 for none.
    pub frame: u64,
    /// A kernel for each band.
    pub blend: Vec<Bound>,
}

/// Names of the planes that `outputs` asks for.
const fn plane_names(outputs: Outputs) -> &'static [&'static str] {
    match outputs {
        Outputs::Color => &["color_alpha"],
        Outputs::GBuffer => &["color_alpha", "dx_median", "dy_expected", "normal"],
        Outputs::GBufferMixed => &["color_alpha", "dx_median", "dy_expected", "normal", "dxdy"],
    }
}

impl GpuGBuffer {
    /// Width and height in pixels; zeros before the first frame.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
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

    /// ∂colour/∂x per pixel, and the median depth along z, world units, 0 where nothing was hit.
    #[must_use]
    pub fn dx_median(&self) -> Option<&Buffer> {
        self.plane("dx_median")
    }

    /// ∂colour/∂y per pixel, and the expected depth along z, world units, 0 where nothing was hit.
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

    pub(super) fn set_jitter(&mut self, jitter: [f32; 2]) {
        self.jitter = jitter;
    }

    /// Gives it the planes and the size of `plan`.
    pub(super) fn fit(&mut self, gpu: &Gpu, plan: &FramePlan) -> Result<(), GpuError> {
        let names = plane_names(plan.outputs);
        if self.size == plan.size && self.planes.iter().map(|(name, _)| *name).eq(names.iter().copied()) {
            return Ok(());
        }
        *self = Self::default();
        for name in names {
            self.planes.push((*name, gpu.buffer(name, Use::Storage, plan.plane_bytes())?));
        }
        self.size = plan.size;
        Ok(())
    }

    /// Reads everything back into `out`, which takes the size and the planes. It waits for the device.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub fn read(&self, gpu: &Gpu, out: &mut GBuffer) -> Result<(), GpuError> {
        out.jitter = self.jitter;
        self.read_into(gpu, self.color_alpha(), &mut out.color, Some(&mut out.alpha))?;
        if self.dx_median().is_none() {
            out.gradients = None;
            out.geometry = None;
            return Ok(());
        }
        let Gradients { color_dx, color_dy, color_dxdy } =
            out.gradients.get_or_insert_with(Gradients::default);
        let geometry = out.geometry.get_or_insert_with(Geometry::default);
        self.read_into(gpu, self.dx_median(), color_dx, Some(&mut geometry.depth_median))?;
        self.read_into(gpu, self.dy_expected(), color_dy, Some(&mut geometry.depth_expected))?;
        self.read_into(gpu, self.normal(), &mut geometry.normal, None)?;
        match self.dxdy() {
            Some(dxdy) => {
                self.read_into(gpu, Some(dxdy), color_dxdy.get_or_insert_with(Planes::default), None)?
            }
            None => *color_dxdy = None,
        }
        Ok(())
    }

    /// Reads colour and alpha back as an image. It waits for the device.
    ///
    /// # Errors
    /// [`GpuError`] if the device fails.
    pub fn read_image(&self, gpu: &Gpu, out: &mut Image) -> Result<(), GpuError> {
        out.resize(self.size[0] as usize, self.size[1] as usize);
        read_steps(gpu, self.color_alpha(), |first, pixels| {
            out.pixels_mut()[first..first + pixels.len()].copy_from_slice(pixels);
        })
    }

    fn plane(&self, name: &str) -> Option<&Buffer> {
        self.planes.iter().find(|(n, _)| *n == name).map(|(_, buffer)| buffer)
    }

    /// Three planes and a fourth one from one buffer.
    fn read_into(
        &self,
        gpu: &Gpu,
        from: Option<&Buffer>,
        rgb: &mut Planes<3>,
        mut fourth: Option<&mut Planes<1>>,
    ) -> Result<(), GpuError> {
        let [width, height] = self.size.map(|side| side as usize);
        let count = width * height;
        rgb.resize(width, height);
        if let Some(fourth) = &mut fourth {
            fourth.resize(width, height);
        }
        read_steps(gpu, from, |first, pixels| {
            for (i, [r, g, b, a]) in (first..).zip(pixels) {
                let data = rgb.data_mut();
                (data[i], data[count + i], data[2 * count + i]) = (*r, *g, *b);
                if let Some(fourth) = &mut fourth {
                    fourth.data_mut()[i] = *a;
                }
            }
        })
    }
}

/// Calls `take` with runs of a plane's pixels, each with the place of its first.
fn read_steps(
    gpu: &Gpu,
    plane: Option<&Buffer>,
    mut take: impl FnMut(usize, &[[f32; 4]]),
) -> Result<(), GpuError> {
    let Some(plane) = plane else { return Ok(()) };
    for start in (0..plane.bytes()).step_by(STEP_BYTES as usize) {
        let pixels = gpu.read::<[f32; 4]>(&plane.part(start, STEP_BYTES))?;
        take((start / PIXEL_BYTES) as usize, &pixels);
    }
    Ok(())
}
