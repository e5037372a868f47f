//! Pinhole cameras.
//!
//! Axes as in COLMAP: in view space x points right, y down, z forward. Pixel `(i, j)` covers `[i, i+1) × [j, j+1)`;
//! its centre is at `(i + 0.5, j + 0.5)`.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use crate::size::Size;
use crate::transform::Similarity;

/// Largest side of a rendered image: 7680×4320 fits, and so do portrait and square formats.
pub const MAX_SIDE: u32 = 8192;

/// Largest side of the image of a camera: photos may be larger than what is rendered.
pub const MAX_CAMERA_SIDE: u32 = 65_535;

/// Gaussians nearer than this view-space z, world units, are culled (Kerbl et al. 2023): rasterizers show nothing of
/// them.
pub const NEAR: f32 = 0.2;

/// How far the products of a rotation's rows may be from 0 and 1. Entries rounded to three decimals are off by up to
/// 0.0005 each, and the products of rows of length 1 by up to 2·√3·0.0005 = 0.0017.
const MAX_SKEW: f64 = 2e-3;

/// Size, focal lengths and principal point of a pinhole camera, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Image width, 1 to [`MAX_CAMERA_SIDE`]; up to [`MAX_SIDE`] it can be rendered.
    pub width: u32,
    /// Image height, 1 to [`MAX_CAMERA_SIDE`]; up to [`MAX_SIDE`] it can be rendered.
    pub height: u32,
    /// Horizontal focal length in pixels, positive.
    pub fx: f64,
    /// Vertical focal length in pixels, positive.
    pub fy: f64,
    /// Principal point x in pixels.
    pub cx: f64,
    /// Principal point y in pixels.
    pub cy: f64,
}

/// Why values do not make a camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// The image size is zero or too large.
    #[error("image size: expected 1x1 to {MAX_CAMERA_SIDE}x{MAX_CAMERA_SIDE}, found {width}x{height}")]
    Size {
        /// Width found.
        width: u32,
        /// Height found.
        height: u32,
    },
    /// A focal length or principal point is not usable.
    #[error("{field}: expected {expected}, found {actual}")]
    Intrinsic {
        /// Name of the field.
        field: &'static str,
        /// What is accepted.
        expected: &'static str,
        /// The value found.
        actual: f64,
    },
    /// The pose is not a rigid transform.
    #[error(
        "camera pose: expected a finite rotation (orthonormal within 2e-3, determinant +1), found {actual}"
    )]
    Pose {
        /// The rotation block found.
        actual: DMat3,
    },
    /// The pose's translation is not finite.
    #[error("camera position: expected finite values, found {actual}")]
    Position {
        /// The translation found.
        actual: DVec3,
    },
}

impl Intrinsics {
    /// The image's size.
    #[must_use]
    pub const fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// Square pixels, centred principal point, vertical field of view `fov_y` in radians.
    #[must_use]
    pub fn from_fov_y(width: u32, height: u32, fov_y: f64) -> Self {
        let (w, h) = (f64::from(width), f64::from(height));
        let focal = 0.5 * h / (0.5 * fov_y).tan();
        Self { width, height, fx: focal, fy: focal, cx: 0.5 * w, cy: 0.5 * h }
    }
}

/// A checked pinhole camera: a rigid pose and valid intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    view_from_world: DAffine3,
    intrinsics: Intrinsics,
}

impl Camera {
    /// Checks the pose and the intrinsics. A rotation that is orthonormal within 2e-3 is re-orthonormalised: entries
    /// rounded to three decimals are off by 2·√3·0.0005 at most.
    ///
    /// Axes are COLMAP's: x right, y down, z forward. A view matrix of OpenGL (y up, z backward) passes the checks too,
    /// but looks the other way: [`Self::from_opengl`] takes those. [`crate::orbit::look_at`] makes a camera from where
    /// it is and looks.
    ///
    /// # Errors
    /// [`CameraError`] if the size, an intrinsic or the pose is not usable.
    pub fn new(view_from_world: DAffine3, intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
        if width == 0 || height == 0 || width > MAX_CAMERA_SIDE || height > MAX_CAMERA_SIDE {
            return Err(CameraError::Size { width, height });
        }
        for (field, actual) in [("fx", fx), ("fy", fy)] {
            if !(actual.is_finite() && actual > 0.0) {
                return Err(CameraError::Intrinsic { field, expected: "a positive finite number", actual });
            }
        }
        for (field, actual) in [("cx", cx), ("cy", cy)] {
            if !actual.is_finite() {
                return Err(CameraError::Intrinsic { field, expected: "a finite number", actual });
            }
        }
        let rotation = view_from_world.matrix3;
        let gram = rotation * rotation.transpose() - DMat3::IDENTITY;
        let is_rigid = rotation.is_finite()
            && gram.to_cols_array().iter().all(|v| v.abs() < MAX_SKEW)
            && rotation.determinant() > 0.0;
        if !is_rigid {
            return Err(CameraError::Pose { actual: rotation });
        }
        // The nearest rotation keeps projection and unprojection exact inverses of each other.
        let matrix3 = DMat3::from_quat(glam::DQuat::from_mat3(&rotation).normalize());
        let camera = Self { view_from_world: DAffine3 { matrix3, ..view_from_world }, intrinsics };
        // A sum of finite numbers may be infinite.
        if !(view_from_world.translation.is_finite() && camera.position().is_finite()) {
            return Err(CameraError::Position { actual: view_from_world.translation });
        }
        Ok(camera)
    }

    /// As [`Self::new`] for a view matrix in the axes of OpenGL, WebGPU's samples and most engines: x right, y up, z
    /// backward.
    ///
    /// # Errors
    /// [`CameraError`] if the size, an intrinsic or the pose is not usable.
    pub fn from_opengl(view_from_world: DAffine3, intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let turned = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self::new(DAffine3::from_mat3(turned) * view_from_world, intrinsics)
    }

    /// The rigid transform from world to view space.
    #[must_use]
    pub const fn view_from_world(&self) -> DAffine3 {
        self.view_from_world
    }

    /// The rigid transform from view to world space.
    #[must_use]
    pub fn world_from_view(&self) -> DAffine3 {
        self.view_from_world.inverse()
    }

    /// The camera centre in world space.
    #[must_use]
    pub fn position(&self) -> DVec3 {
        self.world_from_view().translation
    }

    /// Size, focal lengths and principal point.
    #[must_use]
    pub const fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Image width in pixels.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.intrinsics.width
    }

    /// Image height in pixels.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.intrinsics.height
    }

    /// The image's size.
    #[must_use]
    pub const fn size(&self) -> Size {
        self.intrinsics.size()
    }

    /// The same view at another size: the vertical field of view and the pixel aspect are kept, the principal point
    /// keeps its place relative to the centre.
    ///
    /// # Errors
    /// [`CameraError::Size`] if the size is zero or too large.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        self.scaled(width, height, f64::from(height) / f64::from(self.intrinsics.height))
    }

    /// The same view at another size, with the same horizontal field of view: for cameras that state only a
    /// horizontal one.
    ///
    /// # Errors
    /// [`CameraError::Size`] if the size is zero or too large.
    pub fn resized_by_width(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        self.scaled(width, height, f64::from(width) / f64::from(self.intrinsics.width))
    }

    /// The same view at another size, pixels smaller by `scale`. The principal point keeps its place relative to the centre.
    fn scaled(&self, width: u32, height: u32, scale: f64) -> Result<Self, CameraError> {
        let old = self.intrinsics;
        let intrinsics = Intrinsics {
            width,
            height,
            fx: old.fx * scale,
            fy: old.fy * scale,
            cx: (old.cx - 0.5 * f64::from(old.width)) * scale + 0.5 * f64::from(width),
            cy: (old.cy - 0.5 * f64::from(old.height)) * scale + 0.5 * f64::from(height),
        };
        Self::new(self.view_from_world, intrinsics)
    }

    /// The camera in a world that has been moved, turned and scaled: `by` leads there from this camera's, by a rotation,
    /// no reflection.
    ///
    /// # Errors
    /// [`CameraError`] if what comes of the pose is none.
    pub fn in_moved_world(&self, by: &Similarity) -> Result<Self, CameraError> {
        let center = by.scale * (by.to_from * self.position()) + by.shift;
        let rotation = self.view_from_world.matrix3 * by.to_from.transpose();
        let pose = DAffine3 { matrix3: rotation, translation: -(rotation * center) };
        Self::new(pose, self.intrinsics)
    }

    /// The low-resolution (LR) camera of this one: every LR pixel covers `scale`×`scale` pixels of this camera, LR
    /// pixel `(0, 0)` starting at pixel `(0, 0)`. Sizes that `scale` does not divide are rounded up, so the LR image
    /// covers at least this one. A `scale` of 0 counts as 1.
    #[must_use]
    pub fn low_resolution(&self, scale: u32) -> Self {
        let scale = scale.max(1);
        let s = f64::from(scale);
        let i = self.intrinsics;
        let intrinsics = Intrinsics {
            width: i.width.div_ceil(scale),
            height: i.height.div_ceil(scale),
            fx: i.fx / s,
            fy: i.fy / s,
            cx: i.cx / s,
            cy: i.cy / s,
        };
        Self { intrinsics, ..*self }
    }

    /// Projects a world point: pixel position and view-space depth z. The pixel is meaningful for z > 0 only.
    #[must_use]
    pub fn project(&self, world: DVec3) -> (DVec2, f64) {
        let view = self.view_from_world.transform_point3(world);
        let i = self.intrinsics;
        (DVec2::new(i.fx * view.x / view.z + i.cx, i.fy * view.y / view.z + i.cy), view.z)
    }

    /// The world point seen at `pixel` at view-space depth `z`.
    #[must_use]
    pub fn unproject(&self, pixel: DVec2, z: f64) -> DVec3 {
        let i = self.intrinsics;
        let view = DVec3::new((pixel.x - i.cx) / i.fx * z, (pixel.y - i.cy) / i.fy * z, z);
        self.world_from_view().transform_point3(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unprojecting_undoes_projecting() {
        let intrinsics = Intrinsics { fx: 50.0, fy: 70.0, cx: 20.0, cy: 31.0, width: 64, height: 48 };
        let turned = DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(-0.2);
        let camera =
            Camera::new(DAffine3::from_mat3_translation(turned, DVec3::new(0.3, -1.0, 4.0)), intrinsics);
        let camera = camera.expect("a camera");
        for point in [DVec3::new(0.2, -0.7, 1.5), DVec3::new(-3.0, 2.0, 6.0)] {
            let (pixel, z) = camera.project(point);
            assert!(z > 0.0 && camera.unproject(pixel, z).distance(point) < 1e-9, "{point}");
        }
    }
}
