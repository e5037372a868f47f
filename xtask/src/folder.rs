//! `cargo xtask gpu-report`: one folder that holds all that a measurement needs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::XtaskError;
use crate::environment::{CARRIED, EGL_DRIVER, EGL_DRIVER_TEXT, SYSTEM};
use crate::script;

/// What is measured, in the folder.
pub const SUBJECTS: &str = "subjects.json";

/// Libraries that machines which only compute may lack, under the names by which they are opened: Vulkan's loader, what
/// NVIDIA's usual driver needs of X11, though nothing is shown, and what libXdmcp needs on some distributions.
const LIBRARIES: [&str; 8] = [
    "libvulkan.so.1",
    "libX11.so.6",
    "libXext.so.6",
    "libxcb.so.1",
    "libXau.so.6",
    "libXdmcp.so.6",
    "libbsd.so.0",
    "libmd.so.0",
];

/// Arguments of `gpu-report`.
#[derive(Debug, clap::Args)]
pub struct FolderArgs {
    /// Scenes, files or folders, each with its cameras where there are any; `demo` is the built-in one
    #[arg(required = true, value_name = "SCENE[=CAMERAS]")]
    pub subjects: Vec<Subject>,
    /// The folder; it must not exist
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// A scene to measure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subject {
    /// A path, or `demo`.
    pub scene: PathBuf,
    /// A path.
    pub cameras: Option<PathBuf>,
}

impl FromStr for Subject {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text.split_once('=') {
            Some((scene, cameras)) => Self { scene: scene.into(), cameras: Some(cameras.into()) },
            None => Self { scene: text.into(), cameras: None },
        })
    }
}

/// Makes the folder.
pub fn make(args: &FolderArgs) -> Result<(), XtaskError> {
    let own = std::env::current_exe().map_err(XtaskError::io(Path::new("xtask")))?;
    // Beside this program, as both are built in release.
    let gs3 = own.with_file_name("gs3");
    cargo(&["build", "--release", "--locked", "--package", "gs3-cli"])?;
    let out = &args.out;
    fs::create_dir(out).map_err(XtaskError::io(out))?;
    let mut glibc = None;
    for program in [&gs3, &own] {
        let to = out.join(program.file_name().unwrap_or_default());
        copy(program, &to)?;
        strip("strip", &to)?;
        let bytes = fs::read(&to).map_err(XtaskError::io(&to))?;
        glibc = glibc.max(script::newest_glibc(&bytes));
    }
    carry_libraries(out)?;
    let subjects = args.subjects.iter().map(|s| carried(s, out)).collect::<Result<Vec<_>, _>>()?;
    let list = out.join(SUBJECTS);
    let text = serde_json::to_string_pretty(&subjects).map_err(XtaskError::json(&list))?;
    fs::write(&list, text).map_err(XtaskError::io(&list))?;
    let script = out.join("run.sh");
    fs::write(&script, script::text(glibc)).map_err(XtaskError::io(&script))?;
    // Programs are executable; so shall be what starts them.
    let permissions = fs::metadata(&own).map_err(XtaskError::io(&own))?.permissions();
    fs::set_permissions(&script, permissions).map_err(XtaskError::io(&script))?;
    let egl = out.join(EGL_DRIVER);
    fs::write(&egl, EGL_DRIVER_TEXT).map_err(XtaskError::io(&egl))?;
    eprintln!("{}: carry it to the GPU machine and call run.sh there", out.display());
    Ok(())
}

/// Copies the libraries that this machine has.
fn carry_libraries(out: &Path) -> Result<(), XtaskError> {
    let mut missing = Vec::new();
    for name in LIBRARIES {
        match SYSTEM.iter().map(|folder| Path::new(folder).join(name)).find(|file| file.exists()) {
            Some(file) => copy(&file, &out.join(CARRIED).join(name))?,
            None => missing.push(name),
        }
    }
    if !missing.is_empty() {
        eprintln!("not carried, since not here: {}; the GPU machine may have its own", missing.join(", "));
    }
    Ok(())
}

/// Takes the symbols out of `program`: half of its size are line tables. Binutils do it, which have the linker, too;
/// cargo would optimise and link all of gs3 once more for it, and leave a program without line tables where others
/// expect theirs.
fn strip(tool: &'static str, program: &Path) -> Result<(), XtaskError> {
    let status = Command::new(tool).arg(program).status();
    let status = status.map_err(|source| XtaskError::NoProgram { program: tool, source })?;
    match status.success() {
        true => Ok(()),
        false => Err(XtaskError::Failed {
            command: format!("{tool} {}", program.display()),
            status: status.to_string(),
        }),
    }
}

/// Copies `subject` into the folder `out`; paths of the result are relative to it.
fn carried(subject: &Subject, out: &Path) -> Result<Subject, XtaskError> {
    let carry = |from: &Path, kind: &str| {
        let to = Path::new(kind).join(from.file_name().unwrap_or_default());
        match out.join(&to).exists() {
            true => Err(XtaskError::Twice { name: to.display().to_string() }),
            false => copy(from, &out.join(&to)).map(|()| to),
        }
    };
    let scene = match subject.scene.as_os_str() == "demo" {
        true => subject.scene.clone(),
        false => carry(&subject.scene, "scenes")?,
    };
    let cameras = subject.cameras.as_ref().map(|cameras| carry(cameras, "paths")).transpose()?;
    Ok(Subject { scene, cameras })
}

/// Copies a file, or a folder with all that is in it.
pub fn copy(from: &Path, to: &Path) -> Result<(), XtaskError> {
    if from.is_dir() {
        for entry in fs::read_dir(from).map_err(XtaskError::io(from))? {
            let entry = entry.map_err(XtaskError::io(from))?;
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
        return Ok(());
    }
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).map_err(XtaskError::io(folder))?;
    }
    fs::copy(from, to).map(|_| ()).map_err(XtaskError::io(from))
}

/// Runs cargo.
pub fn cargo(arguments: &[&str]) -> Result<(), XtaskError> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    succeed(Command::new(cargo).args(arguments))
}

/// Runs `command` to its end, which is to be a success.
pub fn succeed(command: &mut Command) -> Result<(), XtaskError> {
    let program = command.get_program().to_owned();
    let status = command.status().map_err(XtaskError::io(Path::new(&program)))?;
    match status.success() {
        true => Ok(()),
        false => {
            let words = std::iter::once(command.get_program()).chain(command.get_args());
            let words: Vec<_> = words.map(|word| word.to_string_lossy()).collect();
            Err(XtaskError::Failed { command: words.join(" "), status: status.to_string() })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_and_cameras_are_carried_once() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        fs::create_dir_all(at.join("from/garden/1_0")).unwrap();
        fs::write(at.join("from/garden/1_0/means.webp"), "means").unwrap();
        fs::write(at.join("from/orbit.json"), "orbit").unwrap();
        let out = at.join("out");
        let text = format!("{0}/from/garden={0}/from/orbit.json", at.display());
        let carried_subject = carried(&text.parse().unwrap(), &out).unwrap();
        let expected = Subject { scene: "scenes/garden".into(), cameras: Some("paths/orbit.json".into()) };
        assert_eq!(carried_subject, expected);
        assert_eq!(fs::read_to_string(out.join("scenes/garden/1_0/means.webp")).unwrap(), "means");
        assert_eq!(fs::read_to_string(out.join("paths/orbit.json")).unwrap(), "orbit");
        let again = carried(&text.parse().unwrap(), &out);
        assert!(matches!(again, Err(XtaskError::Twice { .. })), "{again:?}");
        let demo: Subject = "demo".parse().unwrap();
        assert_eq!(carried(&demo, &out).unwrap(), demo);
        let missing = carried(&"nowhere.ply".parse().unwrap(), &out);
        assert!(matches!(missing, Err(XtaskError::Io { .. })), "{missing:?}");
    }

    #[test]
    fn programs_that_cannot_be_stripped_are_not_carried_in_silence() {
        let folder = tempfile::tempdir().unwrap();
        let absent = strip("no-such-strip", folder.path());
        assert!(matches!(absent, Err(XtaskError::NoProgram { program: "no-such-strip", .. })), "{absent:?}");
        // It fails with any arguments.
        let failed = strip("false", folder.path());
        assert!(matches!(failed, Err(XtaskError::Failed { .. })), "{failed:?}");
    }
}
