//! COLMAP sparse models, binary and text: `cameras` (intrinsics) and `images` (poses and photo names).
//!
//! Layouts: <https://colmap.github.io/format.html>. Only undistorted models are accepted.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::order::in_order;
use super::{CaptureError, CaptureFault, MAX_COLMAP_BYTES, Photo, path_through, read};
use crate::camera::{Camera, Intrinsics};
use crate::camera_path::CameraPath;
use crate::format::quoted;

/// COLMAP's camera models in the order of their numbers in binary files.
const MODELS: [&str; 11] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
];

/// The two ways that COLMAP writes a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColmapEncoding {
    /// `cameras.bin` and `images.bin`.
    Binary,
    /// `cameras.txt` and `images.txt`.
    Text,
}

impl ColmapEncoding {
    const fn extension(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }

    fn cameras(self, bytes: &[u8]) -> Result<CamerasById, CaptureFault> {
        match self {
            Self::Binary => binary::cameras(bytes),
            Self::Text => text::cameras(bytes),
        }
    }

    fn images(self, bytes: &[u8]) -> Result<Vec<PosedImage>, CaptureFault> {
        match self {
            Self::Binary => binary::images(bytes),
            Self::Text => text::images(bytes),
        }
    }
}

type CamerasById = HashMap<u32, Intrinsics>;

/// One entry of the `images` file.
struct PosedImage {
    /// The entry's place in the file.
    field: String,
    name: String,
    camera_id: u32,
    /// Rotation `w`, `x`, `y`, `z`, view from world.
    rotation: [f64; 4],
    /// Translation, view from world.
    translation: [f64; 3],
}

/// Whether `folder` holds a sparse model.
pub(super) fn is_model(folder: &Path) -> bool {
    [ColmapEncoding::Binary, ColmapEncoding::Text].iter().any(|encoding| {
        let kind = encoding.extension();
        folder.join(format!("cameras.{kind}")).is_file() && folder.join(format!("images.{kind}")).is_file()
    })
}

/// Reads the model in `folder`, the binary one if both are there; photos in the order of their names.
pub(super) fn load(folder: &Path) -> Result<CameraPath, CaptureError> {
    let is_binary = folder.join("images.bin").is_file();
    let encoding = if is_binary { ColmapEncoding::Binary } else { ColmapEncoding::Text };
    let kind = encoding.extension();
    let (cameras_file, images_file) =
        (folder.join(format!("cameras.{kind}")), folder.join(format!("images.{kind}")));
    let (cameras, images) = (read(&cameras_file, MAX_COLMAP_BYTES)?, read(&images_file, MAX_COLMAP_BYTES)?);
    let cameras = encoding.cameras(&cameras).map_err(|fault| fault.at(&cameras_file))?;
    path(encoding, &cameras, &images).map_err(|fault| fault.at(&images_file))
}

/// Reads a model from memory.
pub(super) fn parse(
    encoding: ColmapEncoding,
    cameras: &[u8],
    images: &[u8],
) -> Result<CameraPath, CaptureFault> {
    path(encoding, &encoding.cameras(cameras)?, images)
}

fn path(encoding: ColmapEncoding, cameras: &CamerasById, images: &[u8]) -> Result<CameraPath, CaptureFault> {
    photos(encoding.images(images)?, cameras).and_then(path_through)
}

fn photos(images: Vec<PosedImage>, cameras: &CamerasById) -> Result<Vec<Photo>, CaptureFault> {
    let photo = |image: PosedImage| {
        let Some(intrinsics) = cameras.get(&image.camera_id) else {
            return Err(CaptureFault::field(
                &format!("{} camera id", image.field),
                "one listed in the cameras file",
                image.camera_id,
            ));
        };
        let [w, x, y, z] = image.rotation;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        if !(rotation.length() > 1e-9 && rotation.is_finite()) {
            return Err(CaptureFault::field(
                &format!("{} rotation", image.field),
                "a finite quaternion other than zero",
                format!("{:?}", image.rotation),
            ));
        }
        let pose = DAffine3 {
            matrix3: DMat3::from_quat(rotation.normalize()),
            translation: DVec3::from(image.translation),
        };
        let camera =
            Camera::new(pose, *intrinsics).map_err(|source| CaptureFault::camera(&image.field, source))?;
        Ok(Photo { name: image.name, camera })
    };
    let mut photos = images.into_iter().map(photo).collect::<Result<Vec<_>, _>>()?;
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    Ok(photos)
}

/// The number of parameters of an undistorted `model`.
fn parameter_count(field: &str, model: &str) -> Result<usize, CaptureFault> {
    match model {
        "SIMPLE_PINHOLE" => Ok(3),
        "PINHOLE" => Ok(4),
        _ => Err(CaptureFault::Distorted { field: field.into(), model: quoted(model) }),
    }
}

fn intrinsics(field: &str, size: [u64; 2], parameters: &[f64]) -> Result<Intrinsics, CaptureFault> {
    let side = |pixels: u64| {
        u32::try_from(pixels)
            .map_err(|_| CaptureFault::field(&format!("{field} size"), "a size in pixels", pixels))
    };
    let (width, height) = (side(size[0])?, side(size[1])?);
    match *parameters {
        [f, cx, cy] => Ok(Intrinsics { width, height, fx: f, fy: f, cx, cy }),
        [fx, fy, cx, cy] => Ok(Intrinsics { width, height, fx, fy, cx, cy }),
        _ => Err(CaptureFault::field(
            &format!("{field} parameters"),
            "3 (SIMPLE_PINHOLE) or 4 (PINHOLE)",
            parameters.len(),
        )),
    }
}
