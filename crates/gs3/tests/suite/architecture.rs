//! Keeps the walls between the rooms of ARCHITECTURE.md.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The workspace's root.
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Names of the crates that `package` depends on outside its tests: directly, or over any number of steps.
fn dependencies(package: &str, depth: &str, features: &[&str]) -> BTreeSet<String> {
    let mut command = Command::new(env!("CARGO"));
    command.args(["tree", "--offline", "--package", package, "--edges", "normal,build", "--depth", depth]);
    command.args(features);
    command.args(["--prefix", "none", "--format", "{p}"]).current_dir(ROOT);
    let output = command.output().expect("cargo runs");
    assert!(output.status.success(), "cargo tree: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("names are UTF-8");
    // A line is "name v1.2.3 (path)".
    let mut names: BTreeSet<String> =
        text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
    assert!(names.remove(package), "cargo tree does not show {package} itself: {text}");
    names
}

/// What a user gets who wants no GPU code.
const CPU_ONLY: &[&str] = &["--no-default-features"];

fn direct(package: &str, features: &[&str]) -> BTreeSet<String> {
    dependencies(package, "1", features)
}

fn transitive(package: &str, features: &[&str]) -> BTreeSet<String> {
    dependencies(package, "100", features)
}

/// The crates of this workspace among `names`.
fn ours(names: &BTreeSet<String>) -> Vec<&str> {
    names.iter().map(String::as_str).filter(|n| *n == "gs3" || n.starts_with("gs3-")).collect()
}

#[test]
fn crates_know_only_what_the_map_says() {
    for (package, knows) in [
        ("gs3-files", vec![]),
        ("gs3-scene", vec!["gs3-files"]),
        ("gs3-compute", vec![]),
        ("gs3-simd", vec![]),
        ("gs3-neural", vec!["gs3-files", "gs3-simd"]),
        ("gs3-raster", vec!["gs3-scene", "gs3-simd"]),
        ("gs3-reconstruct", vec!["gs3-scene", "gs3-simd"]),
        ("gs3", vec!["gs3-files", "gs3-neural", "gs3-raster", "gs3-reconstruct", "gs3-scene", "gs3-simd"]),
        ("gs3-video", vec![]),
    ] {
        // Of the kernels' crates the GPU's half knows devices too, and nothing else.
        let with_gpu = transitive(package, &[]);
        let all: Vec<&str> = ours(&with_gpu).into_iter().filter(|name| *name != "gs3-compute").collect();
        assert_eq!(all, knows, "{package}");
        // Without default features nobody knows files.
        let pure: Vec<&str> = knows.into_iter().filter(|name| *name != "gs3-files").collect();
        assert_eq!(ours(&transitive(package, CPU_ONLY)), pure, "{package} without GPU and files");
    }
    // These build on `gs3` and below; nobody but the command builds on them.
    for (package, foreign) in
        [("gs3-evaluate", ["gs3-cli", "gs3-train"]), ("gs3-train", ["gs3-cli", "gs3-evaluate"])]
    {
        let all = transitive(package, &[]);
        assert!(foreign.iter().all(|name| !all.contains(*name)), "{package} knows one of {foreign:?}");
    }
    // Without its window the viewer is a library for any screen.
    let viewer = transitive("gs3-viewer", CPU_ONLY);
    assert_eq!(direct("gs3-viewer", CPU_ONLY).iter().filter(|name| name.starts_with("gs3")).count(), 1);
    for foreign in [
        "gs3-cli",
        "gs3-evaluate",
        "gs3-train",
        "gs3-video",
        "clap",
        "indicatif",
        "rfd",
        "softbuffer",
        "winit",
    ] {
        assert!(!viewer.contains(foreign), "the viewer depends on {foreign}");
    }
    // The C interface is a border around the library, and nothing of its own.
    assert_eq!(ours(&direct("gs3-c", &[])), ["gs3"]);
    assert!(ours(&transitive("xtask", &[])).is_empty(), "errands call gs3, they do not contain it");
    // The Python package is a face of the library: what it lacks is mended there.
    assert_eq!(ours(&direct("gs3-python", &[])), ["gs3", "gs3-evaluate", "gs3-files"]);
}

/// The kernels need arithmetic, threads and, for the times of their stages, a clock; formats, terminals and devices belong elsewhere.
#[test]
fn kernels_stay_light() {
    let allowed: BTreeSet<String> =
        ["fearless_simd", "glam", "gs3-scene", "gs3-simd", "rayon", "thiserror", "thread_local", "web-time"]
            .map(str::to_owned)
            .into();
    for package in ["gs3-raster", "gs3-reconstruct"] {
        let extra: Vec<String> = direct(package, CPU_ONLY).difference(&allowed).cloned().collect();
        assert!(extra.is_empty(), "{package} depends on {extra:?}: say why in ARCHITECTURE.md");
    }
}

/// A library does not draw progress bars, parse arguments or catch signals, and the CPU path needs no driver.
#[test]
fn libraries_know_nothing_of_terminals_and_devices() {
    for package in ["gs3-scene", "gs3-raster", "gs3-reconstruct", "gs3-neural", "gs3"] {
        let all = transitive(package, CPU_ONLY);
        for foreign in ["clap", "indicatif", "ctrlc", "wgpu", "ash", "cudarc"] {
            assert!(!all.contains(foreign), "{package} depends on {foreign}");
        }
    }
    for package in ["gs3-compute", "gs3-evaluate", "gs3-train"] {
        let all = transitive(package, &[]);
        for foreign in ["clap", "indicatif", "ctrlc"] {
            assert!(!all.contains(foreign), "{package} depends on {foreign}");
        }
    }
}

/// Reconstruction sees images and cameras, so that any renderer can call it.
#[test]
fn reconstruction_never_names_a_gaussian() {
    let mut checked = 0;
    let sources = Path::new(ROOT).join("crates/gs3-reconstruct/src");
    for file in files_with(&sources, &["rs", "wgsl"]) {
        for (number, line) in fs::read_to_string(&file).expect("readable").lines().enumerate() {
            let code = line.split("//").next().unwrap_or_default();
            let mut names = code.split(|c: char| !(c.is_alphanumeric() || c == '_'));
            let foreign = names.find(|n| ["Gaussians", "OpacityMode", "Scene", "gs3_raster"].contains(n));
            assert_eq!(foreign, None, "{}:{}: {line}", file.display(), number + 1);
            checked += 1;
        }
    }
    assert!(checked > 500, "only {checked} lines found");
}

/// Code of `file`, without comments and without unit tests, which may name anything.
fn code_of(file: &Path) -> String {
    let text = fs::read_to_string(file).expect("readable");
    // Tests in the file itself are its end; those in a file of their own are a line.
    let end = text.match_indices("#[cfg(test)]\nmod ").find(|(at, _)| {
        let declared = text[*at..].lines().nth(1).unwrap_or_default();
        !declared.ends_with(';')
    });
    let code = &text[..end.map_or(text.len(), |(at, _)| at)];
    code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// The names that follow `crate::` in `code`: of `crate::{a, b::{c}}` a and b.
fn named(code: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for rest in code.split("crate::").skip(1) {
        let is_list = rest.starts_with('{');
        let (mut depth, mut name) = (0, String::new());
        for sign in rest.chars() {
            match sign {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            let is_top = !is_list || depth == 1;
            if is_top && (sign.is_alphanumeric() || sign == '_') {
                name.push(sign);
                continue;
            }
            let ended = std::mem::take(&mut name);
            if !ended.is_empty() {
                names.insert(ended);
            }
            // What follows `a::` in a list is inside a.
            let is_over = !is_list || depth == 0;
            if is_over {
                break;
            }
        }
    }
    names
}

/// The rooms of a crate: its top modules, each with the top modules that its code names.
fn rooms(sources: &Path) -> BTreeMap<String, BTreeSet<String>> {
    let mut rooms = BTreeMap::new();
    for file in files_with(sources, &["rs"]) {
        let inside = file.strip_prefix(sources).expect("a file of the folder").with_extension("");
        let room = inside.iter().next().expect("a name").to_string_lossy().into_owned();
        if inside.iter().any(|part| part == "tests") || room == "lib" || room == "main" {
            continue;
        }
        let mut named = named(&code_of(&file));
        named.remove(&room);
        rooms.entry(room).or_insert_with(BTreeSet::new).extend(named);
    }
    rooms
}

#[test]
fn names_after_crate_are_found() {
    let code = "use crate::a::B;\nuse crate::{c, d::{e, f}, g};\nlet x = crate::h(1) + crate::i::j();";
    let found: Vec<String> = named(code).into_iter().collect();
    assert_eq!(found, ["a", "c", "d", "g", "h", "i"]);
}

/// The top modules of each crate use each other in one direction, as far as their paths begin with `crate::`.
#[test]
fn modules_have_no_circle() {
    let mut seen = 0;
    for members in ["apps", "bindings", "crates", ""] {
        let members = fs::read_dir(Path::new(ROOT).join(members)).expect("a folder");
        for sources in members.map(|member| member.expect("an entry").path().join("src")) {
            if !sources.is_dir() {
                continue;
            }
            let mut rooms = rooms(&sources);
            seen += rooms.len();
            // Rooms that name no other room that is left are below all others. What never gets there is in a circle, or
            // above one.
            loop {
                let is_below = |(room, named): (&String, &BTreeSet<String>)| {
                    named.iter().all(|name| !rooms.contains_key(name)).then(|| room.clone())
                };
                let below: Vec<String> = rooms.iter().filter_map(is_below).collect();
                if below.is_empty() {
                    break;
                }
                rooms.retain(|room, _| !below.contains(room));
            }
            assert!(rooms.is_empty(), "{}: a circle among {rooms:?}", sources.display());
        }
    }
    assert!(seen > 150, "only {seen} modules found");
}

/// Folders that do not name some of the others.
#[test]
fn folders_name_no_foreign_room() {
    for (folder, foreign) in [
        ("apps/gs3/src/cli", vec!["commands", "io"]),
        ("apps/gs3/src/io", vec!["commands"]),
        ("crates/gs3-neural/src/engine", vec!["train"]),
        ("crates/gs3-neural/src/gpu", vec!["train", "engine"]),
        ("crates/gs3-neural/src/graph", vec!["engine", "error", "gpu", "model", "onnx", "train", "weights"]),
        ("crates/gs3-raster/src/cpu", vec!["gpu"]),
        ("crates/gs3-reconstruct/src/cpu", vec!["gpu", "reconstructor"]),
    ] {
        let files = files_with(&Path::new(ROOT).join(folder), &["rs"]);
        assert!(files.len() > 4, "only {} files in {folder}", files.len());
        for file in files {
            let named = named(&code_of(&file));
            let found = foreign.iter().find(|name| named.contains(**name));
            assert_eq!(found, None, "{}", file.display());
        }
    }
}

fn files_with(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files.extend(files_with(&path, extensions));
        } else if path.extension().is_some_and(|e| extensions.iter().any(|extension| e == *extension)) {
            files.push(path);
        }
    }
    files
}
