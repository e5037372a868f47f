//! `cargo xtask web`: the viewer as a folder of static files, and a server for it.

mod serve;
mod toolchain;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;

use wasm_bindgen_cli_support::Bindgen;

use crate::XtaskError;
use crate::folder::copy;
use toolchain::Toolchain;

/// The workspace.
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// What the page has besides the WebAssembly and its glue.
const FILES: [&str; 5] = ["index.html", "page.js", "gs3.js", "gs3.d.ts", "worker.js"];

/// What is compiled for.
const TARGET: &str = "wasm32-unknown-unknown";

/// WebAssembly's vectors, which all browsers of this decade have, and bulk copies.
const RUSTFLAGS: &str = "-C target-feature=+simd128,+bulk-memory";

/// Memory that workers share, imported by each of them. Such memory has a largest size from the start: the 4 GiB that a page can
/// address at most. The exports are where wasm-bindgen gives each worker its thread's own variables.
const RUSTFLAGS_OF_THREADS: &str = "-C target-feature=+simd128,+bulk-memory,+atomics -C link-arg=--shared-memory \
    -C link-arg=--import-memory -C link-arg=--max-memory=4294967296 -C link-arg=--export=__wasm_init_tls \
    -C link-arg=--export=__tls_size -C link-arg=--export=__tls_align -C link-arg=--export=__tls_base";

/// The folder of the page that has the module for several threads.
const THREADS: &str = "threads";

/// The module that says what was built.
const BUILT: &str = "built.js";

/// Arguments of `web`.
#[derive(Debug, clap::Args)]
pub struct WebArgs {
    /// Where the page goes; the folder is made if it does not exist
    #[arg(long, value_name = "DIR", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/web"))]
    pub out: PathBuf,
    /// Also build for all cores: pages isolated from others then render on them. This needs the sources of the standard library
    #[arg(long)]
    pub threads: bool,
    /// Serve the page on this port of the loopback, 0 for any free one, until the program is ended
    #[arg(long, value_name = "PORT")]
    pub serve: Option<u16>,
    /// Serve what was built before
    #[arg(long, requires = "serve")]
    pub no_build: bool,
}

/// Builds the page, and serves it if that is asked for.
pub fn run(args: &WebArgs) -> Result<(), XtaskError> {
    if !args.no_build {
        build(&args.out, args.threads)?;
    }
    match args.serve {
        Some(port) => serve::serve(&args.out, port),
        None => Ok(()),
    }
}

fn build(out: &Path, has_threads: bool) -> Result<(), XtaskError> {
    fs::create_dir_all(out).map_err(XtaskError::io(out))?;
    module(out, false)?;
    let threads = out.join(THREADS);
    match fs::remove_dir_all(&threads) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(XtaskError::io(&threads)(error)),
        _ => {}
    }
    if has_threads {
        module(&threads, true)?;
    }
    for name in FILES {
        copy(&Path::new(ROOT).join("apps/viewer/page").join(name), &out.join(name))?;
    }
    let built = format!(
        "// Whether threads/ has a module for several threads.\nexport const hasThreads = {has_threads};\n"
    );
    fs::write(out.join(BUILT), built).map_err(XtaskError::io(&out.join(BUILT)))
}

/// Builds the module of the page and its glue into `out`, for one thread or for several.
///
/// Each is compiled by itself. With atomics the futures of js-sys wait by `Atomics.waitAsync`, which takes shared memory alone, so the
/// module for several threads does not serve pages without such memory.
fn module(out: &Path, has_threads: bool) -> Result<(), XtaskError> {
    let toolchain = Toolchain::find(has_threads)?;
    eprintln!("{TARGET}: {toolchain}");
    let (flags, features) = match has_threads {
        false => (RUSTFLAGS, "page"),
        true => (RUSTFLAGS_OF_THREADS, "threads"),
    };
    // Apart from other builds, whose compiler may be another one. Both modules share the macros and build scripts of the host.
    let target = Path::new(ROOT).join("target/web-build");
    let mut cargo: Command = toolchain.cargo();
    cargo.current_dir(ROOT).env("RUSTFLAGS", flags).env("CARGO_TARGET_DIR", &target).args([
        "rustc",
        "--locked",
        "--package",
        "gs3-viewer",
        "--lib",
        "--crate-type",
        "cdylib",
        "--profile",
        "web",
        "--no-default-features",
        "--features",
        features,
        "--target",
        TARGET,
    ]);
    cargo.args(toolchain.arguments());
    crate::folder::succeed(&mut cargo)?;

    let wasm = target.join(TARGET).join("web/gs3_viewer.wasm");
    let glue = |error: anyhow::Error| XtaskError::Glue { path: wasm.clone(), message: format!("{error:#}") };
    let mut bindgen = Bindgen::new();
    bindgen.input_path(&wasm).typescript(false).remove_name_section(true).remove_producers_section(true);
    bindgen.web(true).map_err(glue)?;
    bindgen.generate(out).map_err(glue)?;
    let whole = out.join("gs3_viewer_bg.wasm");
    let bytes = fs::metadata(&whole).map_err(XtaskError::io(&whole))?.len();
    eprintln!("{}: the page, {:.1} MB of WebAssembly", out.display(), bytes as f64 / 1e6);
    Ok(())
}
