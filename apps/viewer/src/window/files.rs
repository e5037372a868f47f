//! Files of the native viewer.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::scene::capture::{self, CaptureOptions};
use gs3::scene::format::{self, LoadOptions};
use gs3::scene::{Size, demo};
use gs3_files::write_atomically;

use crate::viewer::{Destination, Opened};

/// Numbers of numbered files.
const NUMBERS: std::ops::RangeInclusive<u32> = 1..=9999;

/// Opens the scene or the cameras at `file`; `demo` is the built-in scene. What it is, its content says. Cameras that state no
/// size of their pictures get `size`.
///
/// # Errors
/// One line with file, expected and actual.
pub fn open(file: &Path, size: Size, progress: &(dyn Fn(f32) + Sync)) -> Result<Opened, String> {
    let line = |text: String| text.split(['\n', '\r']).map(str::trim).collect::<Vec<_>>().join(" ");
    if file.as_os_str() == "demo" && !file.exists() {
        let scene = Arc::new(demo::scene().map_err(|e| line(e.to_string()))?);
        return Ok(Opened::Scene { name: "demo".to_owned(), scene, cameras: Some(demo::path()) });
    }
    let name =
        file.file_name().map_or_else(|| file.display().to_string(), |n| n.to_string_lossy().into_owned());
    let options = CaptureOptions { size: Some(size), ..CaptureOptions::default() };
    let is_json = file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    // Scenes have JSON files, too: the index of a SOG is one.
    if is_json && let Ok(path) = capture::load_with(file, &options) {
        return Ok(Opened::Cameras { name, path });
    }
    match format::load(file, &LoadOptions::default(), progress) {
        Ok(scene) => Ok(Opened::Scene { name, scene: Arc::new(scene), cameras: None }),
        // A folder of cameras is no scene.
        Err(error) => match capture::load_with(file, &options) {
            Ok(path) => Ok(Opened::Cameras { name, path }),
            Err(_) => Err(line(error.to_string())),
        },
    }
}

/// Writes `bytes` and says where. Numbered files replace nothing.
///
/// # Errors
/// One line with the file and why it cannot be written.
pub fn save(place: &Destination, bytes: &[u8]) -> Result<PathBuf, String> {
    let write = |file: &Path| write_atomically(file, |writer| writer.write_all(bytes));
    match place {
        Destination::File(file) => {
            write(file).map_err(|e| failed(file, &e))?;
            Ok(file.clone())
        }
        Destination::Numbered { stem, extension } => {
            let file = claim(stem, extension)?;
            // The name is taken; what it names comes whole or not at all.
            let written = write(&file).map_err(|e| failed(&file, &e));
            if written.is_err() {
                give_up(&file);
            }
            written.map(|()| file)
        }
    }
}

/// Makes an empty file of the first free name of `stem-0001.extension` and so on, so that nobody else takes the name.
///
/// # Errors
/// One line with the file and why it cannot be made.
pub fn claim(stem: &str, extension: &str) -> Result<PathBuf, String> {
    for number in NUMBERS {
        let file = PathBuf::from(format!("{stem}-{number:04}.{extension}"));
        match OpenOptions::new().write(true).create_new(true).open(&file) {
            Ok(_) => return Ok(file),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(failed(&file, &error)),
        }
    }
    Err(format!("{stem}-NNNN.{extension}: expected a free number up to {}, found none", NUMBERS.end()))
}

/// Removes the empty file of a claimed name.
pub fn give_up(file: &Path) {
    // The error that led here is already on its way.
    _ = fs::remove_file(file);
}

fn failed(file: &Path, error: &std::io::Error) -> String {
    format!("{}: cannot be written: {error}", file.display())
}

/// Memory of this process that is in use, bytes, where the system tells (Linux).
pub fn memory() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_files_are_one_line_with_their_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in
            [("bad.ply", &b"ply\nformat nonsense"[..]), ("bad.json", b"{"), ("empty.spz", b"")]
        {
            let file = folder.path().join(name);
            fs::write(&file, bytes).unwrap();
            let error = open(&file, Size::new(64, 40), &|_| {}).unwrap_err();
            assert!(error.contains(name) && error.lines().count() == 1, "{error}");
        }
        assert!(open(&folder.path().join("none.ply"), Size::new(64, 40), &|_| {}).is_err());
    }

    #[test]
    fn cameras_and_scenes_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.json");
        let path = demo::path().resized(64, 40).unwrap();
        fs::write(&file, crate::path_file::camera_path_json(&path, Size::new(64, 40))).unwrap();
        assert!(
            matches!(open(&file, Size::new(64, 40), &|_| {}), Ok(Opened::Cameras { path, .. }) if path.cameras().len() > 1)
        );
        let opened = open(Path::new("demo"), Size::new(64, 40), &|_| {});
        assert!(matches!(opened, Ok(Opened::Scene { scene, .. }) if scene.gaussians().len() > 100_000));
    }

    #[test]
    fn numbered_files_replace_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.txt");
        assert_eq!(save(&Destination::File(file.clone()), b"one"), Ok(file.clone()));
        assert_eq!(save(&Destination::File(file.clone()), b"two"), Ok(file.clone()));
        assert_eq!(fs::read(&file).unwrap(), b"two");
        let error = save(&Destination::File(folder.path().join("none/a.txt")), b"").unwrap_err();
        assert!(error.contains("a.txt: cannot be written"), "{error}");
        // Numbers begin in the folder that the stem names.
        let stem: &'static str = Box::leak(folder.path().join("shot").display().to_string().into_boxed_str());
        let place = Destination::Numbered { stem, extension: "png" };
        let saved = [save(&place, b"1").unwrap(), save(&place, b"2").unwrap()];
        for (k, file) in saved.iter().enumerate() {
            assert!(file.ends_with(format!("shot-000{}.png", k + 1)));
            assert_eq!(fs::read(file).unwrap(), (k + 1).to_string().as_bytes());
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_process_has_memory() {
        assert!(memory().is_some_and(|bytes| bytes > 1 << 20));
    }
}
