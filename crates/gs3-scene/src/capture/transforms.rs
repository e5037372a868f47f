//! `transforms.json` of NeRF, instant-ngp and nerfstudio: camera-to-world matrices in OpenGL axes, intrinsics for all
//! frames or per frame.

use super::context::Context;
use super::order::in_order;
use super::{CaptureFault, Captured, Field, Photo, camera_from_opengl, path_through};
use crate::camera::Intrinsics;
use crate::lens::Lens;

/// Image side of the NeRF synthetic scenes, the most common scenes without a size in `transforms.json`.
const NERF_SYNTHETIC_SIDE: u32 = 800;

/// What states another lens than a pinhole unless it is false or 0: flags of instant-ngp and of exporters to it, and
/// the polynomial of its f-theta lens.
const OTHER_LENSES: [&str; 10] = [
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

/// Camera models with OpenCV's coefficients of distortion, or none.
const RADIAL: [&str; 6] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV"];

/// Camera models by the angle to the axis.
const FISHEYE: [&str; 3] = ["OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"];

/// What is read of the file and of its frames besides [`OTHER_LENSES`], and what says nothing about the picture.
const KNOWN: [&str; 47] = [
    "frames",
    "w",
    "h",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "camera_angle_x",
    "camera_angle_y",
    "camera_model",
    "is_fisheye",
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "s1",
    "s2",
    "s3",
    "s4",
    "file_path",
    "transform_matrix",
    "aabb_scale",
    "scale",
    "offset",
    "sharpness",
    "colmap_im_id",
    "ply_file_path",
    "applied_transform",
    "applied_scale",
    "depth_file_path",
    "depth_path",
    "mask_path",
    "semantics_path",
    "normal_path",
    "orientation_override",
    "train_filenames",
    "val_filenames",
    "test_filenames",
    "rotation",
    "time",
    "timestamp",
    "white_transparent",
    "integer_depth_scale",
];

pub(super) fn parse(root: &Field, context: &Context<'_>) -> Result<Captured, CaptureFault> {
    let mut photos = Vec::new();
    let known = [KNOWN.as_slice(), &OTHER_LENSES].concat();
    let mut unknown = root.unknown(&known);
    let mut is_size_assumed = false;
    for frame in root.require("frames", "an array of frames")?.elements()? {
        let name = frame.get("file_path").map_or(Ok(""), |n| n.text())?.to_owned();
        let Calibration { intrinsics, lens, is_assumed } = calibration(root, &frame, &name, context)?;
        is_size_assumed |= is_assumed;
        let matrix = frame.require("transform_matrix", "4 rows of 4 numbers")?.matrix::<3, 4>()?;
        let camera = camera_from_opengl(frame.place(), matrix, intrinsics)?;
        photos.push(Photo { name, camera, lens });
        unknown.extend(frame.unknown(&known));
    }
    context.note_unknown(unknown);
    if is_size_assumed {
        context.note(format!(
            "neither the file nor pictures beside it state the size of the images: taken for \
             {NERF_SYNTHETIC_SIDE}x{NERF_SYNTHETIC_SIDE}, as in the synthetic scenes of NeRF"
        ));
    }
    // Files list frames in any order; names follow the walk of the capture.
    if photos.iter().all(|photo| !photo.name.is_empty()) {
        photos.sort_by(|a, b| in_order(&a.name, &b.name));
    }
    let mut captured = path_through(photos)?;
    captured.facts.keeps_width = is_size_assumed;
    Ok(captured)
}

/// What a frame's camera is like.
pub(super) struct Calibration {
    pub(super) intrinsics: Intrinsics,
    pub(super) lens: Option<Lens>,
    /// Whether the size is stated nowhere.
    is_assumed: bool,
}

/// The frame's own calibration where it states one, else the file's.
pub(super) fn calibration(
    root: &Field,
    frame: &Field,
    name: &str,
    context: &Context<'_>,
) -> Result<Calibration, CaptureFault> {
    let stated = |key| frame.get(key).or_else(|| root.get(key));
    let lens = lens(&stated)?;
    let in_pixels = ["w", "h", "fl_x", "fl_y", "cx", "cy"].into_iter().any(|key| stated(key).is_some());
    let has_size = stated("w").is_some() && stated("h").is_some();
    let picture = if has_size { None } else { context.picture_size(name) };
    // A focal length in pixels says nothing about an image of unknown size.
    let is_assumed = picture.is_none() && !in_pixels && stated("camera_angle_y").is_none();
    let side = |key, of_picture: Option<u32>| match (stated(key), of_picture) {
        (Some(field), _) => field.pixels(),
        (None, Some(side)) => Ok(side),
        (None, None) if is_assumed => Ok(NERF_SYNTHETIC_SIDE),
        (None, None) => {
            Err(CaptureFault::field(key, "the image size in pixels, or the picture itself", "nothing"))
        }
    };
    let (width, height) = (side("w", picture.map(|p| p.width))?, side("h", picture.map(|p| p.height))?);
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
    let cx = number("cx")?.unwrap_or(0.5 * f64::from(width));
    let cy = number("cy")?.unwrap_or(0.5 * f64::from(height));
    Ok(Calibration { intrinsics: Intrinsics { width, height, fx, fy, cx, cy }, lens, is_assumed })
}

/// The lens that the fields found by `stated` describe; none of a pinhole.
fn lens<'a>(stated: &impl Fn(&'static str) -> Option<Field<'a>>) -> Result<Option<Lens>, CaptureFault> {
    if let Some(field) = OTHER_LENSES.into_iter().filter_map(stated).find(|field| !field.is_off()) {
        let model = format!("another lens ({})", field.describe());
        return Err(CaptureFault::Lens { field: field.place().into(), model });
    }
    let numbers = |keys: &[&'static str]| {
        keys.iter()
            .map(|key| stated(key).map_or(Ok(0.0), |field| field.number()))
            .collect::<Result<Vec<_>, _>>()
    };
    let fisheye_flag = match stated("is_fisheye") {
        Some(field) => field.truth()?,
        None => false,
    };
    let model = stated("camera_model");
    let name = model.as_ref().map(|field| field.text()).transpose()?.unwrap_or("OPENCV");
    let of = |keys: [&'static str; 6]| -> Result<[f64; 6], CaptureFault> {
        Ok(numbers(&keys)?.try_into().unwrap_or_default())
    };
    let radial = of(["k1", "k2", "k3", "k4", "k5", "k6"])?;
    let tangential = numbers(&["p1", "p2"])?.try_into().unwrap_or_default();
    let prism = numbers(&["s1", "s2", "s3", "s4"])?.try_into().unwrap_or_default();
    if fisheye_flag || FISHEYE.contains(&name) {
        return Ok(Some(Lens::Fisheye { radial, tangential, prism }));
    }
    match model {
        Some(field) if !RADIAL.contains(&name) => {
            Err(CaptureFault::Lens { field: field.place().into(), model: field.describe() })
        }
        _ => Ok(Some(Lens::Radial { radial, tangential, prism }).filter(|lens| !lens.is_pinhole())),
    }
}

impl Calibration {
    /// The calibration of a pinhole.
    pub(super) const fn pinhole(intrinsics: Intrinsics) -> Self {
        Self { intrinsics, lens: None, is_assumed: false }
    }
}
