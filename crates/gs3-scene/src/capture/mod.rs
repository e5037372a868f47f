//! Readers for the camera files of captures: COLMAP, `transforms.json`, Inria's `cameras.json` and nerfstudio's
//! `camera_path.json`.
//!
//! [`load`] tells the formats apart by content. Every reader flips the axes of its format to gs3's (x right, y down,
//! z forward).

mod cameras_json;
mod colmap;
mod error;
mod fields;
mod nerfstudio;
mod order;
mod transforms;

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use gs3_files::read_within;

pub use colmap::ColmapEncoding;
pub use error::{CaptureError, CaptureFault};

use crate::camera::{Camera, Intrinsics};
use crate::camera_path::{CameraPath, CameraPathError};
use fields::Field;

/// Frames per second given to photo collections, which name none.
pub const DEFAULT_FRAMES_PER_SECOND: f64 = 30.0;

/// Bytes of a JSON file of cameras at most: room for a hundred thousand cameras of 600 bytes, which few exceed. In
/// memory JSON takes up to eighty times its size, if all of it is objects of one short field: then these are 5 GB.
pub const MAX_JSON_BYTES: u64 = 64 << 20;

/// Bytes of each file of a COLMAP model at most: room for the 24 bytes of each of ten thousand observed points in
/// fifteen thousand photos.
pub const MAX_COLMAP_BYTES: u64 = 4 << 30;

/// Reads the cameras at `path`: a JSON file of any known kind, a COLMAP `images.bin` or `images.txt`, or a folder that
/// holds one of these (COLMAP also in `sparse/0` and `sparse`).
///
/// Cameras come in the order of the file, those of photo collections without an order of their own (COLMAP, Inria) by
/// image name, in which digits count as numbers. Files are regular ones or pipes, of [`MAX_JSON_BYTES`] or
/// [`MAX_COLMAP_BYTES`] at most.
///
/// # Errors
/// [`CaptureError`], naming file, field, expected and actual.
pub fn load(path: impl AsRef<Path>) -> Result<CameraPath, CaptureError> {
    let path = path.as_ref();
    if path.is_dir() {
        return load_folder(path);
    }
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    if let ("images.bin" | "cameras.bin" | "images.txt" | "cameras.txt", Some(folder)) = (name, path.parent())
    {
        return colmap::load(folder);
    }
    load_json(path)
}

fn load_folder(folder: &Path) -> Result<CameraPath, CaptureError> {
    for sub in ["", "sparse/0", "sparse"] {
        let candidate = if sub.is_empty() { folder.to_path_buf() } else { folder.join(sub) };
        if colmap::is_model(&candidate) {
            return colmap::load(&candidate);
        }
    }
    for name in ["transforms.json", "cameras.json", "camera_path.json"] {
        let candidate = folder.join(name);
        if candidate.is_file() {
            return load_json(&candidate);
        }
    }
    let fault = CaptureFault::Unrecognized {
        actual: if folder.is_dir() { "a folder without any of them".into() } else { "nothing".into() },
    };
    Err(fault.at(folder))
}

fn load_json(path: &Path) -> Result<CameraPath, CaptureError> {
    let bytes = read(path, MAX_JSON_BYTES)?;
    parse_json(&bytes).map_err(|fault| fault.at(path))
}

/// Reads any of the JSON formats from memory; [`load`] for a file already read.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_json(bytes: &[u8]) -> Result<CameraPath, CaptureFault> {
    // Editors on Windows write a byte order mark, which JSON has none of.
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let json: serde_json::Value = serde_json::from_slice(bytes)?;
    let root = Field::root(&json);
    if root.get("camera_path").is_some() {
        nerfstudio::parse(&root)
    } else if root.get("frames").is_some() {
        transforms::parse(&root)
    } else if json.is_array() {
        cameras_json::parse(&root)
    } else {
        Err(CaptureFault::Unrecognized { actual: root.describe() })
    }
}

/// Reads the two files of a COLMAP model from memory; [`load`] for files already read.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_colmap(
    encoding: ColmapEncoding,
    cameras: &[u8],
    images: &[u8],
) -> Result<CameraPath, CaptureFault> {
    colmap::parse(encoding, cameras, images)
}

/// All of a file that ends within `most` bytes.
fn read(path: &Path, most: u64) -> Result<Vec<u8>, CaptureError> {
    read_within(path, most).map_err(|error| CaptureFault::Read(error).at(path))
}

/// One photo of a collection.
struct Photo {
    name: String,
    camera: Camera,
}

/// A path through photos in the given order.
fn path_through(photos: Vec<Photo>) -> Result<CameraPath, CaptureFault> {
    let (names, cameras) = photos.into_iter().map(|p| (p.name, p.camera)).unzip();
    Ok(CameraPath::new(cameras, DEFAULT_FRAMES_PER_SECOND, false)?.with_names(names))
}

impl From<CameraPathError> for CaptureFault {
    fn from(error: CameraPathError) -> Self {
        match error {
            CameraPathError::Empty => {
                Self::Field { field: "cameras".into(), expected: "at least 1".into(), actual: "0".into() }
            }
            CameraPathError::FramesPerSecond { actual } => Self::Field {
                field: "fps".into(),
                expected: "a positive finite number".into(),
                actual: actual.to_string(),
            },
        }
    }
}

/// A camera from its pose in the world and the axes of OpenGL (x right, y up, z backward).
fn camera_from_opengl(field: &str, m: [[f64; 4]; 3], intrinsics: Intrinsics) -> Result<Camera, CaptureFault> {
    let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
    let rotation = DMat3::from_cols(column(0), -column(1), -column(2));
    camera_from_world_pose(field, rotation, column(3), intrinsics)
}

/// A camera from its rotation and centre in the world (columns: right, down, forward).
fn camera_from_world_pose(
    field: &str,
    world_from_view: DMat3,
    center: DVec3,
    intrinsics: Intrinsics,
) -> Result<Camera, CaptureFault> {
    let rotation = world_from_view.transpose();
    let pose = DAffine3 { matrix3: rotation, translation: -(rotation * center) };
    Camera::new(pose, intrinsics).map_err(|source| CaptureFault::camera(field, source))
}

#[cfg(test)]
mod tests;
