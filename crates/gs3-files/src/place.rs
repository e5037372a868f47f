//! Where paths lead.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// What a path leads to.
pub(crate) enum Place {
    /// A file, there or not yet, under the name at the end of all symbolic links.
    File(PathBuf),
    /// Something else, which a file must not replace.
    Stream,
}

impl Place {
    pub(crate) fn of(path: &Path) -> io::Result<Self> {
        let end = end_of_links(path)?;
        match fs::metadata(&end) {
            Ok(found) if !found.is_file() => Ok(Self::Stream),
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(Self::File(end)),
        }
    }
}

/// The end of all symbolic links that `path` leads along, there or not yet; what is no link stays as it was given.
///
/// # Errors
/// What the system reports: links in a circle, folders that may not be read.
pub fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    match fs::canonicalize(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => match fs::read_link(path) {
            Ok(target) => end_of_links(&path.parent().unwrap_or(Path::new("")).join(target)),
            Err(_) => Ok(path.to_owned()),
        },
        Ok(_) if !path.is_symlink() => Ok(path.to_owned()),
        found => found,
    }
}
