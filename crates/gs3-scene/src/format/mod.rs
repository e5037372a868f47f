//! Scene files: [`load`] any of them, [`save`] as PLY, SPZ or SOG.
//!
//! | format | read | written |
//! |---|---|---|
//! | PLY of 3D Gaussian Splatting (Kerbl et al. 2023), binary or text | yes | yes |
//! | compressed PLY (PlayCanvas) | yes | |
//! | `.splat` (antimatter15) | yes | |
//! | SPZ (Niantic), versions 2 and 3 | yes | version 3 |
//! | SOG (PlayCanvas), version 2: bundle, or folder with `meta.json` | yes | bundle |
//! | streamed SOG: folder with `lod-meta.json` | yes | |
//!
//! Everything a file says is checked before it is believed: sizes against the file's size, memory against
//! what a file of that size may plausibly unpack to, values by [`Scene::new`].

mod activation;
mod error;
mod ply;
mod progress;
mod quaternion;
mod rows;
mod sog;
mod source;
mod splat;
mod spz;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use gs3_files::write_atomically;

pub(crate) use error::quoted;
pub use error::{LoadError, SaveError};
pub use progress::Progress;
pub use sog::Streamed;
pub use source::{Files, Source};
pub use spz::Clamped;

use crate::gaussians::Gaussians;
use crate::scene::{OpacityMode, Scene};

/// Gaussians decoded by one task: enough work that scheduling costs nothing, small enough to stay in cache.
const BLOCK: usize = 4096;

/// What to load of a scene that holds several representations of itself; [`streamed`] tells what there is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// Level of detail of a streamed SOG scene, 0 the finest. Parts of the scene that have nothing at this level are
    /// left out. `None` takes the finest that each part has. A level that a scene does not have is an error; scenes of
    /// other formats have level 0 alone.
    pub level_of_detail: Option<u32>,
    /// Whether the environment (sky, far background) of a streamed SOG scene is appended, where it has one.
    pub environment: bool,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { level_of_detail: None, environment: true }
    }
}

/// Loads the scene at `path`: a file of any format in the module's table, or a folder with a `lod-meta.json` or
/// `meta.json`. The content decides on the format; only `.splat`, which has no signature, goes by its name.
///
/// `progress` is called from several threads with the share that is done, 0 to 1.
///
/// # Errors
/// [`LoadError`], one line that names file, field, expected and actual.
pub fn load(
    path: impl AsRef<Path>,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Scene, LoadError> {
    let index = index_of(path.as_ref())?;
    let folder = source::Folder(index.parent().unwrap_or(Path::new("")).to_owned());
    load_source(&Source::open(&index)?, &folder, options, progress)
}

/// The file that a scene is opened by: `path` itself, or what a folder has of it.
fn index_of(path: &Path) -> Result<PathBuf, LoadError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let names = ["lod-meta.json", "meta.json"].map(|name| path.join(name));
    let index = names.into_iter().find(|file| file.exists());
    index.ok_or_else(|| LoadError::NoScene { folder: path.to_owned() })
}

/// What the streamed SOG scene at `path`, given as to [`load`], has to choose from by [`LoadOptions`]; `None` of other
/// scenes, which have one level and no environment of their own. Reads the index alone.
///
/// # Errors
/// [`LoadError`] if that cannot be read or is of no format.
pub fn streamed(path: impl AsRef<Path>) -> Result<Option<Streamed>, LoadError> {
    let source = Source::open(&index_of(path.as_ref())?)?;
    match Kind::of(&source)? {
        Kind::StreamedSog => sog::streamed(&source).map(Some),
        _ => Ok(None),
    }
}

/// Loads a scene from `source`, which may name others among `files`: the same as [`load`] for bytes that are
/// not in the file system. A scene in one piece needs no `files`; an empty `BTreeMap<String, Vec<u8>>`
/// serves.
///
/// # Errors
/// As [`load`].
pub fn load_source(
    source: &Source<'_>,
    files: &dyn Files,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Scene, LoadError> {
    let kind = Kind::of(source)?;
    if let Some(level) = options.level_of_detail.filter(|level| *level > 0)
        && kind != Kind::StreamedSog
    {
        let expected = "0 of a scene that is not streamed and has one level";
        return Err(LoadError::invalid(source.name(), "level of detail", expected, level.to_string()));
    }
    let (gaussians, mode) = match kind {
        Kind::Ply => ply::read(source, progress)?,
        Kind::Spz => spz::read(source, progress)?,
        Kind::Sog => sog::read(source, files, progress)?,
        Kind::StreamedSog => sog::read_streamed(source, files, options, progress)?,
        Kind::Splat => splat::read(source, progress)?,
    };
    progress(1.0);
    Scene::new(gaussians, mode)
        .map_err(|error| LoadError::Scene { file: source.name().to_owned(), source: error })
}

/// The formats as they are told apart.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Ply,
    Spz,
    Sog,
    StreamedSog,
    Splat,
}

impl Kind {
    fn of(source: &Source<'_>) -> Result<Self, LoadError> {
        let head = source.head(16)?;
        if head.starts_with(b"ply") {
            Ok(Self::Ply)
        } else if head.starts_with(&[0x1f, 0x8b]) {
            Ok(Self::Spz)
        } else if head.starts_with(b"PK\x03\x04") {
            Ok(Self::Sog)
        } else if head.trim_ascii_start().starts_with(b"{") {
            Ok(if sog::is_streamed(source)? { Self::StreamedSog } else { Self::Sog })
        } else if has_extension(source.name(), "splat") {
            Ok(Self::Splat)
        } else {
            let actual = head.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
            let actual =
                if actual.is_empty() { "an empty file".to_owned() } else { format!("bytes {actual}") };
            Err(LoadError::UnknownFormat { file: source.name().to_owned(), actual })
        }
    }
}

/// Saves `scene` at `path` in the format that the extension names: `.ply`, `.spz` or `.sog`. The file appears
/// whole or not at all. Precision is that of the format: exact to rounding for PLY, quantised for the others;
/// SOG reorders the Gaussians.
///
/// # Errors
/// [`SaveError`] if the extension is another, the scene does not fit the format, or the file cannot be written.
pub fn save(scene: &Scene, path: impl AsRef<Path>) -> Result<(), SaveError> {
    let path = path.as_ref();
    let io_error = |source| SaveError::Io { file: path.to_owned(), source };
    let unrepresentable = |field, expected: String, actual: String| SaveError::Unrepresentable {
        file: path.to_owned(),
        field,
        expected,
        actual,
    };
    let extension = format_of(path)?;
    let count = scene.gaussians().len();
    match extension {
        "ply" => write_atomically(path, |writer| ply::write(scene, writer)).map_err(io_error),
        "spz" => {
            let bits = spz::fractional_bits(scene).map_err(|largest| {
                unrepresentable("position", "coordinates up to 8388607".to_owned(), largest.to_string())
            })?;
            write_atomically(path, |writer| spz::write(scene, bits, writer)).map_err(io_error)
        }
        "sog" if count > sog::MOST_GAUSSIANS => {
            Err(unrepresentable("count", format!("at most {}", sog::MOST_GAUSSIANS), count.to_string()))
        }
        _ => write_atomically(path, |writer| sog::write(scene, writer)).map_err(io_error),
    }
}

/// The step that all positions are rounded to by what [`save`] writes of `scene` at `path`, world units: that of SPZ,
/// whose coordinates are 24-bit numbers of one step, fine enough for the farthest Gaussian. `None` of other formats,
/// whose precision is relative, and of scenes that do not fit.
#[must_use]
pub fn position_step(scene: &Scene, path: impl AsRef<Path>) -> Option<f32> {
    let is_fixed = format_of(path).is_ok_and(|format| format == "spz");
    is_fixed.then(|| spz::fractional_bits(scene).ok().map(spz::step)).flatten()
}

/// How many Gaussians [`save`] changes beyond rounding where it writes `scene` at `path`: those of SPZ, whose scales
/// and spherical harmonics are bytes over a fixed range. `None` of other formats, whose ranges are those of the scene,
/// and where nothing is changed.
#[must_use]
pub fn clamped(scene: &Scene, path: impl AsRef<Path>) -> Option<Clamped> {
    let is_fixed = format_of(path).is_ok_and(|format| format == "spz");
    is_fixed.then(|| spz::clamped(scene)).filter(|clamped| *clamped != Clamped::default())
}

/// The format that [`save`] writes at `path`, by its extension: `ply`, `spz` or `sog`. Compressed PLY is only read, so
/// its usual extension `.compressed.ply` is none of them.
///
/// # Errors
/// [`SaveError::UnknownFormat`] if the extension is another.
pub fn format_of(path: impl AsRef<Path>) -> Result<&'static str, SaveError> {
    let path = path.as_ref();
    let lower = |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let extension = lower(path.extension());
    let unknown = |actual| Err(SaveError::UnknownFormat { file: path.to_owned(), actual });
    match ["ply", "spz", "sog"].into_iter().find(|format| *format == extension) {
        Some("ply") if lower(path.file_name()).ends_with(".compressed.ply") => {
            unknown("compressed.ply".to_owned())
        }
        Some(format) => Ok(format),
        None => unknown(extension),
    }
}

/// What every reader gives: Gaussians not yet checked, and the mode they were trained in.
type Decoded = (Gaussians, OpacityMode);

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|actual| actual.eq_ignore_ascii_case(extension))
}
