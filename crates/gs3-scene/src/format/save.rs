//! Writing scenes: formats, what they hold of a scene, and what they lose.

use std::ffi::OsStr;
use std::io::{self, Seek, Write};
use std::path::Path;

use rayon::prelude::*;

use super::error::SaveError;
use super::spz::Clamped;
use super::{gltf, ply, sog, splat, spz};
use crate::scene::{OpacityMode, Scene};

/// The version of SPZ that is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// For programs that do not know version 4 yet; spherical harmonics up to degree 3. In right-up-back, as the
    /// specification has it.
    Three,
    /// Smaller and faster to read. In right-down-front, as splat-transform and SuperSplat write it, and stated.
    #[default]
    Four,
}

impl From<SpzVersion> for spz::Version {
    fn from(version: SpzVersion) -> Self {
        match version {
            SpzVersion::Three => Self::Three,
            SpzVersion::Four => Self::Four,
        }
    }
}

/// How to write what a format leaves open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SaveOptions {
    /// The version of SPZ.
    pub spz_version: SpzVersion,
    /// Most Gaussians of a data set of streamed SOG. With a number, a data set has neighbours in space. Each data set has a palette
    /// of at most 65,536 rows for its spherical harmonics above degree 0: smaller data sets are closer to the scene, and larger
    /// files together. `None`: a scene from SOG keeps its data sets and their palettes; others have at most 131,072 neighbours a
    /// data set, so that a row stands for two.
    pub chunk: Option<usize>,
}

/// What a format writes to that goes back to its beginning.
pub trait Seekable: Write + Seek + Send {}
impl<T: Write + Seek + Send> Seekable for T {}

/// Writes `scene` to `writer` as [`save_with`](super::save_with) writes the file called `name`, in one of its formats of a single
/// file.
///
/// # Errors
/// [`SaveError`] if the name ends otherwise, the scene does not fit the format, or `writer` fails.
pub fn write(
    scene: &Scene,
    name: impl AsRef<Path>,
    options: &SaveOptions,
    mut writer: &mut dyn Seekable,
) -> Result<(), SaveError> {
    let name = name.as_ref();
    let written = match checked(scene, name, options)? {
        Checked::Forward(encoding) => encoding.write(scene, &mut writer),
        Checked::Seeking(encoding) => encoding.write(scene, writer),
        Checked::Streamed { .. } => {
            return Err(SaveError::Unrepresentable {
                file: name.to_owned(),
                field: "format",
                expected: "a format of one file".to_owned(),
                actual: "streamed SOG".to_owned(),
            });
        }
    };
    written.map_err(|source| SaveError::Io { file: name.to_owned(), source })
}

/// How a scene is written that fits its format.
pub(super) enum Checked {
    Forward(Forward),
    Seeking(Seeking),
    /// Into a folder.
    #[cfg_attr(not(feature = "fs"), expect(dead_code, reason = "folders are of file systems"))]
    Streamed {
        chunk: Option<usize>,
    },
}

/// Formats that are written from their beginning to their end.
pub(super) enum Forward {
    Ply,
    CompressedPly,
    Splat,
    Glb,
}

impl Forward {
    pub(super) fn write(&self, scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
        match self {
            Self::Ply => ply::write(scene, writer),
            Self::CompressedPly => ply::write_compressed(scene, writer),
            Self::Splat => splat::write(scene, writer),
            Self::Glb => gltf::write(scene, writer),
        }
    }
}

/// Formats that go back to their beginning.
pub(super) enum Seeking {
    Spz { version: spz::Version, fractional_bits: u8 },
    Sog,
}

impl Seeking {
    pub(super) fn write(&self, scene: &Scene, writer: &mut dyn Seekable) -> io::Result<()> {
        match self {
            Self::Spz { version, fractional_bits } => spz::write(scene, *version, *fractional_bits, writer),
            Self::Sog => sog::write(scene, writer),
        }
    }
}

/// How `scene` is written at `path`.
///
/// # Errors
/// [`SaveError`] if the name says no format, or the scene does not fit the format.
pub(super) fn checked(scene: &Scene, path: &Path, options: &SaveOptions) -> Result<Checked, SaveError> {
    let unrepresentable = |field, expected: String, actual: String| SaveError::Unrepresentable {
        file: path.to_owned(),
        field,
        expected,
        actual,
    };
    let (count, degree) = (scene.gaussians().len(), scene.gaussians().sh_degree);
    let check_degree = |most: u8| match degree {
        degree if degree > most => {
            Err(unrepresentable("SH degree", format!("at most {most}"), degree.to_string()))
        }
        _ => Ok(()),
    };
    Ok(match format_of(path)? {
        "ply" => Checked::Forward(Forward::Ply),
        "spz" => {
            let version = spz::Version::from(options.spz_version);
            check_degree(version.max_sh_degree())?;
            let fractional_bits = spz::fractional_bits(scene).map_err(|largest| {
                unrepresentable("position", "coordinates up to 8388607".to_owned(), largest.to_string())
            })?;
            Checked::Seeking(Seeking::Spz { version, fractional_bits })
        }
        "compressed.ply" => Checked::Forward(Forward::CompressedPly),
        "splat" => Checked::Forward(Forward::Splat),
        "glb" if !gltf::fits(scene) => {
            let expected = "a scene of less than 4 GiB".to_owned();
            return Err(unrepresentable("count", expected, count.to_string()));
        }
        "glb" => Checked::Forward(Forward::Glb),
        STREAMED_SOG => {
            check_degree(3)?;
            Checked::Streamed { chunk: options.chunk.map(|chunk| chunk.clamp(1, sog::MOST_GAUSSIANS)) }
        }
        _ if count > sog::MOST_GAUSSIANS => {
            let expected = format!("at most {}", sog::MOST_GAUSSIANS);
            return Err(unrepresentable("count", expected, count.to_string()));
        }
        _ => {
            check_degree(3)?;
            Checked::Seeking(Seeking::Sog)
        }
    })
}

/// What a file of `scene` at `path` does not keep and could change the picture, beyond the rounding of its values:
/// sentences of one line.
#[must_use]
pub fn losses(scene: &Scene, path: impl AsRef<Path>) -> Vec<String> {
    let Ok(format) = format_of(path) else { return Vec::new() };
    let gaussians = scene.gaussians();
    let mut losses = Vec::new();
    if scene.opacity_mode() == OpacityMode::Antialiased && ["glb", "splat"].contains(&format) {
        losses.push(
            "the format has no antialiased mode: other programs show the scene in default mode".to_owned(),
        );
    }
    if format == "splat" && gaussians.sh_degree > 0 {
        losses.push("the format has no spherical harmonics: colours look alike from everywhere".to_owned());
    }
    if format == "compressed.ply" {
        let cut = (0..gaussians.len()).into_par_iter().filter(|i| ply::is_sh_cut(gaussians, *i)).count();
        if cut > 0 {
            losses.push(format!("{cut} Gaussians have spherical harmonics outside ±4: they are cut to that"));
        }
    }
    // Relative to a far origin, half a step of f32 may be visible.
    let far = scene.details().origin.abs().max_element();
    if far > 0.0 && ["splat", "compressed.ply"].contains(&format) {
        let step = (far as f32).next_up() - far as f32;
        losses.push(format!(
            "positions are rounded to steps of {step:.1e}, as the scene lies {far:.3e} from the origin (PLY, GLB and SOG \
             keep them)"
        ));
    }
    losses
}

/// The step that [`write()`] rounds the positions of `scene` to at `path`, world units. SPZ has such a step: coordinates are
/// 24-bit numbers, and the farthest Gaussian must fit. `None` for other formats, which round relatively, and for scenes
/// that do not fit.
#[must_use]
pub fn position_step(scene: &Scene, path: impl AsRef<Path>) -> Option<f32> {
    let is_fixed = format_of(path).is_ok_and(|format| format == "spz");
    is_fixed.then(|| spz::fractional_bits(scene).ok().map(spz::step)).flatten()
}

/// How many Gaussians [`write()`] changes beyond rounding as it writes `scene` at `path`. SPZ stores scales and spherical
/// harmonics as bytes over a fixed range, and what lies outside is clamped. `None` if nothing is clamped, and for other
/// formats, which take their ranges from the scene.
#[must_use]
pub fn clamped(scene: &Scene, path: impl AsRef<Path>, options: &SaveOptions) -> Option<Clamped> {
    let is_fixed = format_of(path).is_ok_and(|format| format == "spz");
    is_fixed
        .then(|| spz::clamped(scene, options.spz_version.into()))
        .filter(|clamped| *clamped != Clamped::default())
}

/// The name of the file that a streamed SOG scene is opened by.
pub const STREAMED_SOG: &str = "lod-meta.json";

/// The format that [`write()`] writes at `path`, by how its name ends: `compressed.ply`, `ply`, `spz`, `sog`, `glb` or
/// `splat`; or `lod-meta.json`, streamed SOG, by the whole name.
///
/// # Errors
/// [`SaveError::UnknownFormat`] if it ends otherwise.
pub fn format_of(path: impl AsRef<Path>) -> Result<&'static str, SaveError> {
    let path = path.as_ref();
    let lower = |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let name = lower(path.file_name());
    let ends = |format: &&&str| name.ends_with(&format!(".{format}"));
    if name == STREAMED_SOG {
        return Ok(STREAMED_SOG);
    }
    let found = ["compressed.ply", "ply", "spz", "sog", "glb", "splat"].iter().find(ends);
    found
        .copied()
        .ok_or_else(|| SaveError::UnknownFormat { file: path.to_owned(), actual: lower(path.extension()) })
}
