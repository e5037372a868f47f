//! Camera files of captures and of viewers. Readers: COLMAP, `transforms.json`, Inria's `cameras.json`,
//! nerfstudio's `camera_path.json` and exported cameras, SuperSplat's settings, RealityScan's CSV. Writer: SuperSplat's
//! settings ([`supersplat_settings`]).
//!
//! The content tells the formats apart. Every reader flips the axes of its format to gs3's (x right, y down,
//! z forward).

mod cameras_json;
mod colmap;
mod context;
mod error;
mod fields;
#[cfg(feature = "fs")]
mod file;
mod nerfstudio;
mod order;
#[cfg(feature = "fs")]
mod picture;
mod realityscan;
mod supersplat;
mod transforms;

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DVec3};

pub use colmap::ColmapEncoding;
pub use error::{CaptureError, CaptureFault};
#[cfg(feature = "fs")]
pub use file::{load, load_with};
pub use supersplat::{SuperSplatSettings, supersplat_settings};

use crate::camera::{Camera, Intrinsics};
use crate::camera_path::{CameraPath, CameraPathError, PathFacts};
use crate::lens::Lens;
use crate::size::Size;
use context::Context;
use fields::Field;

/// Frames per second given to photo collections, which name none.
pub const DEFAULT_FRAMES_PER_SECOND: f64 = 30.0;

/// Largest size of a JSON file of cameras, in bytes: a hundred thousand cameras of 600 bytes; few cameras take more.
/// In memory JSON takes up to eighty times its size, if it consists of objects with one short field: then 5 GB.
pub const MAX_JSON_BYTES: u64 = 64 << 20;

/// Largest size of each file of a COLMAP model, in bytes: fifteen thousand photos with ten thousand observed points
/// of 24 bytes each.
pub const MAX_COLMAP_BYTES: u64 = 4 << 30;

/// Knowledge of the caller about cameras that their file does not state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CaptureOptions {
    /// The size of the images, of files that state none. (Others are brought to a size by
    /// [`CameraPath::resized`].)
    pub size: Option<Size>,
    /// Vertical field of view in radians, of files that state no intrinsics at all.
    pub fov_y: Option<f64>,
    /// A `dataparser_transforms.json` of nerfstudio. The cameras are transformed to its frame. If this is `None`, the
    /// file beside a `transforms.json` is used. Only files of cameras read it.
    pub dataparser: Option<PathBuf>,
}

impl CaptureOptions {
    /// Size and field of view, where both are known.
    fn calibration(&self) -> Option<Intrinsics> {
        let (size, fov_y) = self.size.zip(self.fov_y)?;
        Some(Intrinsics::from_fov_y(size.width, size.height, fov_y))
    }
}

/// Reads any of the JSON formats from memory.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_json(bytes: &[u8]) -> Result<CameraPath, CaptureFault> {
    parse_json_with(bytes, &CaptureOptions::default())
}

/// The same with what the caller knows of the cameras; [`CaptureOptions::dataparser`] is not read.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_json_with(bytes: &[u8], options: &CaptureOptions) -> Result<CameraPath, CaptureFault> {
    let context = Context::in_memory(options);
    let parsed = parse(bytes, &context)?;
    Ok(parsed.captured.with_notes(context.into_notes()).into_path())
}

/// Reads a RealityScan CSV from memory, with pictures of `size`.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_csv(bytes: &[u8], size: Size) -> Result<CameraPath, CaptureFault> {
    let options = CaptureOptions { size: Some(size), ..CaptureOptions::default() };
    let context = Context::in_memory(&options);
    let captured = realityscan::parse(bytes, &context)?;
    Ok(captured.with_notes(context.into_notes()).into_path())
}

/// Cameras of a JSON file or a table.
struct Parsed {
    captured: Captured,
    /// Whether they are in the frame of a capture, from which nerfstudio's leads.
    #[cfg_attr(not(feature = "fs"), expect(dead_code, reason = "a file beside has the way"))]
    is_world: bool,
}

impl From<Captured> for Parsed {
    fn from(captured: Captured) -> Self {
        Self { captured, is_world: false }
    }
}

fn parse(bytes: &[u8], context: &Context<'_>) -> Result<Parsed, CaptureFault> {
    // Editors on Windows write a byte order mark, which JSON has none of.
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let json: serde_json::Value = serde_json::from_slice(bytes)?;
    let root = Field::root(&json);
    if root.get("camera_path").is_some() {
        nerfstudio::parse(&root, context).map(Parsed::from)
    } else if root.get("frames").is_some() {
        Ok(Parsed { captured: transforms::parse(&root, context)?, is_world: true })
    } else if json.is_array() {
        cameras_json::parse(&root, context).map(Parsed::from)
    } else if root.get("animTracks").is_some() || root.get("cameras").is_some_and(|c| c.is_array()) {
        supersplat::parse(&root, context).map(Parsed::from)
    } else {
        Err(CaptureFault::Unrecognized { actual: root.describe() })
    }
}

/// Reads the two files of a COLMAP model from memory.
///
/// # Errors
/// [`CaptureFault`], naming field, expected and actual.
pub fn parse_colmap(
    encoding: ColmapEncoding,
    cameras: &[u8],
    images: &[u8],
) -> Result<CameraPath, CaptureFault> {
    Ok(colmap::parse(encoding, cameras, images)?.with_notes(Vec::new()).into_path())
}

/// One photo of a collection.
struct Photo {
    name: String,
    camera: Camera,
    /// None of a pinhole.
    lens: Option<Lens>,
}

/// What a reader gives.
struct Captured {
    path: CameraPath,
    facts: PathFacts,
}

impl Captured {
    /// Adds the notes, including the notes about lenses.
    fn with_notes(mut self, notes: Vec<String>) -> Self {
        let distorted = self.facts.lenses.iter().flatten().count();
        if distorted > 0 {
            self.facts.notes.push(format!(
                "{distorted} of {} cameras have a lens that is no pinhole: frames show what a pinhole of its focal \
                 length sees",
                self.path.cameras().len()
            ));
        }
        self.facts.notes.extend(notes);
        self
    }

    fn into_path(self) -> CameraPath {
        self.path.with_facts(self.facts)
    }
}

/// A path through photos in the given order.
fn path_through(photos: Vec<Photo>) -> Result<Captured, CaptureFault> {
    let has_lenses = photos.iter().any(|photo| photo.lens.is_some());
    let lenses = if has_lenses { photos.iter().map(|photo| photo.lens).collect() } else { Vec::new() };
    let (names, cameras) = photos.into_iter().map(|p| (p.name, p.camera)).unzip();
    let path = CameraPath::new(cameras, DEFAULT_FRAMES_PER_SECOND, false)?.with_names(names);
    Ok(Captured { path, facts: PathFacts { lenses, ..PathFacts::default() } })
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

#[cfg(feature = "fs")]
#[cfg(test)]
mod tests;
