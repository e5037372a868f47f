//! The places of Vulkan's loader and driver on the measured machine, passed to `gs3` as variables. Machines for
//! computing may have a driver, but lack the loader, the parts of X11 that the driver needs, or a file that names the
//! driver.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

/// Where Linux systems keep libraries.
pub const SYSTEM: [&str; 3] = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64"];

/// Where the folder keeps its libraries.
pub const CARRIED: &str = "lib";

/// Names NVIDIA's driver by its library for EGL, which needs nothing of X11, as its usual one does.
pub const EGL_DRIVER: &str = "nvidia_egl.json";
pub const EGL_DRIVER_TEXT: &str = r#"{"file_format_version":"1.0.1","ICD":{"library_path":"libEGL_nvidia.so.0","api_version":"1.3.0"}}
"#;

/// Where the loader looks for files that name drivers.
const DRIVER_FILES: [&str; 3] =
    ["/etc/vulkan/icd.d", "/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];

/// Variables that name such a file: the second is what loaders before 1.3.207 read, which newer ones do if the first is
/// not set.
const DRIVER_VARIABLES: [&str; 2] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];

/// Where container platforms mount NVIDIA's driver; the loader does not look there.
const MOUNTED: &str = "/usr/local/nvidia";

/// Variables that differ from this process's variables.
pub type Environment = BTreeMap<&'static str, OsString>;

/// The environment that finds the driver of the machine with its files below `root`. `folder` is the folder that was
/// carried there; `set` gives the variables that are set.
pub fn of(root: &Path, folder: &Path, set: impl Fn(&str) -> Option<OsString>) -> Environment {
    let set = |name: &str| set(name).filter(|value| !value.is_empty());
    let mut environment = Environment::new();
    // Mesa's layer of device selection complains without the first; by the second the loader says why it leaves a
    // driver out.
    for (name, value) in [("XDG_RUNTIME_DIR", "/tmp"), ("VK_LOADER_DEBUG", "error")] {
        if set(name).is_none() {
            environment.insert(name, value.into());
        }
    }
    // What is carried comes last: the system's own goes with its driver.
    let mut libraries: Vec<OsString> = set("LD_LIBRARY_PATH").into_iter().collect();
    libraries.extend(SYSTEM.map(OsString::from));
    libraries.extend(["lib64", "lib"].map(|name| Path::new(MOUNTED).join(name).into_os_string()));
    libraries.push(folder.join(CARRIED).into_os_string());
    environment.insert("LD_LIBRARY_PATH", libraries.join(OsStr::new(":")));
    let named = DRIVER_VARIABLES.iter().any(|name| set(name).is_some());
    let known = DRIVER_FILES.iter().any(|place| driver_file(&below(root, place)).is_some());
    if let (false, false, Some(file)) = (named, known, driver_file(&below(root, MOUNTED))) {
        name_driver(&mut environment, &file);
    }
    environment
}

/// The same with NVIDIA's driver for EGL alone.
pub fn with_egl(environment: &Environment, folder: &Path) -> Environment {
    let mut environment = environment.clone();
    name_driver(&mut environment, &folder.join(EGL_DRIVER));
    environment
}

fn name_driver(environment: &mut Environment, file: &Path) {
    environment.extend(DRIVER_VARIABLES.map(|name| (name, file.into())));
}

/// The first file below `folder` that names NVIDIA's driver, by its usual names: nvidia_icd.json,
/// nvidia_icd.x86_64.json.
fn driver_file(folder: &Path) -> Option<PathBuf> {
    let mut entries: Vec<_> = fs::read_dir(folder).ok()?.flatten().collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    entries.into_iter().find_map(|entry| {
        let path = entry.path();
        // Of the entry itself: links are not followed, which may lead in circles.
        if entry.file_type().is_ok_and(|it| it.is_dir()) {
            return driver_file(&path);
        }
        let name = entry.file_name();
        let name = name.to_string_lossy();
        (name.starts_with("nvidia_icd") && name.ends_with(".json")).then_some(path)
    })
}

fn below(root: &Path, path: &str) -> PathBuf {
    root.join(path.trim_start_matches('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOUNTED_FILE: &str = "/usr/local/nvidia/share/vulkan/icd.d/nvidia_icd.json";

    fn root_with(files: &[&str]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for file in files.iter().map(|file| below(root.path(), file)) {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "{}").unwrap();
        }
        root
    }

    /// The file that drivers are named by.
    fn driver(files: &[&str], set: &[(&str, &str)]) -> Option<PathBuf> {
        let root = root_with(files);
        let set = |name: &str| set.iter().find(|(it, _)| *it == name).map(|(_, value)| (*value).into());
        let environment = of(root.path(), Path::new("/carried"), set);
        let [new, old] = DRIVER_VARIABLES.map(|name| environment.get(name));
        assert_eq!(new, old);
        new.map(|file| Path::new("/").join(Path::new(file).strip_prefix(root.path()).unwrap()))
    }

    #[test]
    fn a_mounted_driver_is_named_where_the_loader_would_not_find_one() {
        let other = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json";
        let library = "/usr/local/nvidia/lib64/libGLX_nvidia.so.0";
        assert_eq!(driver(&[MOUNTED_FILE, other, library], &[]), Some(MOUNTED_FILE.into()));
        assert_eq!(driver(&[MOUNTED_FILE], &[("VK_ICD_FILENAMES", "")]), Some(MOUNTED_FILE.into()));
        let elsewhere = "/usr/local/nvidia/vulkan/icd.d/nvidia_icd.x86_64.json";
        assert_eq!(driver(&[elsewhere], &[]), Some(elsewhere.into()));
        assert_eq!(driver(&[other, library], &[]), None);
        assert_eq!(driver(&[], &[]), None);
    }

    #[test]
    fn what_the_loader_finds_itself_stays() {
        for place in DRIVER_FILES {
            let own = format!("{place}/nvidia_icd.x86_64.json");
            assert_eq!(driver(&[MOUNTED_FILE, &own], &[]), None, "{own}");
        }
        for name in DRIVER_VARIABLES {
            assert_eq!(driver(&[MOUNTED_FILE], &[(name, "/mine.json")]), None, "{name}");
        }
    }

    #[test]
    fn libraries_are_those_set_then_the_systems_then_mounted_then_carried() {
        let libraries = |set: Option<&str>| {
            let set = |name: &str| (name == "LD_LIBRARY_PATH").then_some(set?.into());
            of(root_with(&[]).path(), Path::new("/carried"), set)["LD_LIBRARY_PATH"].clone()
        };
        let rest = "/usr/lib/x86_64-linux-gnu:/usr/lib/aarch64-linux-gnu:/usr/lib64:/usr/local/nvidia/lib64:\
                    /usr/local/nvidia/lib:/carried/lib";
        assert_eq!(libraries(None), rest);
        // An empty name between colons would mean the working directory.
        assert_eq!(libraries(Some("")), rest);
        assert_eq!(libraries(Some("/mine")).to_str().unwrap(), format!("/mine:{rest}"));
    }

    #[test]
    fn what_is_set_stays() {
        let root = root_with(&[]);
        let environment = of(root.path(), Path::new("/carried"), |_| None);
        assert_eq!(
            (&environment["XDG_RUNTIME_DIR"], &environment["VK_LOADER_DEBUG"]),
            (&"/tmp".into(), &"error".into())
        );
        let environment = of(root.path(), Path::new("/carried"), |_| Some("mine".into()));
        assert_eq!(environment.keys().collect::<Vec<_>>(), [&"LD_LIBRARY_PATH"]);
    }

    #[test]
    fn the_driver_for_egl_takes_the_place_of_any_other() {
        let root = root_with(&[MOUNTED_FILE]);
        let before = of(root.path(), Path::new("/carried"), |_| None);
        let egl = with_egl(&before, Path::new("/carried"));
        assert!(DRIVER_VARIABLES.iter().all(|name| egl[name] == "/carried/nvidia_egl.json"), "{egl:?}");
        assert_eq!(egl["LD_LIBRARY_PATH"], before["LD_LIBRARY_PATH"]);
        let file: serde_json::Value = serde_json::from_str(EGL_DRIVER_TEXT).unwrap();
        assert_eq!(file["ICD"]["library_path"], "libEGL_nvidia.so.0");
    }
}
