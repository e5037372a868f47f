//! `cargo xtask install-c`: the C interface where C programs look for libraries.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::XtaskError;
use crate::folder::{cargo, copy};

/// The crate of the C interface.
const CRATE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../bindings/c");

/// The version of all crates.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What a program links besides the static library, in this order: `rustc --print native-static-libs` of the crate on Linux.
const PRIVATE_LIBS: &str = "-lgcc_s -lutil -lrt -lpthread -lm -ldl -lc";

/// Builds both libraries. Without the third crate type, which tests need, as cargo optimises at link time only where all
/// types can be.
const BUILD: [&str; 8] =
    ["rustc", "--release", "--locked", "--package", "gs3-c", "--lib", "--crate-type", "cdylib,staticlib"];

/// Arguments of `install-c`.
#[derive(Debug, clap::Args)]
pub struct InstallArgs {
    /// Where include, lib and lib/pkgconfig are, as /usr/local; it is made if it does not exist
    pub prefix: PathBuf,
    /// A folder with the libraries, built already; without it they are built in release
    #[arg(long, value_name = "DIR")]
    pub from: Option<PathBuf>,
}

/// Installs header, libraries and what pkg-config reads.
pub fn install(args: &InstallArgs) -> Result<(), XtaskError> {
    if std::env::consts::OS != "linux" {
        return Err(XtaskError::System { expected: "Linux", actual: std::env::consts::OS });
    }
    let from = match &args.from {
        Some(from) => from.clone(),
        None => {
            cargo(&BUILD)?;
            // Beside this program, as both are built in release.
            let own = std::env::current_exe().map_err(XtaskError::io(Path::new("xtask")))?;
            own.parent().unwrap_or(Path::new("")).to_owned()
        }
    };
    fs::create_dir_all(&args.prefix).map_err(XtaskError::io(&args.prefix))?;
    // Programs are built in any folder.
    let prefix = args.prefix.canonicalize().map_err(XtaskError::io(&args.prefix))?;
    let (crate_folder, lib) = (Path::new(CRATE), prefix.join("lib"));
    place(&crate_folder.join("include/gs3.h"), &prefix.join("include/gs3.h"))?;
    place(&from.join("libgs3_c.a"), &lib.join("libgs3.a"))?;
    let whole = format!("libgs3.so.{VERSION}");
    place(&from.join("libgs3_c.so"), &lib.join(&whole))?;
    // Programs look for the name that the library was linked with, linkers for the one without a number.
    let major = VERSION.split('.').next().unwrap_or(VERSION);
    for link in [format!("libgs3.so.{major}"), "libgs3.so".to_owned()] {
        place_link(&whole, &lib.join(link))?;
    }
    let template = crate_folder.join("gs3.pc.in");
    let text = fs::read_to_string(&template).map_err(XtaskError::io(&template))?;
    let to = lib.join("pkgconfig/gs3.pc");
    fs::create_dir_all(lib.join("pkgconfig")).map_err(XtaskError::io(&lib))?;
    fs::write(&to, filled(&text, &prefix)).map_err(XtaskError::io(&to))?;
    eprintln!("{}: header, libraries and lib/pkgconfig/gs3.pc of gs3 {VERSION}", prefix.display());
    Ok(())
}

/// The template of gs3.pc for `prefix`; comments are for its readers.
fn filled(template: &str, prefix: &Path) -> String {
    let lines = template.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let line = line.replace("@prefix@", &prefix.display().to_string());
        line.replace("@version@", VERSION).replace("@private_libs@", PRIVATE_LIBS) + "\n"
    });
    lines.collect()
}

/// Copies a file. One that is there is replaced, not written into: programs may run with it.
fn place(from: &Path, to: &Path) -> Result<(), XtaskError> {
    remove(to)?;
    copy(from, to)
}

fn remove(file: &Path) -> Result<(), XtaskError> {
    match fs::remove_file(file) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(XtaskError::io(file)(error)),
        _ => Ok(()),
    }
}

#[cfg(unix)]
fn place_link(target: &str, link: &Path) -> Result<(), XtaskError> {
    remove(link)?;
    std::os::unix::fs::symlink(target, link).map_err(XtaskError::io(link))
}

#[cfg(not(unix))]
fn place_link(_: &str, link: &Path) -> Result<(), XtaskError> {
    Err(XtaskError::io(link)(ErrorKind::Unsupported.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_where_programs_look_for_it_twice_in_a_row() {
        let folder = tempfile::tempdir().unwrap();
        let [from, prefix] = ["built", "prefix"].map(|name| folder.path().join(name));
        fs::create_dir(&from).unwrap();
        let args = InstallArgs { prefix: prefix.clone(), from: Some(from.clone()) };
        assert!(matches!(install(&args), Err(XtaskError::Io { .. })), "there is nothing to install");
        for content in ["old", "new"] {
            for name in ["libgs3_c.so", "libgs3_c.a"] {
                fs::write(from.join(name), content).unwrap();
            }
            install(&args).unwrap();
            for name in ["libgs3.so", "libgs3.so.0", "libgs3.a"] {
                assert_eq!(fs::read_to_string(prefix.join("lib").join(name)).unwrap(), content, "{name}");
            }
        }
        let header = fs::read_to_string(prefix.join("include/gs3.h")).unwrap();
        assert!(header.contains("gs3_renderer_create"));
        let text = fs::read_to_string(prefix.join("lib/pkgconfig/gs3.pc")).unwrap();
        let prefix = prefix.canonicalize().unwrap();
        assert!(text.starts_with(&format!("prefix={}\n", prefix.display())), "{text}");
        assert!(text.contains(&format!("\nVersion: {VERSION}\n")), "{text}");
        assert!(!text.contains('@'), "{text}");
    }
}
