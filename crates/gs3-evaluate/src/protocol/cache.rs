//! Finished parts of a run, kept in the output folder.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use gs3_files::write_atomically;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::EvaluateError;
use crate::digest;
use crate::methods::{MethodSpec, weights_digest};

/// The folder of finished parts of one protocol.
pub(crate) struct Cache {
    folder: PathBuf,
}

impl Cache {
    /// Opens `out/cache`; parts that a protocol with another key left there are removed.
    pub fn new(out: &Path, key: &str) -> Result<Self, EvaluateError> {
        let folder = out.join("cache");
        let key_file = folder.join("protocol.txt");
        if fs::read_to_string(&key_file).is_ok_and(|found| found == key) {
            return Ok(Self { folder });
        }
        if key_file.exists() {
            fs::remove_dir_all(&folder).map_err(at_path(&folder))?;
        }
        fs::create_dir_all(&folder).map_err(at_path(&folder))?;
        write_whole(&key_file, |file| file.write_all(key.as_bytes()))?;
        Ok(Self { folder })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }

    /// The part `name`, if it is finished.
    pub fn load<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, EvaluateError> {
        let path = self.file(name);
        match fs::read(&path) {
            // A part that does not parse counts as unfinished.
            Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(at_path(&path)(error)),
        }
    }

    /// Keeps the part `name`, and gives it back.
    pub fn store<T: Serialize>(&self, name: &str, part: T) -> Result<T, EvaluateError> {
        let path = self.file(name);
        write_whole(&path, |file| Ok(serde_json::to_writer(file, &part)?))?;
        Ok(part)
    }
}

/// The name of the part of `method`. With other weights it is another part, and so it is if the method's name comes to
/// stand for something else, like another number of frames between: scores are not mixed up.
pub(crate) fn part_of(
    method: MethodSpec,
    scale: u32,
    weights: Option<&Path>,
) -> Result<String, EvaluateError> {
    let digest = digest::of(&(method, weights_digest(method, scale, weights)?));
    Ok(format!("{method}-{digest:016x}"))
}

/// Writes a file whole or not at all: a run that is interrupted leaves no half file under its name.
pub(super) fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut std::io::BufWriter<fs::File>) -> std::io::Result<()>,
) -> Result<(), EvaluateError> {
    write_atomically(path, write).map_err(at_path(path))
}

/// Names the file in an I/O error.
pub(super) fn at_path(path: &Path) -> impl FnOnce(std::io::Error) -> EvaluateError {
    let path = path.to_owned();
    move |source| EvaluateError::File { path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_of_other_numbers_of_frames_between_are_other_parts_under_any_name()
    -> Result<(), Box<dyn std::error::Error>> {
        let mut digests = Vec::new();
        for name in ["refined", "refined+warp", "default", "refined+warp3"] {
            let part = part_of(name.parse()?, 4, None)?;
            let digest = part.strip_prefix(name).and_then(|rest| rest.strip_prefix('-'));
            digests.push(digest.ok_or("expected the method's name")?.to_owned());
        }
        digests.sort();
        digests.dedup();
        assert_eq!(digests.len(), 4);
        Ok(())
    }
}
