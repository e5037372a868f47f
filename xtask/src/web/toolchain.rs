//! A compiler for WebAssembly: one with the target, or one that builds the standard library for it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::TARGET;
use crate::XtaskError;

/// Where Debian's packages `rustc-web` and `cargo-web` are, beside a compiler that comes first on PATH.
const DEBIAN: &str = "/usr/bin";

/// Names that Debian's packages `lld-*` give the linker, the newest first. A rustup toolchain has its own linker.
const LINKERS: [&str; 6] = ["wasm-ld", "wasm-ld-22", "wasm-ld-21", "wasm-ld-20", "wasm-ld-19", "wasm-ld-18"];

/// How WebAssembly is compiled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Toolchain {
    cargo: PathBuf,
    rustc: PathBuf,
    std: Std,
}

/// Where the standard library comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Std {
    /// It is there, compiled.
    Installed,
    /// It is compiled from the compiler's sources, and linked by this; by the compiler's own linker if this is none.
    Built { linker: Option<PathBuf> },
}

impl fmt::Display for Toolchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let std = match self.std {
            Std::Installed => "with its standard library",
            Std::Built { .. } => "which builds the standard library from its sources",
        };
        write!(f, "{} {std}", self.rustc.display())
    }
}

impl Toolchain {
    /// The compiler on PATH, or else Debian's. An installed standard library has no atomics, so `with_threads` takes one that is
    /// built.
    ///
    /// # Errors
    /// [`XtaskError::NoTarget`] if neither compiles WebAssembly, [`XtaskError::NoSources`] if neither can build its standard library.
    pub fn find(with_threads: bool) -> Result<Self, XtaskError> {
        let places = [PathBuf::new(), PathBuf::from(DEBIAN)];
        let found = places
            .iter()
            .find_map(|place| Self::at(&place.join("cargo"), &place.join("rustc"), with_threads));
        found.ok_or(match with_threads {
            true => XtaskError::NoSources { target: TARGET },
            false => XtaskError::NoTarget { target: TARGET },
        })
    }

    fn at(cargo: &Path, rustc: &Path, with_threads: bool) -> Option<Self> {
        let told = |what: &[&str]| {
            let output = Command::new(rustc).args(what).output().ok()?;
            let text = String::from_utf8(output.stdout).ok()?;
            output.status.success().then(|| PathBuf::from(text.trim()))
        };
        let of = |std| Some(Self { cargo: cargo.to_owned(), rustc: rustc.to_owned(), std });
        let is_installed = told(&["--print", "target-libdir", "--target", TARGET])?.is_dir();
        if is_installed && !with_threads {
            return of(Std::Installed);
        }
        let sources = told(&["--print", "sysroot"])?.join("lib/rustlib/src/rust/library/std");
        let linker =
            LINKERS.into_iter().find(|linker| Command::new(linker).arg("--version").output().is_ok());
        // A compiler that comes with the target comes with its linker.
        (sources.is_dir() && (is_installed || linker.is_some()))
            .then(|| of(Std::Built { linker: linker.map(PathBuf::from) }))?
    }

    /// Cargo of this toolchain.
    pub fn cargo(&self) -> Command {
        let mut command = Command::new(&self.cargo);
        // What a cargo that runs this program says of itself is of no use to another.
        for name in ["CARGO", "RUSTUP_TOOLCHAIN", "RUSTC_WRAPPER"] {
            command.env_remove(name);
        }
        command.env("RUSTC", &self.rustc);
        if let Std::Built { linker } = &self.std {
            // Building the standard library is an unstable feature of cargo, which stable compilers allow by this name alone.
            command.env("RUSTC_BOOTSTRAP", "1");
            if let Some(linker) = linker {
                command.env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER", linker);
            }
        }
        command
    }

    /// Further arguments for cargo.
    pub fn arguments(&self) -> &'static [&'static str] {
        match self.std {
            Std::Installed => &[],
            Std::Built { .. } => &["-Zbuild-std=std,panic_abort"],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_compiler_that_is_none_is_not_taken() {
        assert_eq!(Toolchain::at(Path::new("cargo"), Path::new("/none/rustc"), false), None);
        // `false` says nothing and fails.
        assert_eq!(Toolchain::at(Path::new("cargo"), Path::new("false"), true), None);
    }
}
