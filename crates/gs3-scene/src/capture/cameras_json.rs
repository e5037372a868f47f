//! Inria's `cameras.json`, written beside a trained scene: camera-to-world rotation rows and position, gs3's axes.

use glam::{DMat3, DVec3};

use super::order::in_order;
use super::{CaptureFault, Field, Photo, camera_from_world_pose, path_through};
use crate::camera::Intrinsics;
use crate::camera_path::CameraPath;

pub(super) fn parse(root: &Field) -> Result<CameraPath, CaptureFault> {
    let mut photos = Vec::new();
    for camera in root.elements()? {
        let size = |key| camera.require(key, "the image size in pixels")?.pixels();
        let (width, height) = (size("width")?, size("height")?);
        let intrinsics = Intrinsics {
            width,
            height,
            fx: camera.number_of("fx")?,
            fy: camera.number_of("fy")?,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
        };
        let rows = camera.require("rotation", "3 rows of 3 numbers")?.matrix::<3, 3>()?;
        let rotation = DMat3::from_cols_array_2d(&rows).transpose();
        let center = DVec3::from(camera.require("position", "3 numbers")?.numbers::<3>()?);
        photos.push(Photo {
            name: camera.get("img_name").map_or(Ok(""), |n| n.text())?.to_owned(),
            camera: camera_from_world_pose(camera.place(), rotation, center, intrinsics)?,
        });
    }
    // The file lists test views first; names follow the walk of the capture.
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    path_through(photos)
}
