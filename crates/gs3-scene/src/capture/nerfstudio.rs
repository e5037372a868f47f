//! nerfstudio's `camera_path.json`: rendered paths, OpenGL axes, vertical field of view in degrees; and its
//! `dataparser_transforms.json`, which says where a trained splat is.

#[cfg(feature = "fs")]
use glam::{DMat3, DVec3};

use super::context::Context;
use super::{CaptureFault, Captured, Field, camera_from_opengl};
use crate::camera::Intrinsics;
use crate::camera_path::{CameraPath, PathFacts};
#[cfg(feature = "fs")]
use crate::transform::Similarity;

/// What is read of the file and of its frames, and what says nothing about the frames.
const KNOWN: [&str; 20] = [
    "camera_type",
    "render_height",
    "render_width",
    "camera_path",
    "fps",
    "seconds",
    "is_cycle",
    "smoothness_value",
    "keyframes",
    "camera_to_world",
    "fov",
    "aspect",
    "crop",
    "default_fov",
    "default_transition_sec",
    "render_time",
    "smoothness_type",
    "camera_index",
    "name",
    "properties",
];

pub(super) fn parse(root: &Field, context: &Context<'_>) -> Result<Captured, CaptureFault> {
    let is_panorama = match root.get("camera_type") {
        None => false,
        Some(kind) => match kind.text().unwrap_or_default() {
            "perspective" => false,
            "equirectangular" => true,
            _ => return Err(kind.wrong("\"perspective\" or \"equirectangular\"")),
        },
    };
    let mut unknown = root.unknown(&KNOWN);
    if root.get("crop").is_some() {
        unknown.push("\"crop\"".to_owned());
    }
    let height = root.require("render_height", "the image height in pixels")?.pixels()?;
    let width = root.require("render_width", "the image width in pixels")?.pixels()?;
    let frames_per_second = root.get("fps").map_or(Ok(super::DEFAULT_FRAMES_PER_SECOND), |f| f.number())?;
    let is_cycle = root.get("is_cycle").map_or(Ok(false), |f| f.flag())?;
    let mut cameras = Vec::new();
    for frame in root.require("camera_path", "an array of frames")?.elements()? {
        let m: [f64; 16] = frame.require("camera_to_world", "16 numbers")?.numbers()?;
        let rows = [0, 4, 8].map(|r| [m[r], m[r + 1], m[r + 2], m[r + 3]]);
        let intrinsics = if is_panorama {
            // Every panorama sees everything; its cameras need a valid angle.
            Intrinsics::from_fov_y(width, height, std::f64::consts::FRAC_PI_2)
        } else {
            let fov = frame.require("fov", "the vertical field of view in degrees")?;
            let degrees = fov.number()?;
            if !(degrees > 0.0 && degrees < 180.0) {
                return Err(fov.wrong("degrees between 0 and 180"));
            }
            // A frame's `aspect` is not used: nerfstudio does not read it, and its Blender add-on writes 1 at every
            // size.
            Intrinsics::from_fov_y(width, height, degrees.to_radians())
        };
        cameras.push(camera_from_opengl(frame.place(), rows, intrinsics)?);
        unknown.extend(frame.unknown(&KNOWN));
    }
    context.note_unknown(unknown);
    let path = CameraPath::new(cameras, frames_per_second, is_cycle)?;
    Ok(Captured { path, facts: PathFacts { is_panorama, ..PathFacts::default() } })
}

/// The `dataparser_transforms.json` in `bytes`: p' = scale · (transform · p).
#[cfg(feature = "fs")]
pub(super) fn dataparser(bytes: &[u8]) -> Result<Similarity, CaptureFault> {
    let json: serde_json::Value = serde_json::from_slice(bytes)?;
    let root = Field::root(&json);
    let field = root.require("transform", "3 rows of 4 numbers")?;
    let m = field.matrix::<3, 4>()?;
    let scale = root.require("scale", "a positive number")?;
    let (value, column) = (scale.number()?, |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]));
    if value <= 0.0 {
        return Err(scale.wrong("a positive number"));
    }
    let to_from = DMat3::from_cols(column(0), column(1), column(2));
    let skew = to_from * to_from.transpose() - DMat3::IDENTITY;
    // As far as poses may be off.
    if !(skew.to_cols_array().iter().all(|v| v.abs() < 2e-3) && to_from.determinant() > 0.0) {
        return Err(field.wrong("a rotation and a translation"));
    }
    Ok(Similarity { to_from, scale: value, shift: value * column(3) })
}
