//! The camera as the kernels read it: single precision, relative to the camera centre, with sample positions at
//! integers.

use glam::DVec3;
pub use gs3_scene::camera::NEAR;
use gs3_scene::{Camera, Margin, Size};

use crate::settings::{KERBL_DILATION, RasterSettings, Window, matched_dilation};

/// Limit of the Jacobian: the projection of positions is exact, but its Jacobian is evaluated with x/z and y/z at
/// most this far outside the image, as a share of half the image's extent. In total this is 1.3 times the tangent of
/// half the field of view (Kerbl et al. 2023). The limit is measured from the image's own edges (as gsplat does), so
/// a window of a view has the splats of the view.
const JACOBIAN_MARGIN: f64 = 0.3;

/// Constants of one frame.
pub struct View {
    /// World to view rotation, rows.
    pub rotation: [[f32; 3]; 3],
    /// Camera centre in world space, rounded to f32.
    pub origin: [f32; 3],
    /// The rounding error of `origin`, so that distant scenes keep sub-pixel precision.
    pub origin_rest: [f32; 3],
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in the frame where the sample of pixel `(i, j)` lies at exactly `(i, j)`: half a pixel and the
    /// jitter are subtracted, and the margin is added.
    pub center: [f32; 2],
    /// Least and largest x/z and y/z for the Jacobian.
    pub jacobian_limits: [[f32; 2]; 2],
    /// Pixels, the margin included.
    pub size: Size,
    /// Number of pixels left of and above the pixel at position `(0, 0)`; negative in a window that begins right of and
    /// below that pixel.
    pub before: [f32; 2],
    /// Smallest factor on opacity in antialiased scenes.
    pub min_compensation: f32,
    /// ε in px².
    pub dilation: f32,
    /// Gaussians up to this z are culled.
    pub near: f32,
    /// Gaussians from this z on are culled.
    pub far: f32,
}

impl View {
    /// `near` is the scene's near plane; it is used unless the settings have another.
    pub fn new(camera: &Camera, settings: &RasterSettings, near: f32) -> Self {
        let i = camera.intrinsics();
        let rotation = camera.view_from_world().matrix3.transpose().to_cols_array_2d();
        let position = camera.position();
        let origin = position.as_vec3();
        let rest = (position - DVec3::from(origin)).as_vec3();
        let margin = settings.margin;
        let shift = |before: u32, jitter: f32| f64::from(before) - 0.5 - f64::from(jitter);
        let limits = |side: u32, center: f64, focal: f64| {
            let margin = 0.5 * JACOBIAN_MARGIN * f64::from(side);
            [(-center - margin) / focal, (f64::from(side) - center + margin) / focal].map(|v| v as f32)
        };
        Self {
            rotation: rotation.map(|row| row.map(|v| v as f32)),
            origin: origin.to_array(),
            origin_rest: rest.to_array(),
            focal: [i.fx as f32, i.fy as f32],
            center: [
                (i.cx + shift(margin.left, settings.jitter[0])) as f32,
                (i.cy + shift(margin.top, settings.jitter[1])) as f32,
            ],
            // The limits of the picture: a margin changes nothing in the picture.
            jacobian_limits: [limits(i.width, i.cx, i.fx), limits(i.height, i.cy, i.fy)],
            size: margin.padded(i.size()),
            before: [0.0; 2],
            dilation: settings.dilation,
            min_compensation: settings.rules.min_compensation,
            near: settings.rules.near.unwrap_or(near),
            far: settings.rules.far,
        }
    }

    /// The view of the native image of `camera`, widened to the margin of a low-resolution frame, `scale` times coarser, with
    /// that frame's `settings`. Positions have the same bits as in the native image: the margin is at negative positions. The
    /// view has all splats of the frame's samples only where [`samples_pixels`].
    pub fn of_low_resolution(camera: &Camera, scale: u32, settings: &RasterSettings, near: f32) -> Self {
        let native = RasterSettings { jitter: [0.0; 2], margin: Margin::NONE, ..*settings };
        let lr = camera.low_resolution(scale);
        let lr_size = settings.margin.padded(lr.size());
        let before = [settings.margin.left, settings.margin.top].map(|side| (side * scale) as f32);
        // With scales that are not powers of two, rounding must not change the native image's dilation.
        let is_matched = settings.dilation == matched_dilation(scale);
        let dilation = if is_matched { KERBL_DILATION } else { settings.dilation * (scale * scale) as f32 };
        Self { size: lr_size.map(|side| side * scale), before, dilation, ..Self::new(camera, &native, near) }
    }

    /// The view of `window` of the image of `camera`. Positions have the same bits as in the whole image.
    pub fn of_window(camera: &Camera, window: Window, settings: &RasterSettings, near: f32) -> Self {
        let settings = RasterSettings { margin: Margin::NONE, ..*settings };
        let before = [window.left, window.top].map(|side| -(side as f32));
        Self { size: window.size(), before, ..Self::new(camera, &settings, near) }
    }

    /// As [`Self::of_window`], with positions counted from the window's first pixel: for kernels that count from there.
    /// They differ from those in the whole image by rounding alone.
    #[cfg(feature = "gpu")]
    pub fn from_window(camera: &Camera, window: Window, settings: &RasterSettings, near: f32) -> Self {
        let i = camera.intrinsics();
        let center = [
            i.cx - 0.5 - f64::from(settings.jitter[0]) - f64::from(window.left),
            i.cy - 0.5 - f64::from(settings.jitter[1]) - f64::from(window.top),
        ];
        let view = Self::of_window(camera, window, settings, near);
        Self { center: center.map(|v| v as f32), before: [0.0; 2], ..view }
    }

    /// View-space coordinates of the world-space offset `d` from the camera centre.
    pub fn rotate(&self, d: [f32; 3]) -> [f32; 3] {
        self.rotation.map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2])
    }
}

/// The position of sample `(0, 0)` of a low-resolution frame in pixels of the native image. Sample `(i, j)` lies at
/// scale·(i + ½ + jitter) there, where pixel centres lie at halves.
pub fn first_sample(scale: u32, jitter: [f32; 2]) -> [f64; 2] {
    jitter.map(|jitter| {
        let at = f64::from(scale) * (0.5 + f64::from(jitter)) - 0.5;
        // Jitter on the exact grid is a sum of rounded fractions: its samples must lie on pixels.
        if (at - at.round()).abs() < ON_PIXEL { at.round() } else { at }
    })
}

/// Whether the samples of a low-resolution frame lie on pixel centres of the native image. Samples in the frame's margin lie on the
/// same lattice, beyond the image.
pub fn samples_pixels(scale: u32, jitter: [f32; 2]) -> bool {
    let last = f64::from(scale - 1);
    first_sample(scale, jitter).iter().all(|at| at.fract() == 0.0 && (0.0..=last).contains(at))
}

/// A sample lies on a pixel centre if it is nearer than this, in pixels: single-precision offsets are inexact by 2⁻²⁵
/// LR pixels, times a scale of at most 8.
const ON_PIXEL: f64 = 1e-5;
