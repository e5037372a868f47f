//! The header that is checked in is that of the sources.

use std::path::Path;
use std::{env, fs};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Set to write the header instead of comparing it.
const WRITE: &str = "GS3_WRITE_HEADER";

/// In the order in which a reader of the header needs them.
const SOURCES: [&str; 10] =
    ["status", "log", "query", "memory", "camera", "pixels", "frame", "scene", "renderer", "reconstructor"];

#[test]
fn the_header_is_that_of_the_sources() {
    let root = Path::new(ROOT);
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).expect("a configuration");
    let mut builder = cbindgen::Builder::new().with_config(config);
    for name in SOURCES {
        builder = builder.with_src(root.join("src").join(name).with_extension("rs"));
    }
    let mut made = Vec::new();
    builder.generate().expect("a header").write(&mut made);
    // The heading that Rust's documents have of what callers see to, in words of C.
    let made = String::from_utf8(made).expect("UTF-8").replace("// # Safety\n", "// What is passed:\n");
    let path = root.join("include/gs3.h");
    if env::var_os(WRITE).is_some() {
        fs::write(&path, &made).expect("include/gs3.h can be written");
    }
    let found = fs::read_to_string(&path).expect("include/gs3.h");
    let difference = made.lines().zip(found.lines()).enumerate().find(|(_, (made, found))| made != found);
    let line =
        difference.map(|(index, (made, found))| format!("line {}: {made:?}, found {found:?}", index + 1));
    assert!(
        made == found,
        "include/gs3.h: expected what cbindgen makes of src; {WRITE}=1 cargo test -p gs3-c --test header writes it; {}",
        line.unwrap_or_else(|| "one is longer".to_owned())
    );
    // All that is exported is declared.
    for name in SOURCES {
        let source = fs::read_to_string(root.join("src").join(name).with_extension("rs")).expect("a source");
        let functions = source.lines().filter_map(|line| line.split_once("extern \"C\" fn gs3_"));
        for (_, rest) in functions {
            let name = rest.split('(').next().unwrap_or_default();
            assert!(made.contains(&format!("gs3_{name}(")), "gs3_{name} is not in the header");
        }
    }
}
