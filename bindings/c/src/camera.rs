//! Cameras.
#![allow(unsafe_code, reason = "exported functions")]

use gs3::glam::{DAffine3, DMat3, DVec3};
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::{Camera, CameraError, Intrinsics, orbit};

use crate::choice::choice;
use crate::descriptor::{self, Answer, Descriptor};
use crate::status::{Fault, gs3_status, guard};

/// Which way the axes of view space point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_view_axes {
    /// x right, y down, z forward: COLMAP, OpenCV.
    GS3_VIEW_AXES_RIGHT_DOWN_FRONT = 0,
    /// x right, y up, z backward: OpenGL and most engines.
    GS3_VIEW_AXES_RIGHT_UP_BACK = 1,
}

/// A pinhole camera. Pixel (i, j) covers columns i to i + 1 and rows j to j + 1, its centre is at (i + 0.5, j + 0.5), and (0, 0)
/// is the upper left corner. All fields are needed.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_camera {
    /// sizeof(gs3_camera).
    pub struct_size: u32,
    /// A gs3_view_axes.
    pub axes: u32,
    /// Width of the image that is shown, pixels, 1 to 8192.
    pub width: u32,
    /// Height of the image that is shown, pixels, 1 to 8192.
    pub height: u32,
    /// The rigid transform from world to view space: three rows of four, the fourth column the translation, world units. Its
    /// rotation is orthonormal within 2e-3.
    pub view_from_world: [f64; 12],
    /// Horizontal focal length, pixels, positive.
    pub fx: f64,
    /// Vertical focal length, pixels, positive.
    pub fy: f64,
    /// Principal point x, pixels: half the width where it is the centre.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_camera {
    const BYTES: usize = 4 * 4 + 16 * 8;
    const LEAST: usize = 144;
}

impl gs3_camera {
    /// The camera that the descriptor at `from`, which the caller calls `field`, tells of.
    ///
    /// # Safety
    /// As [`descriptor::read`].
    pub unsafe fn read(field: &str, from: *const Self) -> Result<Camera, Fault> {
        // SAFETY: the contract of this function.
        let camera = unsafe { descriptor::read(field, from) }?;
        camera.check().map_err(|fault| fault.within(field))
    }

    /// The cameras at the `count` pointers at `from`, which the caller calls `field`; none where `from` is null.
    ///
    /// # Safety
    /// `from` is null or points to that many pointers, all as [`Self::read`] demands.
    pub unsafe fn read_all(field: &str, from: *const *const Self, count: u32) -> Result<Vec<Camera>, Fault> {
        if from.is_null() {
            return Ok(Vec::new());
        }
        let camera = |index: usize| {
            // SAFETY: the contract of this function; pointers are read wherever they lie.
            unsafe { Self::read(&format!("{field}[{index}]"), from.add(index).read_unaligned()) }
        };
        (0..count as usize).map(camera).collect()
    }

    fn check(&self) -> Result<Camera, Fault> {
        let Self { width, height, fx, fy, cx, cy, .. } = *self;
        type Make = fn(DAffine3, Intrinsics) -> Result<Camera, CameraError>;
        let axes: [(u32, Make); 2] = [
            (gs3_view_axes::GS3_VIEW_AXES_RIGHT_DOWN_FRONT as u32, Camera::new),
            (gs3_view_axes::GS3_VIEW_AXES_RIGHT_UP_BACK as u32, Camera::from_opengl),
        ];
        let make = choice("axes", "gs3_view_axes", self.axes, &axes)?;
        if width > MAX_SIDE || height > MAX_SIDE {
            let expected = format_args!("1x1 to {MAX_SIDE}x{MAX_SIDE}").to_string();
            return Err(Fault::argument("image size", expected, format_args!("{width}x{height}")));
        }
        let m = &self.view_from_world;
        let column = |k: usize| DVec3::new(m[k], m[4 + k], m[8 + k]);
        let view_from_world =
            DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
        Ok(make(view_from_world, Intrinsics { width, height, fx, fy, cx, cy })?)
    }

    pub fn of(camera: &Camera) -> Self {
        let Intrinsics { width, height, fx, fy, cx, cy } = camera.intrinsics();
        let DAffine3 { matrix3, translation } = camera.view_from_world();
        let row = |k: usize| [matrix3.x_axis[k], matrix3.y_axis[k], matrix3.z_axis[k], translation[k]];
        let mut view_from_world = [0.0; 12];
        for (k, to) in view_from_world.chunks_exact_mut(4).enumerate() {
            to.copy_from_slice(&row(k));
        }
        Self { struct_size: 0, axes: 0, width, height, view_from_world, fx, fy, cx, cy }
    }
}

/// The camera at eye that looks at target, world units, where up points up in its image as far as possible. fov_y is the
/// vertical field of view in radians, between 0 and pi. Pixels are square, and the principal point is the centre.
///
/// # Safety
/// eye, target and up point to three doubles each, and camera to a gs3_camera with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_camera_look_at(
    eye: *const f64,
    target: *const f64,
    up: *const f64,
    fov_y: f64,
    width: u32,
    height: u32,
    camera: *mut gs3_camera,
) -> gs3_status {
    guard("gs3_camera_look_at", || {
        // SAFETY: the contract of this function.
        let answer = unsafe { Answer::at("camera", camera) }?;
        let point = |field: &str, from: *const f64| {
            if from.is_null() {
                return Err(Fault::null(field));
            }
            // SAFETY: the contract of this function; numbers are read wherever they lie.
            Ok(DVec3::from_array(unsafe { from.cast::<[f64; 3]>().read_unaligned() }))
        };
        let (eye, target, up) = (point("eye", eye)?, point("target", target)?, point("up", up)?);
        if !(fov_y > 0.0 && fov_y < std::f64::consts::PI) {
            return Err(Fault::argument("fov_y", "radians between 0 and pi", fov_y));
        }
        let intrinsics = Intrinsics::from_fov_y(width, height, fov_y);
        answer.write(&gs3_camera::of(&orbit::look_at(eye, target, up, intrinsics)?));
        Ok(())
    })
}
