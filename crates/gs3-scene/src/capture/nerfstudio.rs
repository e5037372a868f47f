//! nerfstudio's `camera_path.json`: rendered paths, OpenGL axes, vertical field of view in degrees.

use super::{CaptureFault, Field, camera_from_opengl};
use crate::camera::Intrinsics;
use crate::camera_path::CameraPath;

pub(super) fn parse(root: &Field) -> Result<CameraPath, CaptureFault> {
    if let Some(kind) = root.get("camera_type").filter(|k| k.text().is_ok_and(|t| t != "perspective")) {
        return Err(kind.wrong("\"perspective\""));
    }
    let height = root.require("render_height", "the image height in pixels")?.pixels()?;
    let width = root.require("render_width", "the image width in pixels")?.pixels()?;
    let frames_per_second = root.get("fps").map_or(Ok(super::DEFAULT_FRAMES_PER_SECOND), |f| f.number())?;
    let is_cycle = root.get("is_cycle").map_or(Ok(false), |f| f.flag())?;
    let mut cameras = Vec::new();
    for frame in root.require("camera_path", "an array of frames")?.elements()? {
        let m: [f64; 16] = frame.require("camera_to_world", "16 numbers")?.numbers()?;
        let rows = [0, 4, 8].map(|r| [m[r], m[r + 1], m[r + 2], m[r + 3]]);
        let fov = frame.require("fov", "the vertical field of view in degrees")?;
        let degrees = fov.number()?;
        if !(degrees > 0.0 && degrees < 180.0) {
            return Err(fov.wrong("degrees between 0 and 180"));
        }
        // A frame's `aspect` says nothing: nerfstudio does not read it, and its Blender add-on writes 1 whatever the
        // size.
        let intrinsics = Intrinsics::from_fov_y(width, height, degrees.to_radians());
        cameras.push(camera_from_opengl(frame.place(), rows, intrinsics)?);
    }
    Ok(CameraPath::new(cameras, frames_per_second, is_cycle)?)
}
