//! Arrays of cameras: Inria's `cameras.json`, written beside a trained scene (camera-to-world rotation rows and
//! position, gs3's axes), and what `ns-export cameras` writes (camera-to-world matrices in OpenGL axes, no intrinsics).

use glam::{DMat3, DVec3};

use super::context::Context;
use super::order::in_order;
use super::transforms::{Calibration, calibration};
use super::{CaptureFault, Captured, Field, Photo, camera_from_opengl, camera_from_world_pose, path_through};
use crate::camera::Intrinsics;

/// What is read of a camera of Inria's, and what says nothing about the picture.
const KNOWN: [&str; 11] =
    ["id", "img_name", "width", "height", "position", "rotation", "fx", "fy", "cx", "cy", "uid"];

pub(super) fn parse(root: &Field, context: &Context<'_>) -> Result<Captured, CaptureFault> {
    let mut unknown = Vec::new();
    let mut photos = Vec::new();
    for camera in root.elements()? {
        if camera.get("transform").is_some() && camera.get("position").is_none() {
            return parse_exported(root, context);
        }
        let size = |key| camera.require(key, "the image size in pixels")?.pixels();
        let (width, height) = (size("width")?, size("height")?);
        let center =
            |key, side: u32| camera.get(key).map_or(Ok(0.5 * f64::from(side)), |value| value.number());
        let intrinsics = Intrinsics {
            width,
            height,
            fx: camera.number_of("fx")?,
            fy: camera.number_of("fy")?,
            cx: center("cx", width)?,
            cy: center("cy", height)?,
        };
        let rows = camera.require("rotation", "3 rows of 3 numbers")?.matrix::<3, 3>()?;
        let rotation = DMat3::from_cols_array_2d(&rows).transpose();
        let position = DVec3::from(camera.require("position", "3 numbers")?.numbers::<3>()?);
        photos.push(Photo {
            name: camera.get("img_name").map_or(Ok(""), |n| n.text())?.to_owned(),
            camera: camera_from_world_pose(camera.place(), rotation, position, intrinsics)?,
            lens: None,
        });
        unknown.extend(camera.unknown(&KNOWN));
    }
    context.note_unknown(unknown);
    // The file lists test views first; names follow the walk of the capture.
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    path_through(photos)
}

/// Poses in the frame of a trained splat; intrinsics from the `transforms.json` beside the file, or from the caller.
fn parse_exported(root: &Field, context: &Context<'_>) -> Result<Captured, CaptureFault> {
    let beside: Option<serde_json::Value> =
        context.sibling("transforms.json").and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let mut photos = Vec::new();
    for camera in root.elements()? {
        let name = camera.get("file_path").map_or(Ok(""), |n| n.text())?.to_owned();
        let matrix = camera.require("transform", "3 rows of 4 numbers")?.matrix::<3, 4>()?;
        let Calibration { intrinsics, lens, .. } = match (&beside, context.options.calibration()) {
            (_, Some(intrinsics)) => Calibration::pinhole(intrinsics),
            (Some(json), None) => {
                let file = Field::root(json);
                let frames = file.get("frames");
                let frames = frames.as_ref().map(|frames| frames.elements()).transpose()?;
                let same =
                    |frame: &Field| frame.get("file_path").is_some_and(|n| n.text().is_ok_and(|n| n == name));
                let frame = frames.into_iter().flatten().find(same);
                calibration(&file, frame.as_ref().unwrap_or(&file), &name, context)?
            }
            (None, None) => {
                let expected = "intrinsics, which `ns-export cameras` does not write: the capture's transforms.json \
                                beside the file, or a size and a field of view (--size and --fov)";
                return Err(CaptureFault::field(camera.place(), expected, "poses alone"));
            }
        };
        photos.push(Photo { camera: camera_from_opengl(camera.place(), matrix, intrinsics)?, name, lens });
    }
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    path_through(photos)
}
