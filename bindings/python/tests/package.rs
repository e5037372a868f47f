//! Runs pytest: on the package, laid out as pip does with the library that cargo built, and on the farm, which uses it. Python is
//! what `GS3_PYTHON` names, else `python3`; it needs NumPy and pytest.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::{env, fs};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// One after the other: some tests tell times.
fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The folder where cargo puts libraries, and above it programs.
fn built() -> PathBuf {
    env::current_exe().expect("a path").parent().expect("a folder").to_owned()
}

/// The package's folder is in here, for `PYTHONPATH`.
fn site() -> &'static Path {
    static SITE: OnceLock<PathBuf> = OnceLock::new();
    SITE.get_or_init(|| {
        let site = Path::new(env!("CARGO_TARGET_TMPDIR")).join("site");
        let package = site.join("gs3");
        if package.exists() {
            fs::remove_dir_all(&package).expect("a folder that can be removed");
        }
        fs::create_dir_all(&package).expect("a folder");
        for entry in fs::read_dir(Path::new(ROOT).join("python/gs3")).expect("the sources") {
            let file = entry.expect("a file").path();
            if file.is_file() {
                fs::copy(&file, package.join(file.file_name().expect("a name"))).expect("a copy");
            }
        }
        let library = ["lib_gs3.so", "lib_gs3.dylib"].map(|name| built().join(name));
        let library = library.iter().find(|file| file.is_file()).expect("cargo builds it for this test");
        fs::copy(library, package.join("_gs3.abi3.so")).expect("a copy");
        site
    })
}

/// Runs the tests in `folder`, a path from the package's sources.
fn pytest(folder: &str) {
    let _turn = turn();
    let python = env::var_os("GS3_PYTHON").unwrap_or_else(|| "python3".into());
    let has_all = Command::new(&python).args(["-c", "import numpy, pytest"]).output();
    if !has_all.is_ok_and(|output| output.status.success()) {
        println!("skipped: {} with NumPy and pytest, which test the Python package", python.display());
        return;
    }
    let mut command = Command::new(&python);
    command.args(["-m", "pytest", "-q", "-rfEs", "-p", "no:cacheprovider", "--color=no"]);
    command.arg(Path::new(ROOT).join(folder)).env("PYTHONPATH", site()).env("PYTHONDONTWRITEBYTECODE", "1");
    // The command of the same build, where the whole workspace is tested.
    let gs3 = built().parent().expect("a folder").join(format!("gs3{}", env::consts::EXE_SUFFIX));
    if gs3.is_file() {
        command.env("GS3", gs3);
    }
    let output = command.output().expect("a program that has just run");
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "pytest {folder}: {}", output.status);
}

#[test]
fn the_package() {
    pytest("tests");
}

#[test]
fn the_farm() {
    pytest("../../farm/tests");
}
