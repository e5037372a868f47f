//! Scene files: read any of them ([`load_source`]), and [`write()`] in the formats that are written; with feature `fs` also at
//! paths (`load`, `save`).
//!
//! | format | read | written |
//! |---|---|---|
//! | PLY of 3D Gaussian Splatting (Kerbl et al. 2023), binary or text, spherical harmonics up to degree 4 | yes | yes |
//! | compressed PLY (PlayCanvas) | yes | yes |
//! | `.splat` (antimatter15) | yes | yes |
//! | `.ksplat` (GaussianSplats3D) | yes | |
//! | SPZ (Niantic), versions 1 to 4 | yes | versions 4 and 3 |
//! | SOG (PlayCanvas), versions 1 and 2: bundle, or folder with `meta.json` | yes | bundle of version 2 |
//! | streamed SOG: folder with `lod-meta.json` | yes | one level of detail |
//! | glTF and GLB with `KHR_gaussian_splatting`, also compressed as SPZ by its drafts | yes | GLB |
//! | `.rad` (Spark) | yes | |
//! | LCC2 (XGRIDS): `meta.lcc2` with its SOG or SPZ files | yes | |
//! | one of these files in a ZIP archive | yes | |
//!
//! Everything a file says is checked before it is believed: sizes against the file's size, memory against
//! what a file of that size may plausibly unpack to, values by [`Scene::new`]. What a file says that is not used and
//! could change the picture is in the scene's [`Details::notes`].

mod activation;
mod archive;
mod error;
#[cfg(feature = "fs")]
mod file;
mod gltf;
mod kind;
mod ksplat;
mod lcc2;
mod memory;
mod morton;
mod origin;
mod ply;
mod progress;
mod quaternion;
mod rad;
mod rows;
mod save;
mod sog;
mod source;
mod splat;
mod spz;

use std::path::Path;

use glam::DVec3;

pub(crate) use error::quoted;
pub use error::{LoadError, SaveError};
#[cfg(feature = "fs")]
pub use file::{load, load_until, save, save_with, streamed};
pub use progress::Progress;
pub use save::{
    STREAMED_SOG, SaveOptions, Seekable, SpzVersion, clamped, format_of, losses, position_step, write,
};
pub use sog::{Budget, Streamed};
pub use source::{Files, Source};
pub use spz::Clamped;

use crate::axes::Axes;
use crate::camera::NEAR;
use crate::gaussians::Gaussians;
use crate::orbit;
use crate::scene::{AxesKnownBy, Details, FileAxes, OpacityMode, Scene, SceneError};
use crate::transform::{Similarity, transform};
use kind::Kind;

/// Gaussians decoded by one task: enough work that scheduling costs nothing, small enough to stay in cache.
const BLOCK: usize = 4096;

/// The part to load of a scene with several representations; [`streamed_source`] lists the representations.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Level of detail of a streamed SOG scene, 0 the finest. Parts of the scene that have nothing at this level are
    /// left out. `None` takes the finest that each part has. A level that a scene does not have is an error; scenes of
    /// other formats have level 0 alone.
    pub level_of_detail: Option<u32>,
    /// How many Gaussians to load of a streamed SOG scene, at the level of detail for each part that leaves the least error.
    /// Other scenes must be within the budget. Not together with a level.
    pub budget: Option<Budget>,
    /// Whether the environment (sky, far background) of a streamed SOG scene is appended, where it has one.
    pub environment: bool,
    /// Which way the axes of the file point, where that is not what the file states or its format says.
    pub axes: Option<Axes>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { level_of_detail: None, budget: None, environment: true, axes: None }
    }
}

/// Names of the files that open a folder; of several in a folder the first one counts.
pub const INDEXES: [&str; 3] = [STREAMED_SOG, "meta.json", "meta.lcc2"];

/// What the streamed scene (SOG or LCC2) with the index `source` has to choose from by [`LoadOptions`]; `None` of other scenes,
/// which have one level and no environment of their own.
///
/// # Errors
/// [`LoadError`] if the index cannot be read or is of no format.
pub fn streamed_source(source: &Source<'_>) -> Result<Option<Streamed>, LoadError> {
    match Kind::of(source)? {
        Kind::StreamedSog => sog::streamed(source).map(Some),
        Kind::Lcc2(json) => {
            let (levels, has_environment) = lcc2::streamed(source, &json)?;
            Ok(Some(Streamed { levels, has_environment, takes_budget: false }))
        }
        _ => Ok(None),
    }
}

/// Loads a scene from `source`, which may name others among `files`. A scene in one piece needs no `files`; an empty
/// `BTreeMap<String, Vec<u8>>` serves. The content decides on the format; only `.splat` and `.ksplat`, which have no signature,
/// go by their names. `progress` is called from several threads with the share that is done, 0 to 1.
///
/// # Errors
/// [`LoadError`], one line that names file, field, expected and actual.
pub fn load_source(
    source: &Source<'_>,
    files: &dyn Files,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Scene, LoadError> {
    let decoded = decode(source, files, options, progress)?;
    progress(1.0);
    if let Some(budget) =
        options.budget.as_ref().filter(|_| !matches!(Kind::of(source), Ok(Kind::StreamedSog)))
        && decoded.gaussians.len() as u64 > budget.gaussians
    {
        let expected =
            format!("at most {}, or a streamed SOG scene, which has coarser levels", budget.gaussians);
        let actual = decoded.gaussians.len().to_string();
        return Err(LoadError::invalid(source.name(), "Gaussians", expected, actual));
    }
    let scene = decoded
        .into_scene(options.axes)
        .map_err(|error| LoadError::Scene { file: source.name().to_owned(), source: error })?;
    let near = orbit::near_plane(&scene);
    Ok(scene.with_near(near))
}

/// Reads `source` in any format.
fn decode(
    source: &Source<'_>,
    files: &dyn Files,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let kind = Kind::of(source)?;
    if let Some(level) = options.level_of_detail.filter(|level| *level > 0)
        && !matches!(kind, Kind::StreamedSog | Kind::Lcc2(_))
    {
        let expected = "0 of a scene that is not streamed and has one level";
        return Err(LoadError::invalid(source.name(), "level of detail", expected, level.to_string()));
    }
    match kind {
        Kind::Ply => ply::read(source, progress),
        Kind::Spz => spz::read(source, progress),
        Kind::Sog => sog::read(source, files, progress),
        Kind::StreamedSog => sog::read_streamed(source, files, options, progress),
        Kind::Splat => splat::read(source, progress),
        Kind::Ksplat => ksplat::read(source, progress),
        Kind::Gltf => gltf::read(source, files, progress),
        Kind::Rad => rad::read(source, files, progress),
        Kind::Lcc2(json) => lcc2::read(source, &json, files, options, progress),
        Kind::Zip(archive) => {
            let inner = archive.single()?;
            match Kind::of(&inner)? {
                Kind::Zip(_) => {
                    Err(LoadError::invalid(inner.name(), "archive", "a scene", "another archive"))
                }
                _ => decode(&inner, &archive, options, progress),
            }
        }
    }
}

/// What every reader gives.
struct Decoded {
    /// Not yet checked, in the file's axes, relative to `origin`.
    gaussians: Gaussians,
    /// The mode that they were trained in.
    opacity_mode: OpacityMode,
    /// In the file's axes.
    origin: DVec3,
    /// The upward direction, of length 1, in the file's axes, where the file states one.
    up: Option<DVec3>,
    axes: FileAxes,
    /// What was found and not used, or assumed.
    notes: Vec<String>,
}

impl Decoded {
    /// Gaussians in right-down-front about which nothing else is known.
    fn new(gaussians: Gaussians, opacity_mode: OpacityMode) -> Self {
        let Details { origin, up, axes, notes, .. } = Details::default();
        Self { gaussians, opacity_mode, origin, up, axes, notes }
    }

    /// The scene, in right-down-front. `axes`, which the caller states, count more than what the file says.
    fn into_scene(mut self, axes: Option<Axes>) -> Result<Scene, SceneError> {
        if let Some(axes) = axes {
            if self.axes.known_by == AxesKnownBy::File && self.axes.axes != axes {
                self.notes.push(format!("states axes {}, but was told to be {axes}", self.axes.axes));
            }
            self.axes = FileAxes { axes, known_by: AxesKnownBy::Caller };
        }
        let to_rdf = self.axes.axes.to_rdf();
        transform(&mut self.gaussians, &Similarity::orthogonal(to_rdf));
        let scene = Scene::new(self.gaussians, self.opacity_mode)?;
        Ok(scene.with_details(Details {
            origin: to_rdf * self.origin,
            up: self.up.map(|up| to_rdf * up),
            axes: self.axes,
            near: NEAR,
            notes: self.notes,
        }))
    }
}

/// That fields of a file called `names` are not used, if there are any.
pub(crate) fn unused_note(what: &str, names: &[String]) -> Option<String> {
    /// A note is one line for people.
    const MOST: usize = 12;
    let listed = names.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ");
    let more = if names.len() > MOST { format!(" and {} more", names.len() - MOST) } else { String::new() };
    (!names.is_empty()).then(|| format!("{what} not used: {listed}{more}"))
}

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|actual| actual.eq_ignore_ascii_case(extension))
}
