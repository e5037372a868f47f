//! Scenes in the file system.

use std::io::{self, Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use gs3_files::write_atomically;

use super::error::{LoadError, SaveError};
use super::progress::Progress;
use super::save::{Checked, SaveOptions, Seekable, checked};
use super::sog::{self, Streamed};
use super::source::{Files, Source};
use super::{INDEXES, LoadOptions, has_extension, load_source, streamed_source};
use crate::scene::Scene;

/// Loads the scene at `path`: a file of any format in the module's table, or a folder with a `lod-meta.json`,
/// `meta.json` or `meta.lcc2`. The content decides on the format; only `.splat` and `.ksplat`, which have no signature, go
/// by their names.
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
    load_until(path, options, progress, &AtomicBool::new(false))
}

/// As [`load`], until `stop` is set, from any thread: no file is read any further then.
///
/// # Errors
/// As [`load`]; [`LoadError::Stopped`] if it was stopped before all was read.
pub fn load_until(
    path: impl AsRef<Path>,
    options: &LoadOptions,
    progress: Progress<'_>,
    stop: &AtomicBool,
) -> Result<Scene, LoadError> {
    let index = index_of(path.as_ref())?;
    let folder = Folder { path: index.parent().unwrap_or(Path::new("")).to_owned(), stop };
    let loaded = load_source(&Source::open(&index)?.until(stop), &folder, options, progress);
    // Readers of archives and streams tell it as what they could not read.
    match loaded {
        Err(_) if stop.load(Ordering::Relaxed) => {
            Err(LoadError::Stopped { file: index.display().to_string() })
        }
        loaded => loaded,
    }
}

/// The file that a scene is opened by: `path` itself, or what a folder has of it.
fn index_of(path: &Path) -> Result<PathBuf, LoadError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let names = INDEXES.map(|name| path.join(name));
    let index = names.into_iter().find(|file| file.exists());
    index.ok_or_else(|| {
        let files = std::fs::read_dir(path).into_iter().flatten().flatten();
        let scenes = files.filter(|file| has_extension(&file.file_name().to_string_lossy(), "ply")).count();
        LoadError::NoScene { folder: path.to_owned(), plys: scenes }
    })
}

/// A folder of the file system.
struct Folder<'a> {
    path: PathBuf,
    /// See [`Source::until`].
    stop: &'a AtomicBool,
}

impl Files for Folder<'_> {
    fn open(&self, name: &str) -> Result<Source<'_>, LoadError> {
        Ok(Source::open(&self.path.join(name))?.until(self.stop))
    }
}

/// What the streamed scene (SOG or LCC2) at `path`, given as to [`load`], has to choose from by [`LoadOptions`]; `None` of other
/// scenes, which have one level and no environment of their own. Reads the index alone.
///
/// # Errors
/// [`LoadError`] if that cannot be read or is of no format.
pub fn streamed(path: impl AsRef<Path>) -> Result<Option<Streamed>, LoadError> {
    streamed_source(&Source::open(&index_of(path.as_ref())?)?)
}

/// Saves `scene` as [`save_with`] does with what [`SaveOptions`] are unless stated.
///
/// # Errors
/// As [`save_with`].
pub fn save(scene: &Scene, path: impl AsRef<Path>) -> Result<(), SaveError> {
    save_with(scene, path, &SaveOptions::default())
}

/// Saves `scene` at `path`. The end of the name says the format ([`format_of`](super::format_of)). The file appears whole or not at
/// all. Streamed SOG has other files beside its `lod-meta.json`, which appears last; where one is already, it stays, and that is
/// an error. Positions are in the frame of the file that the scene came from, in right-down-front or the axes of the format. PLY
/// and GLB are exact to rounding, the others quantise. SOG and compressed PLY reorder the Gaussians.
///
/// # Errors
/// [`SaveError`] if the name ends otherwise, the scene does not fit the format, the file cannot be written, or a streamed scene
/// is there already.
pub fn save_with(scene: &Scene, path: impl AsRef<Path>, options: &SaveOptions) -> Result<(), SaveError> {
    let path = path.as_ref();
    let saved = match checked(scene, path, options)? {
        Checked::Forward(encoding) => write_atomically(path, |writer| encoding.write(scene, writer)),
        Checked::Seeking(encoding) => write_seekable(path, |writer| encoding.write(scene, writer)),
        Checked::Streamed { .. } if path.exists() => {
            Err(io::Error::new(io::ErrorKind::AlreadyExists, "a streamed scene is there already"))
        }
        Checked::Streamed { chunk } => {
            sog::write_streamed(scene, path.parent().unwrap_or(Path::new("")), chunk)
        }
    };
    saved.map_err(|source| SaveError::Io { file: path.to_owned(), source })
}

/// As [`write_atomically`]. What goes into a pipe waits in memory until it is whole.
fn write_seekable(path: &Path, write: impl FnOnce(&mut dyn Seekable) -> io::Result<()>) -> io::Result<()> {
    write_atomically(path, |writer| {
        if writer.stream_position().is_ok() {
            return write(writer);
        }
        let mut whole = Cursor::new(Vec::new());
        write(&mut whole)?;
        writer.write_all(whole.get_ref())
    })
}
