//! What a command is to write, checked before its work begins: a slip of the pen should not cost all of it, nor a file that
//! was not meant.

use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};

use gs3::scene::format::{check_writable, format_of};

use crate::error::CliError;
use crate::inputs::is_demo;

/// A file or folder to write.
pub struct Destination<'a> {
    option: &'static str,
    path: &'a Path,
    kind: Kind,
}

enum Kind {
    /// A file with this extension.
    File(&'static str),
    /// A scene in the format that its extension names.
    Scene,
    Folder,
}

impl<'a> Destination<'a> {
    /// The file that `option` names, whose content goes with `extension`.
    pub const fn file(option: &'static str, path: &'a Path, extension: &'static str) -> Self {
        Self { option, path, kind: Kind::File(extension) }
    }

    pub const fn scene(option: &'static str, path: &'a Path) -> Self {
        Self { option, path, kind: Kind::Scene }
    }

    pub const fn folder(option: &'static str, path: &'a Path) -> Self {
        Self { option, path, kind: Kind::Folder }
    }

    fn check(&self) -> Result<(), CliError> {
        let found = fs::metadata(self.path).ok();
        let is_folder = found.as_ref().is_some_and(Metadata::is_dir);
        // A device or a pipe takes any content.
        let is_file = found.as_ref().is_none_or(Metadata::is_file);
        match self.kind {
            Kind::Folder if found.is_some() && !is_folder => return Err(self.wrong("a folder", ", a file")),
            Kind::File(_) | Kind::Scene if is_folder => return Err(self.wrong("a file", ", a folder")),
            Kind::Scene => _ = format_of(self.path)?,
            Kind::File(extension) if is_file && !has_extension(self.path, extension) => {
                return Err(self.wrong(&format!("FILE.{extension}"), ""));
            }
            Kind::File(_) | Kind::Folder => {}
        }
        let writable = match self.kind {
            Kind::Folder => check_writable(&self.path.join("file")),
            Kind::File(_) | Kind::Scene => check_writable(self.path),
        };
        writable.map_err(CliError::write(self.path))
    }

    fn wrong(&self, expected: &str, found: &str) -> CliError {
        CliError::Option {
            option: self.option,
            expected: expected.to_owned(),
            actual: format!("{}{found}", self.path.display()),
        }
    }
}

/// Checks that all `destinations` can be written, that each is what its name says, and that none is another one or one of
/// `inputs`. Leaves nothing behind.
pub fn check<'a>(
    destinations: &[Destination<'_>],
    inputs: impl IntoIterator<Item = &'a Path>,
) -> Result<(), CliError> {
    let inputs: Vec<PathBuf> = inputs.into_iter().filter(|input| !is_demo(input)).map(identity).collect();
    let mut others: Vec<(&str, PathBuf)> = Vec::new();
    for destination in destinations {
        destination.check()?;
        let place = identity(destination.path);
        if inputs.contains(&place) {
            return Err(destination.wrong("another place than that of an input", ""));
        }
        if let Some((other, _)) = others.iter().find(|(_, taken)| *taken == place) {
            return Err(destination.wrong(&format!("another place than that of {other}"), ""));
        }
        others.push((destination.option, place));
    }
    Ok(())
}

pub fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|actual| actual.eq_ignore_ascii_case(extension))
}

/// The same path for all ways to write it, as far as it is there.
fn identity(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let there = path.ancestors().find_map(|ancestor| Some((ancestor, fs::canonicalize(ancestor).ok()?)));
    match there.and_then(|(ancestor, canonical)| Some(canonical.join(path.strip_prefix(ancestor).ok()?))) {
        Some(identity) => identity,
        None => path,
    }
}
