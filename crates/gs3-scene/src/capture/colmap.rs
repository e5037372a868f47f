//! COLMAP sparse models, binary and text: `cameras` (intrinsics) and `images` (poses and photo names).
//!
//! Layouts: <https://colmap.github.io/format.html>. Cameras that no image uses are not looked at.

mod binary;
mod text;

use std::collections::HashMap;
#[cfg(feature = "fs")]
use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::order::in_order;
#[cfg(feature = "fs")]
use super::{CaptureError, MAX_COLMAP_BYTES, file::read};
use super::{CaptureFault, Captured, Photo, path_through};
use crate::camera::{Camera, Intrinsics};
use crate::format::quoted;
use crate::lens::Lens;

/// COLMAP's camera models in the order of their numbers in binary files, and how many parameters each has.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
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
    #[cfg(feature = "fs")]
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

/// Cameras by their ids; what is wrong with one matters where an image uses it.
type CamerasById = HashMap<u32, Result<Calibration, CaptureFault>>;

/// Intrinsics, and the lens where it is no pinhole.
#[derive(Clone, Copy)]
struct Calibration {
    intrinsics: Intrinsics,
    lens: Option<Lens>,
}

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
#[cfg(feature = "fs")]
pub(super) fn is_model(folder: &Path) -> bool {
    [ColmapEncoding::Binary, ColmapEncoding::Text].iter().any(|encoding| {
        let kind = encoding.extension();
        folder.join(format!("cameras.{kind}")).is_file() && folder.join(format!("images.{kind}")).is_file()
    })
}

/// Reads the model in `folder`, the binary one if both are there; photos in the order of their names.
#[cfg(feature = "fs")]
pub(super) fn load(folder: &Path) -> Result<Captured, CaptureError> {
    let is_binary = folder.join("images.bin").is_file();
    let encoding = if is_binary { ColmapEncoding::Binary } else { ColmapEncoding::Text };
    let kind = encoding.extension();
    let (cameras_file, images_file) =
        (folder.join(format!("cameras.{kind}")), folder.join(format!("images.{kind}")));
    let (cameras, images) = (read(&cameras_file, MAX_COLMAP_BYTES)?, read(&images_file, MAX_COLMAP_BYTES)?);
    let cameras = encoding.cameras(&cameras).map_err(|fault| fault.at(&cameras_file))?;
    let captured = encoding.images(&images).and_then(|images| photos(images, cameras));
    captured.map_err(|fault| fault.at(&images_file))
}

/// Reads a model from memory.
pub(super) fn parse(
    encoding: ColmapEncoding,
    cameras: &[u8],
    images: &[u8],
) -> Result<Captured, CaptureFault> {
    photos(encoding.images(images)?, encoding.cameras(cameras)?)
}

fn photos(images: Vec<PosedImage>, cameras: CamerasById) -> Result<Captured, CaptureFault> {
    let photo = |image: PosedImage| {
        let Calibration { intrinsics, lens } = match cameras.get(&image.camera_id) {
            Some(Ok(calibration)) => *calibration,
            Some(Err(fault)) => {
                return Err(CaptureFault::field(
                    &format!("{} camera {}", image.field, image.camera_id),
                    "a usable one in the cameras file",
                    fault,
                ));
            }
            None => {
                return Err(CaptureFault::field(
                    &format!("{} camera id", image.field),
                    "one listed in the cameras file",
                    image.camera_id,
                ));
            }
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
            Camera::new(pose, intrinsics).map_err(|source| CaptureFault::camera(&image.field, source))?;
        Ok(Photo { name: image.name, camera, lens })
    };
    let mut photos = images.into_iter().map(photo).collect::<Result<Vec<_>, _>>()?;
    photos.sort_by(|a, b| in_order(&a.name, &b.name));
    path_through(photos)
}

/// The number of parameters of `model`.
fn parameter_count(field: &str, model: &str) -> Result<usize, CaptureFault> {
    let found = MODELS.iter().find(|(name, _)| *name == model);
    found
        .map(|(_, count)| *count)
        .ok_or_else(|| CaptureFault::Lens { field: field.into(), model: quoted(model) })
}

/// What `model` makes of as many parameters as it has.
fn calibration(
    field: &str,
    model: &str,
    size: [u64; 2],
    parameters: &[f64],
) -> Result<Calibration, CaptureFault> {
    let side = |pixels: u64| {
        u32::try_from(pixels)
            .map_err(|_| CaptureFault::field(&format!("{field} size"), "a size in pixels", pixels))
    };
    let (width, height) = (side(size[0])?, side(size[1])?);
    let fisheye = |radial: [f64; 6], tangential: [f64; 2], prism: [f64; 4]| {
        Some(Lens::Fisheye { radial, tangential, prism })
    };
    let of_angle = |radial: [f64; 4]| {
        let [k1, k2, k3, k4] = radial;
        fisheye([k1, k2, k3, k4, 0.0, 0.0], [0.0; 2], [0.0; 4])
    };
    let one_focal = |f: f64, cx: f64, cy: f64| Intrinsics { width, height, fx: f, fy: f, cx, cy };
    let two_focal = |[fx, fy, cx, cy]: [f64; 4]| Intrinsics { width, height, fx, fy, cx, cy };
    let (intrinsics, lens) = match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => (one_focal(f, cx, cy), None),
        ("PINHOLE", &[fx, fy, cx, cy]) => (two_focal([fx, fy, cx, cy]), None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => {
            (one_focal(f, cx, cy), Some(Lens::brown(k, 0.0, 0.0, 0.0, 0.0)))
        }
        ("RADIAL", &[f, cx, cy, k1, k2]) => (one_focal(f, cx, cy), Some(Lens::brown(k1, k2, 0.0, 0.0, 0.0))),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            (two_focal([fx, fy, cx, cy]), Some(Lens::brown(k1, k2, p1, p2, 0.0)))
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let lens =
                Lens::Radial { radial: [k1, k2, k3, k4, k5, k6], tangential: [p1, p2], prism: [0.0; 4] };
            (two_focal([fx, fy, cx, cy]), Some(lens))
        }
        ("FOV", &[fx, fy, cx, cy, omega]) => (two_focal([fx, fy, cx, cy]), Some(Lens::FieldOfView(omega))),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            (two_focal([fx, fy, cx, cy]), of_angle([k1, k2, k3, k4]))
        }
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => (one_focal(f, cx, cy), of_angle([k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => (one_focal(f, cx, cy), of_angle([k1, k2, 0.0, 0.0])),
        ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1]) => {
            (two_focal([fx, fy, cx, cy]), fisheye([k1, k2, k3, k4, 0.0, 0.0], [p1, p2], [sx1, 0.0, sy1, 0.0]))
        }
        ("RAD_TAN_THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4, k5, k6, p1, p2, s1, s2, s3, s4]) => {
            (
                two_focal([fx, fy, cx, cy]),
                // Its first tangential coefficient goes with x, as the second of OpenCV's.
                fisheye([k1, k2, k3, k4, k5, k6], [p2, p1], [s1, s2, s3, s4]),
            )
        }
        _ => {
            let expected = format!("as many as {model} has");
            return Err(CaptureFault::field(&format!("{field} parameters"), &expected, parameters.len()));
        }
    };
    if let Some(lens) = lens
        && !lens.is_finite()
    {
        return Err(CaptureFault::field(&format!("{field} parameters"), "finite numbers", "another"));
    }
    Ok(Calibration { intrinsics, lens: lens.filter(|lens| !lens.is_pinhole()) })
}
