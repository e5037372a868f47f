//! Files of a camera path: nerfstudio's `camera_path.json`, and settings of the SuperSplat viewer.

use std::path::Path;

use gs3::glam::{DMat3, DVec3};
use gs3::scene::camera_path::CameraPathError;
use gs3::scene::capture::{CaptureFault, supersplat_settings};
use gs3::scene::transform::Similarity;
use gs3::scene::{Camera, CameraError, CameraPath, Size};
use serde_json::{Value, json};

/// The format of a written path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PathFormat {
    /// nerfstudio's `camera_path.json`.
    #[default]
    CameraPath,
    /// Settings of the SuperSplat viewer, version 2.
    SuperSplat,
}

impl PathFormat {
    /// The format that the name of `file` asks for: `settings.json` and `NAME.settings.json` are settings of SuperSplat, all
    /// other names a `camera_path.json`.
    #[must_use]
    pub fn of(file: &Path) -> Self {
        let name = file.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase());
        match name {
            Some(name) if name == "settings.json" || name.ends_with(".settings.json") => Self::SuperSplat,
            _ => Self::CameraPath,
        }
    }

    /// What follows the stem in the name of such a file.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::CameraPath => "json",
            Self::SuperSplat => "settings.json",
        }
    }
}

/// A path as the bytes of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PathFile {
    /// The file.
    pub bytes: Vec<u8>,
    /// What the format has no place for and could change the picture: sentences of one line.
    pub notes: Vec<String>,
}

/// Why a path cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum PathFileError {
    /// There is no camera, or a rate that is none.
    #[error("keyframes: {0}")]
    Path(#[from] CameraPathError),
    /// A camera at the given size or place is none.
    #[error("keyframes: {0}")]
    Camera(#[from] CameraError),
    /// The format has no place for a camera.
    #[error("keyframes: {0}")]
    Format(#[from] CaptureFault),
}

impl PathFile {
    /// `path`, in the coordinates of the scene's file, as a file of `format` with pictures of `size`. A viewer that orbits
    /// does so `distance` (positive) before the first camera.
    ///
    /// # Errors
    /// [`PathFileError`] if the format has no place for one of the cameras, or the size is none.
    pub fn new(
        format: PathFormat,
        path: &CameraPath,
        size: Size,
        distance: f64,
    ) -> Result<Self, PathFileError> {
        Ok(match format {
            PathFormat::CameraPath => Self { bytes: camera_path_json(path, size), notes: Vec::new() },
            PathFormat::SuperSplat => {
                // SuperSplat's field of view is along the longer side, so this picture's size decides.
                let written = supersplat_settings(&path.resized(size.width, size.height)?, distance)?;
                Self { bytes: written.json, notes: written.notes }
            }
        })
    }
}

/// `path` in a world that has been moved by `shift`.
///
/// # Errors
/// [`CameraError`] if a pose becomes none.
pub fn moved(path: &CameraPath, shift: DVec3) -> Result<CameraPath, CameraError> {
    path.in_moved_world(&Similarity { shift, ..Similarity::orthogonal(DMat3::IDENTITY) })
}

/// `path` as nerfstudio's `camera_path.json`, with pictures of `size`. What the format has no place for, principal points
/// beside the centre and pixels that are no squares, is left out.
#[must_use]
pub fn camera_path_json(path: &CameraPath, size: Size) -> Vec<u8> {
    let frames: Vec<Value> = path.cameras().iter().map(frame).collect();
    let fps = path.frames_per_second();
    let json = json!({
        "camera_type": "perspective",
        "render_width": size.width,
        "render_height": size.height,
        "fps": fps,
        "seconds": frames.len() as f64 / fps,
        "is_cycle": path.is_cycle(),
        "camera_path": frames,
    });
    let mut bytes = format!("{json:#}").into_bytes();
    bytes.push(b'\n');
    bytes
}

/// One camera in OpenGL's axes: x right, y up, z backward.
fn frame(camera: &Camera) -> Value {
    let world_from_view = camera.world_from_view();
    let turned = world_from_view.matrix3 * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let [x, y, z] = [turned.x_axis, turned.y_axis, turned.z_axis];
    let t = world_from_view.translation;
    let rows = [0, 1, 2].map(|r| [x[r], y[r], z[r], t[r]]);
    let matrix: Vec<f64> = rows.into_iter().flatten().chain([0.0, 0.0, 0.0, 1.0]).collect();
    let i = camera.intrinsics();
    let fov = 2.0 * (0.5 * f64::from(i.height) / i.fy).atan();
    json!({
        "camera_to_world": matrix,
        "fov": fov.to_degrees(),
        "aspect": f64::from(i.width) / f64::from(i.height),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_choose_the_format() {
        for (name, format) in [
            ("settings.json", PathFormat::SuperSplat),
            ("a/garden.Settings.JSON", PathFormat::SuperSplat),
            ("camera_path.json", PathFormat::CameraPath),
            ("mysettings.json", PathFormat::CameraPath),
            ("settings.json/tour.json", PathFormat::CameraPath),
        ] {
            assert_eq!(PathFormat::of(Path::new(name)), format, "{name}");
            assert_eq!(PathFormat::of(Path::new(&format!("a.{}", format.extension()))), format);
        }
    }
}
