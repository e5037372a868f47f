//! `transforms.json` of NeRF, instant-ngp and nerfstudio: camera-to-world matrices in OpenGL axes, intrinsics for all
//! frames or per frame.

use super::{CaptureFault, Field, Photo, camera_from_opengl, path_through};
use crate::camera::Intrinsics;
use crate::camera_path::CameraPath;

/// Image side of the NeRF synthetic scenes, the only ones whose `transforms.json` states no size.
const NERF_SYNTHETIC_SIDE: u32 = 800;

/// Lens distortion coefficients that the format may carry, those of OpenCV's models; a pinhole camera has none of them,
/// or zeros.
const DISTORTION: [&str; 12] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4"];

/// What states another lens than a pinhole unless it is false or 0: flags of instant-ngp and of exporters to it, and
/// the polynomial of its f-theta lens.
const OTHER_LENSES: [&str; 11] = [
    "is_fisheye",
    "latlong",
    "equirectangular",
    "is_equirectangular",
    "ortho",
    "is_ortho",
    "ftheta_p0",
    "ftheta_p1",
    "ftheta_p2",
    "ftheta_p3",
    "ftheta_p4",
];

/// Camera models without distortion, or with one by [`DISTORTION`], all of which is zero where it gets as far.
const PINHOLES: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL"];

pub(super) fn parse(root: &Field) -> Result<CameraPath, CaptureFault> {
    let mut photos = Vec::new();
    for frame in root.require("frames", "an array of frames")?.elements()? {
        let intrinsics = intrinsics(root, &frame)?;
        let matrix = frame.require("transform_matrix", "4 rows of 4 numbers")?.matrix::<3, 4>()?;
        let name = frame.get("file_path").map_or(Ok(""), |n| n.text())?.to_owned();
        photos.push(Photo { name, camera: camera_from_opengl(frame.place(), matrix, intrinsics)? });
    }
    path_through(photos)
}

/// The frame's own intrinsics where it states them, else those of the file.
fn intrinsics(root: &Field, frame: &Field) -> Result<Intrinsics, CaptureFault> {
    let stated = |key| frame.get(key).or_else(|| root.get(key));
    for key in DISTORTION {
        if let Some(field) = stated(key)
            && field.number()? != 0.0
        {
            return Err(CaptureFault::Distorted {
                field: field.place().into(),
                model: format!("a lens distortion of {}", field.describe()),
            });
        }
    }
    if let Some(field) = OTHER_LENSES.into_iter().filter_map(stated).find(|field| !field.is_off()) {
        let model = format!("another lens ({})", field.describe());
        return Err(CaptureFault::Distorted { field: field.place().into(), model });
    }
    if let Some(field) = stated("camera_model")
        && !PINHOLES.contains(&field.text()?)
    {
        return Err(CaptureFault::Distorted { field: field.place().into(), model: field.describe() });
    }
    // A focal length in pixels says nothing about an image of unknown size.
    let in_pixels = ["w", "h", "fl_x", "fl_y", "cx", "cy"].into_iter().any(|key| stated(key).is_some());
    let is_synthetic = !in_pixels && stated("camera_angle_y").is_none();
    let side = |key| match stated(key) {
        Some(field) => field.pixels(),
        None if is_synthetic => Ok(NERF_SYNTHETIC_SIDE),
        None => Err(CaptureFault::field(key, "the image size in pixels", "nothing")),
    };
    let (width, height) = (side("w")?, side("h")?);
    let number = |key| stated(key).map(|f| f.number()).transpose();
    let focal_from_angle = |key, pixels: u32| -> Result<Option<f64>, CaptureFault> {
        let Some(field) = stated(key) else { return Ok(None) };
        let angle = field.number()?;
        if angle > 0.0 && angle < std::f64::consts::PI {
            Ok(Some(0.5 * f64::from(pixels) / (0.5 * angle).tan()))
        } else {
            Err(field.wrong("radians between 0 and π"))
        }
    };
    let fx = number("fl_x")?.map_or_else(|| focal_from_angle("camera_angle_x", width), |v| Ok(Some(v)))?;
    let fy = number("fl_y")?.map_or_else(|| focal_from_angle("camera_angle_y", height), |v| Ok(Some(v)))?;
    // Square pixels where only one of the two is stated.
    let Some((fx, fy)) = fx.or(fy).zip(fy.or(fx)) else {
        return Err(CaptureFault::field(
            &format!("{}.fl_x", frame.place()),
            "fl_x or camera_angle_x",
            "neither",
        ));
    };
    Ok(Intrinsics {
        width,
        height,
        fx,
        fy,
        cx: number("cx")?.unwrap_or(0.5 * f64::from(width)),
        cy: number("cy")?.unwrap_or(0.5 * f64::from(height)),
    })
}
