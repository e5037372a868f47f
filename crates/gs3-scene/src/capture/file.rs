//! Cameras in the file system.

use std::path::{Path, PathBuf};

use gs3_files::read_within;

use super::context::Context;
use super::{
    CaptureError, CaptureFault, CaptureOptions, Captured, MAX_JSON_BYTES, Parsed, colmap, nerfstudio, parse,
    realityscan,
};
use crate::camera_path::CameraPath;

/// Reads the cameras at `path`: a JSON file of any known kind, a RealityScan CSV, a COLMAP `images.bin` or `images.txt`,
/// or a folder that holds one of these (COLMAP also in `sparse/0` and `sparse`).
///
/// Cameras of photos come in the order of the photos' names, in which digits count as numbers, where all have one;
/// others in the order of the file. Files are regular ones or pipes, of [`MAX_JSON_BYTES`] or [`MAX_COLMAP_BYTES`](super::MAX_COLMAP_BYTES) at
/// most. Pictures beside a file are looked at for the size that it does not state.
///
/// # Errors
/// [`CaptureError`], naming file, field, expected and actual.
pub fn load(path: impl AsRef<Path>) -> Result<CameraPath, CaptureError> {
    load_with(path, &CaptureOptions::default())
}

/// The same with what the caller knows of the cameras.
///
/// # Errors
/// [`CaptureError`], naming file, field, expected and actual.
pub fn load_with(path: impl AsRef<Path>, options: &CaptureOptions) -> Result<CameraPath, CaptureError> {
    let file = file_of(path.as_ref())?;
    let mut moved_by = options.dataparser.clone();
    let captured = match &file {
        CameraFile::Colmap(folder) => colmap::load(folder)?.with_notes(Vec::new()),
        CameraFile::Single(file) => {
            let bytes = read(file, MAX_JSON_BYTES)?;
            let context = Context::beside(file, options);
            let is_table = realityscan::is_table(&bytes);
            let parsed = if is_table {
                realityscan::parse(&bytes, &context).map(Parsed::from)
            } else {
                parse(&bytes, &context)
            };
            let captured = parsed.map_err(|fault| fault.at(file))?;
            let beside = file.with_file_name("dataparser_transforms.json");
            if moved_by.is_none() && captured.is_world && beside.is_file() {
                moved_by = Some(beside);
            }
            captured.captured.with_notes(context.into_notes())
        }
    };
    let Some(file) = moved_by else { return Ok(captured.into_path()) };
    let bytes = read(&file, MAX_JSON_BYTES)?;
    let by = nerfstudio::dataparser(&bytes).map_err(|fault| fault.at(&file))?;
    let Captured { path, mut facts } = captured;
    facts.notes.push(format!("cameras are brought into the frame of {}", file.display()));
    let path = path.in_moved_world(&by).map_err(|e| CaptureFault::camera("transform", e).at(&file))?;
    Ok(Captured { path, facts }.into_path())
}

/// Where cameras are read from.
enum CameraFile {
    /// The folder of a COLMAP model.
    Colmap(PathBuf),
    Single(PathBuf),
}

fn file_of(path: &Path) -> Result<CameraFile, CaptureError> {
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    match path.parent() {
        Some(folder) if ["images.bin", "cameras.bin", "images.txt", "cameras.txt"].contains(&name) => {
            return Ok(CameraFile::Colmap(folder.to_owned()));
        }
        _ if !path.is_dir() => return Ok(CameraFile::Single(path.to_owned())),
        _ => {}
    }
    for sub in ["", "sparse/0", "sparse"] {
        let candidate = if sub.is_empty() { path.to_path_buf() } else { path.join(sub) };
        if colmap::is_model(&candidate) {
            return Ok(CameraFile::Colmap(candidate));
        }
    }
    let names = ["transforms.json", "cameras.json", "camera_path.json"].map(|name| path.join(name));
    let found = names.into_iter().find(|file| file.is_file());
    let actual = || "a folder without any of them".to_owned();
    found.map(CameraFile::Single).ok_or_else(|| CaptureFault::Unrecognized { actual: actual() }.at(path))
}

/// All of a file that ends within `most` bytes.
pub(super) fn read(path: &Path, most: u64) -> Result<Vec<u8>, CaptureError> {
    read_within(path, most).map_err(|error| CaptureFault::Read(error).at(path))
}
