//! Files that a page hands over, in memory.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use gs3::scene::format::{self, INDEXES, LoadOptions, Source};
use gs3::scene::{capture, demo};

use crate::viewer::Opened;

/// Files by their paths within the folder that was dropped, or by their names.
pub type FileMap = BTreeMap<String, Vec<u8>>;

/// Opens `name`: the built-in scene `demo` if there are no files; else the scene or the cameras that `files` hold. The content
/// says what it is.
///
/// # Errors
/// One line with the file, what was expected and what was found.
pub fn open(name: &str, mut files: FileMap) -> Result<Opened, String> {
    let line = |text: String| text.split(['\n', '\r']).map(str::trim).collect::<Vec<_>>().join(" ");
    if name == "demo" && files.is_empty() {
        let scene = Arc::new(demo::scene().map_err(|e| line(e.to_string()))?);
        return Ok(Opened::Scene { name: name.to_owned(), scene, cameras: Some(demo::path()) });
    }
    let Some(index) = index(&files) else {
        let found = files.len();
        return Err(format!(
            "{name}: expected one file, or a folder with {}, found {found} files",
            INDEXES.join(", ")
        ));
    };
    let bytes = files.remove(&index).unwrap_or_default();
    let has_extension =
        |wanted: &str| Path::new(&index).extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted));
    if has_extension("json")
        && let Ok(path) = capture::parse_json(&bytes)
    {
        return Ok(Opened::Cameras { name: name.to_owned(), path });
    }
    // What an index names lies beside it.
    let beside = match index.rsplit_once('/') {
        Some((folder, _)) => inside(files, folder),
        None => files,
    };
    let source = Source::memory(name, bytes);
    let scene = format::load_source(&source, &beside, &LoadOptions::default(), &|_| {});
    let scene = Arc::new(scene.map_err(|e| line(e.to_string()))?);
    Ok(Opened::Scene { name: name.to_owned(), scene, cameras: None })
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
        assert_eq!(count(open("a.sog", FileMap::from([("a.sog".to_owned(), bundle.clone())]))), 3);
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
        assert_eq!(count(open("garden", files)), 3);
        let path = demo::path().resized(64, 40).unwrap();
        let json = crate::tour::camera_path_json(&path, [64, 40]);
        let opened = open("cameras.json", FileMap::from([("cameras.json".to_owned(), json)]));
        assert!(matches!(opened, Ok(Opened::Cameras { .. })));
        assert!(count(open("demo", FileMap::new())) > 100_000);
    }

    #[test]
    fn bad_files_are_one_line_with_their_name() {
        for (name, bytes) in
            [("bad.ply", &b"ply\nformat nonsense"[..]), ("bad.json", b"{"), ("empty.spz", b"")]
        {
            let error = open(name, FileMap::from([(name.to_owned(), bytes.to_vec())])).unwrap_err();
            assert!(error.contains(name) && error.lines().count() == 1, "{error}");
        }
        let files = ["a.txt", "b.txt"].map(|name| (name.to_owned(), Vec::new()));
        let error = open("folder", FileMap::from(files)).unwrap_err();
        assert!(error.starts_with("folder: expected one file, or a folder with lod-meta.json"), "{error}");
        assert!(open("none", FileMap::new()).is_err());
    }
}
