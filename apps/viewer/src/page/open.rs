//! Files that a page hands over, in memory.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use gs3::scene::capture::{self, CaptureOptions};
use gs3::scene::format::{self, INDEXES, LoadOptions, Source};
use gs3::scene::{CameraPath, Scene, demo};

use crate::path_file::moved;
use crate::viewer::Opened;

/// Files by their paths within the folder that was dropped, or by their names.
pub type FileMap = BTreeMap<String, Vec<u8>>;

/// Opens `name`: the built-in scene `demo` if there are no files; else the scene or the cameras that `files` hold, or a scene
/// and its cameras. The content says what it is. Cameras that state no size of their pictures get `size`.
///
/// # Errors
/// One line with the file, what was expected and what was found.
pub fn open(name: &str, mut files: FileMap, size: [u32; 2]) -> Result<Opened, String> {
    if name == "demo" && files.is_empty() {
        let scene = Arc::new(demo::scene().map_err(|e| line(&e))?);
        return Ok(Opened::Scene { name: name.to_owned(), scene, cameras: Some(demo::path()) });
    }
    if let Some(opened) = scene_and_cameras(&files, size)? {
        return Ok(opened);
    }
    let Some(index) = index(&files) else {
        let found = files.len();
        return Err(format!(
            "{name}: expected one file, a scene and its cameras, or a folder with {}, found {found} files",
            INDEXES.join(", ")
        ));
    };
    let bytes = files.remove(&index).unwrap_or_default();
    if let Some(path) = cameras(&index, &bytes, size) {
        return Ok(Opened::Cameras { name: name.to_owned(), path });
    }
    // What an index names lies beside it.
    let beside = match index.rsplit_once('/') {
        Some((folder, _)) => inside(files, folder),
        None => files,
    };
    let scene = Arc::new(scene(name, bytes, &beside)?);
    Ok(Opened::Scene { name: name.to_owned(), scene, cameras: None })
}

/// The scene and the cameras, if `files` are one of each.
fn scene_and_cameras(files: &FileMap, size: [u32; 2]) -> Result<Option<Opened>, String> {
    let [first, second] = files.iter().collect::<Vec<_>>()[..] else { return Ok(None) };
    let read = |(name, bytes): (&String, &Vec<u8>)| cameras(name, bytes, size);
    let ((name, bytes), path) = match (read(first), read(second)) {
        (None, Some(path)) => (first, path),
        (Some(path), None) => (second, path),
        _ => return Ok(None),
    };
    if path.facts().is_panorama {
        return Err(format!(
            "{name}: expected perspective cameras beside the scene, found equirectangular ones"
        ));
    }
    let scene = scene(name, bytes.clone(), &FileMap::new())?;
    // Cameras are in the coordinates of the scene's file.
    let path = moved(&path, -scene.details().origin).map_err(|e| line(&e))?;
    Ok(Some(Opened::Scene { name: name.clone(), scene: Arc::new(scene), cameras: Some(path) }))
}

fn cameras(name: &str, bytes: &[u8], size: [u32; 2]) -> Option<CameraPath> {
    if !Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        return None;
    }
    let options = CaptureOptions { size: Some(size.into()), ..CaptureOptions::default() };
    // Scenes have JSON files, too: the index of a SOG is one.
    capture::parse_json_with(bytes, &options).ok()
}

fn scene(name: &str, bytes: Vec<u8>, beside: &FileMap) -> Result<Scene, String> {
    let source = Source::memory(name, bytes);
    format::load_source(&source, beside, &LoadOptions::default(), &|_| {}).map_err(|e| line(&e))
}

fn line(error: &dyn std::fmt::Display) -> String {
    error.to_string().split(['\n', '\r']).map(str::trim).collect::<Vec<_>>().join(" ")
}

/// The file that opens all of `files`: the only one, or the index that lies highest.
fn index(files: &FileMap) -> Option<String> {
    if files.len() == 1 {
        return files.keys().next().cloned();
    }
    let is_named = |path: &str, wanted: &str| path.rsplit('/').next() == Some(wanted);
    INDEXES.into_iter().find_map(|wanted| {
        let found = files.keys().filter(|path| is_named(path, wanted));
        found.min_by_key(|path| path.matches('/').count()).cloned()
    })
}

/// The files within `folder`, by their paths from there.
fn inside(files: FileMap, folder: &str) -> FileMap {
    let within =
        |path: String, bytes| Some((path.strip_prefix(folder)?.strip_prefix('/')?.to_owned(), bytes));
    files.into_iter().filter_map(|(path, bytes)| within(path, bytes)).collect()
}

#[cfg(test)]
mod tests {
    use gs3::scene::format::save;
    use gs3::scene::{Gaussians, OpacityMode, Scene};

    use super::*;

    fn sog() -> Vec<u8> {
        let mut gaussians = Gaussians::zeroed(3, 0);
        for k in 0..3 {
            (gaussians.rotations[0][k], gaussians.opacities[k]) = (1.0, 0.9);
            gaussians.means[0][k] = k as f32;
        }
        let scene = Scene::new(gaussians, OpacityMode::Default).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.sog");
        save(&scene, &file).unwrap();
        std::fs::read(file).unwrap()
    }

    fn count(opened: Result<Opened, String>) -> usize {
        match opened.unwrap() {
            Opened::Scene { scene, .. } => scene.gaussians().len(),
            Opened::Cameras { .. } => panic!("cameras"),
        }
    }

    #[test]
    fn scenes_folders_and_cameras_are_told_apart() {
        let bundle = sog();
        assert_eq!(count(open("a.sog", FileMap::from([("a.sog".to_owned(), bundle.clone())]), [64, 40])), 3);
        // The same unpacked, as a dropped folder with something else in it.
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bundle)).unwrap();
        let mut files = FileMap::from([("garden/notes/meta.json".to_owned(), b"{}".to_vec())]);
        for k in 0..archive.len() {
            let mut file = archive.by_index(k).unwrap();
            let mut bytes = Vec::new();
            std::io::Read::read_to_end(&mut file, &mut bytes).unwrap();
            let name = file.name().unwrap().into_owned();
            files.insert(format!("garden/{name}"), bytes);
        }
        assert_eq!(count(open("garden", files, [64, 40])), 3);
        let path = demo::path().resized(64, 40).unwrap();
        let json = crate::path_file::camera_path_json(&path, [64, 40]);
        let opened = open("cameras.json", FileMap::from([("cameras.json".to_owned(), json)]), [64, 40]);
        assert!(matches!(opened, Ok(Opened::Cameras { .. })));
        // A scene and its cameras together.
        let json = crate::path_file::camera_path_json(&path, [64, 40]);
        let both = FileMap::from([("a.sog".to_owned(), sog()), ("way.json".to_owned(), json)]);
        let opened = open("a.sog", both, [64, 40]);
        let Ok(Opened::Scene { name, scene, cameras: Some(cameras) }) = opened else { panic!("{opened:?}") };
        assert_eq!((name.as_str(), scene.gaussians().len()), ("a.sog", 3));
        assert_eq!(cameras.cameras().len(), path.cameras().len());
        assert!(count(open("demo", FileMap::new(), [64, 40])) > 100_000);
    }

    #[test]
    fn bad_files_are_one_line_with_their_name() {
        for (name, bytes) in
            [("bad.ply", &b"ply\nformat nonsense"[..]), ("bad.json", b"{"), ("empty.spz", b"")]
        {
            let error = open(name, FileMap::from([(name.to_owned(), bytes.to_vec())]), [64, 40]).unwrap_err();
            assert!(error.contains(name) && error.lines().count() == 1, "{error}");
        }
        let files = ["a.txt", "b.txt"].map(|name| (name.to_owned(), Vec::new()));
        let error = open("folder", FileMap::from(files), [64, 40]).unwrap_err();
        assert!(
            error.starts_with(
                "folder: expected one file, a scene and its cameras, or a folder with lod-meta.json"
            ),
            "{error}"
        );
        assert!(open("none", FileMap::new(), [64, 40]).is_err());
    }
}
