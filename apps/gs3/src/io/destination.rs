//! What a command is to write, checked before its work begins: a slip of the pen should not cost all of it, nor a file
//! that was not meant.

use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};

use gs3::scene::format::{STREAMED_SOG, format_of};
use gs3_files::{check_writable, end_of_links};

use super::frame_files::is_frame_name;
use super::inputs::is_demo;
use crate::cli::error::CliError;

/// A file or folder to write.
pub struct Destination<'a> {
    option: &'static str,
    path: &'a Path,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// A file with this extension.
    File(&'static str),
    /// A scene in the format that its extension names.
    Scene,
    /// A video, FILE.mp4.
    Video,
    Folder,
    /// A folder of frames, with their names.
    Frames,
}

impl<'a> Destination<'a> {
    /// The file that `option` names. Its content goes with `extension`.
    pub const fn file(option: &'static str, path: &'a Path, extension: &'static str) -> Self {
        Self { option, path, kind: Kind::File(extension) }
    }

    pub const fn scene(option: &'static str, path: &'a Path) -> Self {
        Self { option, path, kind: Kind::Scene }
    }

    pub const fn video(option: &'static str, path: &'a Path) -> Self {
        Self { option, path, kind: Kind::Video }
    }

    pub const fn frames(option: &'static str, path: &'a Path) -> Self {
        Self { option, path, kind: Kind::Frames }
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
            Kind::Folder | Kind::Frames if found.is_some() && !is_folder => {
                return Err(self.wrong("a folder", ", a file"));
            }
            Kind::File(_) | Kind::Scene | Kind::Video if is_folder => {
                return Err(self.wrong("a file", ", a folder"));
            }
            // Its encoder goes back to the beginning once it knows the end.
            Kind::Video if !is_file => return Err(self.wrong("a file", ", a device or a pipe")),
            Kind::Scene => {
                let is_streamed = format_of(self.path)? == STREAMED_SOG;
                if is_streamed && found.is_some() {
                    return Err(self.wrong("a folder without a streamed scene", ", which is there already"));
                }
            }
            Kind::File(extension) if is_file && !has_extension(self.path, extension) => {
                return Err(self.wrong(&format!("FILE.{extension}"), ""));
            }
            Kind::File(_) | Kind::Video | Kind::Folder | Kind::Frames => {}
        }
        let writable = match self.kind {
            Kind::Folder | Kind::Frames => check_writable(&self.path.join("file")),
            Kind::File(_) | Kind::Scene | Kind::Video => check_writable(self.path),
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

/// Checks that all `destinations` can be written, that each is what its name says, and that none is another one, a
/// frame of another one or one of `inputs`. Leaves nothing behind.
pub fn check<'a>(
    destinations: &[Destination<'_>],
    inputs: impl IntoIterator<Item = &'a Path>,
) -> Result<(), CliError> {
    let inputs: Vec<PathBuf> = inputs.into_iter().filter(|input| !is_demo(input)).map(identity).collect();
    let mut others: Vec<(&Destination<'_>, PathBuf)> = Vec::new();
    for destination in destinations {
        destination.check()?;
        let place = identity(destination.path);
        if inputs.contains(&place) {
            return Err(destination.wrong("another place than that of an input", ""));
        }
        for (other, taken) in &others {
            if *taken == place {
                return Err(destination.wrong(&format!("another place than that of {}", other.option), ""));
            }
            let is_inside = other.kind == Kind::Frames && place.parent() == Some(taken);
            if is_inside && place.file_name().is_some_and(is_frame_name) {
                let folder = other.path.display();
                return Err(
                    destination.wrong(&format!("another name than those of the frames in {folder}"), "")
                );
            }
        }
        others.push((destination, place));
    }
    Ok(())
}

pub fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|actual| actual.eq_ignore_ascii_case(extension))
}

/// The same path for all ways to write it, as far as it is there.
fn identity(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let path = end_of_links(&path).unwrap_or(path);
    let there = path.ancestors().find_map(|ancestor| Some((ancestor, fs::canonicalize(ancestor).ok()?)));
    match there.and_then(|(ancestor, canonical)| Some(canonical.join(path.strip_prefix(ancestor).ok()?))) {
        Some(identity) => identity,
        None => path,
    }
}
