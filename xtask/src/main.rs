//! Errands of gs3's developers: `cargo xtask`.

mod child;
mod devices;
mod environment;
mod folder;
mod install_c;
mod machine;
mod measure;
mod run;
mod script;
mod table;
mod web;

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Errands of gs3's developers.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask")]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a folder to carry to a GPU machine: gs3, scenes, and run.sh, which measures all of it there
    GpuReport(folder::FolderArgs),
    /// What run.sh calls in such a folder: write report.json and report.md
    Measure(measure::MeasureArgs),
    /// Install the C interface: header, libraries, and what pkg-config reads
    InstallC(install_c::InstallArgs),
    /// Build the viewer's web page, a folder of static files, and serve it
    Web(web::WebArgs),
}

/// Why an errand was not done.
#[derive(Debug, thiserror::Error)]
pub enum XtaskError {
    /// A file or program cannot be used.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file is not JSON of the form expected.
    #[error("{}: {source}", path.display())]
    Json {
        /// Which.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// A program says no.
    #[error("{command}: expected success, found {status}")]
    Failed {
        /// The program with its arguments.
        command: String,
        /// How it ended.
        status: String,
    },
    /// A program that the folder needs is not on this machine.
    #[error("{program}: expected on PATH (binutils have it), found {source}")]
    NoProgram {
        /// Its name.
        program: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// No compiler makes WebAssembly.
    #[error(
        "{target}: expected a compiler for it (rustup target add {target}; or Debian's rustc-web, cargo-web, rust-web-src and \
         lld-22), found none"
    )]
    NoTarget {
        /// What is compiled for.
        target: &'static str,
    },
    /// No compiler has the sources of the standard library, which threads need.
    #[error(
        "{target} with threads: expected a compiler with the sources of the standard library (rustup component add rust-src; or \
         Debian's rustc-web, cargo-web, rust-web-src and lld-22), found none"
    )]
    NoSources {
        /// What is compiled for.
        target: &'static str,
    },
    /// The glue between JavaScript and WebAssembly is not made.
    #[error("{}: {message}", path.display())]
    Glue {
        /// The WebAssembly.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// The port cannot be served.
    #[error("port {port}: expected a free one, found {source}")]
    Port {
        /// The port.
        port: u16,
        /// Why.
        source: io::Error,
    },
    /// This system is none that the errand knows.
    #[error("system: expected {expected}, found {actual}")]
    System {
        /// What is known.
        expected: &'static str,
        /// This one.
        actual: &'static str,
    },
    /// There is no adapter that would be worth measuring.
    #[error("expected {expected}, found {actual}")]
    NoAdapter {
        /// What is wanted.
        expected: String,
        /// All adapters.
        actual: String,
    },
    /// Two things would have one name in the folder.
    #[error("{name}: expected one scene or camera file of this name, found several")]
    Twice {
        /// The name.
        name: String,
    },
    /// Measurements failed; the report says which.
    #[error("{failed} of {all} measurements failed; see report.md")]
    Incomplete {
        /// How many.
        failed: usize,
        /// Of how many.
        all: usize,
    },
}

impl XtaskError {
    fn io(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_path_buf(), source }
    }

    fn json(path: &Path) -> impl Fn(serde_json::Error) -> Self + '_ {
        move |source| Self::Json { path: path.to_path_buf(), source }
    }
}

fn main() -> ExitCode {
    let done = match Args::parse().command {
        Command::GpuReport(args) => folder::make(&args),
        Command::Measure(args) => measure::run(&args),
        Command::InstallC(args) => install_c::install(&args),
        Command::Web(args) => web::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
