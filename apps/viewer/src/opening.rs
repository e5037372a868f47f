//! Opens files that are in memory. A scene may name more files; the caller fetches them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use gs3::scene::capture::{self, CaptureOptions};
use gs3::scene::format::{self, Budget, Files, INDEXES, LoadError, LoadOptions, Source, Streamed};
use gs3::scene::{CameraPath, Gaussians, OpacityMode, Scene, SceneError, Size, demo};

use crate::path_file::moved;
use crate::viewer::Opened;

/// What is shown before a scene is there: one Gaussian below the opacity that is drawn.
///
/// # Errors
/// None in practice: one Gaussian is a scene.
pub fn nothing() -> Result<Scene, SceneError> {
    let mut one = Gaussians::zeroed(1, 0);
    (one.rotations[0][0], one.opacities[0]) = (1.0, 1e-3);
    Scene::new(one, OpacityMode::Default)
}

/// Files by their paths within the folder that was dropped, or by their names.
pub type FileMap = BTreeMap<String, Vec<u8>>;

/// What is being opened, and the files of it that have come.
#[derive(Debug)]
pub struct Opening {
    name: String,
    files: FileMap,
    /// The file that names the others, where these can be fetched.
    index: Option<String>,
    /// Gaussians of a streamed scene at most; none for its finest levels.
    budget: Option<u64>,
    /// Whether the coarsest levels of a streamed scene are shown.
    is_coarse_shown: bool,
}

/// What comes of the files so far.
#[derive(Debug)]
pub enum OpeningStep {
    /// These files are missing, by their paths from the folder of the first one. They are to be supplied.
    Missing(Vec<String>),
    /// The coarsest levels of a streamed scene. Finer ones follow.
    Coarse(Opened),
    /// What was to be opened.
    Done(Opened),
}

impl Opening {
    /// The built-in scene if `name` is `demo` and there are no `files`. Else `files` hold a scene, cameras, or a scene and
    /// its cameras; their content says which. With `can_fetch` there is one file, and the caller can fetch the files that
    /// it names. At most `budget` Gaussians of a streamed scene are shown.
    #[must_use]
    pub fn new(name: &str, files: FileMap, can_fetch: bool, budget: Option<u64>) -> Self {
        let index = files.keys().next().filter(|_| can_fetch).cloned();
        Self { name: name.to_owned(), files, index, budget, is_coarse_shown: false }
    }

    /// What messages call it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Takes a file that was missing.
    pub fn supply(&mut self, path: &str, bytes: Vec<u8>) {
        self.files.insert(path.to_owned(), bytes);
    }

    /// Goes on with the files that are there. Cameras that state no size of their pictures get `size`.
    ///
    /// # Errors
    /// One line with the file, what was expected and what was found.
    pub fn go_on(&mut self, size: Size) -> Result<OpeningStep, String> {
        let Self { name, files, .. } = self;
        if name == "demo" && files.is_empty() {
            let scene = Arc::new(demo::scene().map_err(|e| line(&e))?);
            let cameras = Some(demo::path());
            return Ok(OpeningStep::Done(Opened::Scene { name: name.clone(), scene, cameras }));
        }
        if self.index.is_none()
            && let Some(opened) = scene_and_cameras(files, size)?
        {
            return Ok(OpeningStep::Done(opened));
        }
        let Some(index) = self.index.clone().or_else(|| index(files)) else {
            let found = files.len();
            return Err(format!(
                "{name}: expected one file, a scene and its cameras, or a folder with {}, found {found} files",
                INDEXES.join(", ")
            ));
        };
        let bytes = files.get(&index).map(Vec::as_slice).unwrap_or_default();
        if let Some(path) = cameras(&index, bytes, size) {
            return Ok(OpeningStep::Done(Opened::Cameras { name: name.clone(), path }));
        }
        let source = Source::memory(name.as_str(), bytes);
        // What an index names lies beside it; what was fetched goes by its path from there.
        let folder = match &self.index {
            Some(_) => "",
            None => index.rsplit_once('/').map_or("", |(folder, _)| folder),
        };
        let beside = Beside { files, folder, missing: Mutex::default() };
        let streamed = format::streamed_source(&source).ok().flatten();
        let is_coarse = !self.is_coarse_shown
            && self.index.is_some()
            && streamed.is_some_and(|streamed| streamed.levels > 1);
        let options = match streamed {
            // No Gaussian more than the smallest levels have.
            Some(Streamed { takes_budget: true, .. }) => {
                let gaussians = if is_coarse { Some(0) } else { self.budget };
                let budget = gaussians.map(|gaussians| Budget { gaussians, cameras: Vec::new() });
                LoadOptions { budget, ..LoadOptions::default() }
            }
            Some(Streamed { levels, .. }) if is_coarse => {
                LoadOptions { level_of_detail: Some(levels - 1), ..LoadOptions::default() }
            }
            _ => LoadOptions::default(),
        };
        let loaded = format::load_source(&source, &beside, &options, &|_| {});
        let scene = match loaded {
            Ok(scene) => Arc::new(scene),
            Err(error) => {
                let missing = beside.missing.into_inner().unwrap_or_else(PoisonError::into_inner);
                return match missing.is_empty() || self.index.is_none() {
                    true => Err(line(&error)),
                    false => Ok(OpeningStep::Missing(missing)),
                };
            }
        };
        if is_coarse {
            self.is_coarse_shown = true;
            return Ok(OpeningStep::Coarse(Opened::Scene { name: name.clone(), scene, cameras: None }));
        }
        Ok(OpeningStep::Done(match self.is_coarse_shown {
            true => Opened::Finer { scene },
            false => Opened::Scene { name: name.clone(), scene, cameras: None },
        }))
    }
}

/// The files in `folder`, by their paths from there, and the paths that were asked for in vain.
struct Beside<'a> {
    files: &'a FileMap,
    folder: &'a str,
    missing: Mutex<Vec<String>>,
}

impl Files for Beside<'_> {
    fn open(&self, name: &str) -> Result<Source<'_>, LoadError> {
        let path = if self.folder.is_empty() { name.to_owned() } else { format!("{}/{name}", self.folder) };
        match self.files.get(&path) {
            Some(bytes) => Ok(Source::memory(name, bytes.as_slice())),
            None => {
                self.missing.lock().unwrap_or_else(PoisonError::into_inner).push(name.to_owned());
                // The error of a file that is not there.
                FileMap::new().open(name).map(|_| Source::memory(name, Vec::new()))
            }
        }
    }
}

/// The scene and the cameras, if `files` are one of each.
fn scene_and_cameras(files: &FileMap, size: Size) -> Result<Option<Opened>, String> {
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
    let source = Source::memory(name.as_str(), bytes.as_slice());
    let scene: Scene = format::load_source(&source, &FileMap::new(), &LoadOptions::default(), &|_| {})
        .map_err(|e| line(&e))?;
    // Cameras are in the coordinates of the scene's file.
    let path = moved(&path, -scene.details().origin).map_err(|e| line(&e))?;
    Ok(Some(Opened::Scene { name: name.clone(), scene: Arc::new(scene), cameras: Some(path) }))
}

fn cameras(name: &str, bytes: &[u8], size: Size) -> Option<CameraPath> {
    if !Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        return None;
    }
    let options = CaptureOptions { size: Some(size), ..CaptureOptions::default() };
    // Scenes have JSON files, too: the index of a SOG is one.
    capture::parse_json_with(bytes, &options).ok()
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

#[cfg(test)]
mod tests {
    use super::*;
    use gs3::scene::format::save;
    use gs3_test_support::row_of_gaussians;

    fn sog() -> Vec<u8> {
        sog_of(3)
    }

    fn sog_of(count: usize) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.sog");
        save(&row_of_gaussians(count, 0.0), &file).unwrap();
        std::fs::read(file).unwrap()
    }

    fn open(name: &str, files: FileMap, size: Size) -> Result<Opened, String> {
        match Opening::new(name, files, false, None).go_on(size)? {
            OpeningStep::Done(opened) => Ok(opened),
            other => panic!("{other:?}"),
        }
    }

    fn count(opened: Result<Opened, String>) -> usize {
        match opened.unwrap() {
            Opened::Scene { scene, .. } => scene.gaussians().len(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn scenes_folders_and_cameras_are_told_apart() {
        let bundle = sog();
        assert_eq!(
            count(open("a.sog", FileMap::from([("a.sog".to_owned(), bundle.clone())]), Size::new(64, 40))),
            3
        );
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
        assert_eq!(count(open("garden", files, Size::new(64, 40))), 3);
        let path = demo::path().resized(64, 40).unwrap();
        let json = crate::path_file::camera_path_json(&path, Size::new(64, 40));
        let opened =
            open("cameras.json", FileMap::from([("cameras.json".to_owned(), json)]), Size::new(64, 40));
        assert!(matches!(opened, Ok(Opened::Cameras { .. })));
        // A scene and its cameras together.
        let json = crate::path_file::camera_path_json(&path, Size::new(64, 40));
        let both = FileMap::from([("a.sog".to_owned(), sog()), ("way.json".to_owned(), json)]);
        let opened = open("a.sog", both, Size::new(64, 40));
        let Ok(Opened::Scene { name, scene, cameras: Some(cameras) }) = opened else { panic!("{opened:?}") };
        assert_eq!((name.as_str(), scene.gaussians().len()), ("a.sog", 3));
        assert_eq!(cameras.cameras().len(), path.cameras().len());
        assert!(count(open("demo", FileMap::new(), Size::new(64, 40))) > 100_000);
    }

    #[test]
    fn bad_files_are_one_line_with_their_name() {
        for (name, bytes) in
            [("bad.ply", &b"ply\nformat nonsense"[..]), ("bad.json", b"{"), ("empty.spz", b"")]
        {
            let error = open(name, FileMap::from([(name.to_owned(), bytes.to_vec())]), Size::new(64, 40))
                .unwrap_err();
            assert!(error.contains(name) && error.lines().count() == 1, "{error}");
        }
        let files = ["a.txt", "b.txt"].map(|name| (name.to_owned(), Vec::new()));
        let error = open("folder", FileMap::from(files), Size::new(64, 40)).unwrap_err();
        assert!(
            error.starts_with(
                "folder: expected one file, a scene and its cameras, or a folder with lod-meta.json"
            ),
            "{error}"
        );
        assert!(open("none", FileMap::new(), Size::new(64, 40)).is_err());
    }

    /// The files that `opening` asks for until it comes to something else, and that.
    fn fetched(opening: &mut Opening, all: &FileMap) -> (Vec<Vec<String>>, OpeningStep) {
        let mut rounds = Vec::new();
        loop {
            match opening.go_on(Size::new(64, 40)).unwrap() {
                OpeningStep::Missing(names) => {
                    names.iter().for_each(|name| opening.supply(name, all[name].clone()));
                    rounds.push(names);
                }
                other => return (rounds, other),
            }
        }
    }

    #[test]
    fn streamed_scenes_come_coarse_first_and_ask_for_what_they_need() {
        let lod = r#"{"version": 1, "lodLevels": 2, "filenames": ["fine.sog", "rest/coarse.sog", "other.sog"], "tree": {"children": [
            {"bound": {"min": [0, 0, 0], "max": [9, 1, 1]},
             "lods": {"0": {"file": 0, "offset": 0, "count": 9}, "1": {"file": 1, "offset": 0, "count": 3}}},
            {"bound": {"min": [0, 0, 0], "max": [4, 1, 1]}, "lods": {"0": {"file": 2, "offset": 0, "count": 4}}}]}}"#;
        let index = FileMap::from([("lod-meta.json".to_owned(), lod.as_bytes().to_vec())]);
        let all = [("fine.sog", 9), ("rest/coarse.sog", 3), ("other.sog", 4)];
        let all: FileMap = all.into_iter().map(|(name, count)| (name.to_owned(), sog_of(count))).collect();
        let of = |opened: Opened| match opened {
            Opened::Scene { scene, .. } | Opened::Finer { scene } => scene.gaussians().len(),
            Opened::Cameras { .. } => panic!("cameras"),
        };
        let mut opening = Opening::new("garden", index.clone(), true, None);
        let (rounds, OpeningStep::Coarse(coarse)) = fetched(&mut opening, &all) else { panic!("not coarse") };
        assert_eq!(rounds, [["rest/coarse.sog", "other.sog"]], "one round for all files");
        assert_eq!(of(coarse), 3 + 4);
        let (rounds, OpeningStep::Done(finer)) = fetched(&mut opening, &all) else { panic!("not done") };
        assert_eq!(rounds, [["fine.sog"]]);
        assert!(matches!(finer, Opened::Finer { .. }));
        assert_eq!(of(finer), 9 + 4);
        // What does not fit into the budget stays coarse.
        let mut opening = Opening::new("garden", index.clone(), true, Some(10));
        let coarse = fetched(&mut opening, &all).1;
        assert!(matches!(coarse, OpeningStep::Coarse(_)));
        let (rounds, OpeningStep::Done(finer)) = fetched(&mut opening, &all) else { panic!("not done") };
        assert_eq!((rounds.len(), of(finer)), (0, 7));
        // A name with a folder in it, as of a URL that ends with one.
        let named = FileMap::from([("http://a.b/c/".to_owned(), lod.as_bytes().to_vec())]);
        assert!(matches!(fetched(&mut Opening::new("c", named, true, None), &all).1, OpeningStep::Coarse(_)));
        // The budget is none of a scene that is not streamed.
        let whole = FileMap::from([("fine.sog".to_owned(), all["fine.sog"].clone())]);
        let mut opening = Opening::new("fine.sog", whole, true, Some(5));
        let (_, OpeningStep::Done(whole)) = fetched(&mut opening, &all) else { panic!("not done") };
        assert_eq!(of(whole), 9);
        // Dropped files cannot be fetched.
        let error = Opening::new("garden", index, false, None).go_on(Size::new(64, 40)).unwrap_err();
        assert!(error.starts_with("fine.sog: ") && error.lines().count() == 1, "{error}");
    }
}
