//! Memory: bounded lists, and one line where there is none left.

use std::fs;
use std::path::Path;

use super::{gs3, names, png, stderr, succeed};

/// The output under a limit of address space in KiB.
#[cfg(target_os = "linux")]
fn within(kib: u64, folder: &Path, arguments: &str) -> std::process::Output {
    let command = gs3(folder, arguments);
    let script = format!("ulimit -v {kib}; exec \"$@\"");
    let mut limited = std::process::Command::new("sh");
    limited.args(["-c", &script, "sh"]).arg(command.get_program()).args(command.get_args());
    limited.current_dir(folder).env("XDG_RUNTIME_DIR", std::env::temp_dir()).output().unwrap()
}

#[test]
#[cfg(target_os = "linux")]
fn out_of_memory_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // An image of 8192² pixels takes a gibibyte.
    let frame = "render demo --mode native --size 8192x8192 --frames 0..1 --backend cpu --threads 1 --out o";
    let output = within(1 << 20, at, frame);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(75), "{said}");
    assert!(
        said.starts_with("error: memory: expected ") && said.ends_with(" more bytes, found none\n"),
        "{said}"
    );
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(names(at).is_empty(), "{:?}", names(at));

    // 100 million Gaussians of 14 numbers. The file itself takes nothing.
    fs::File::create(at.join("big.splat")).unwrap().set_len(3_200_000_000).unwrap();
    let output = within(4 << 20, at, "info big.splat");
    let expected = "error: big.splat: Gaussians: expected 5600000000 bytes of free memory, found less\n";
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(75), expected));
}

#[test]
fn frames_have_the_same_bits_with_any_memory_for_lists() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (memory, out) in [("", "whole"), ("--memory 1K", "parts")] {
        succeed(at, &format!("render demo --size 320x180 --frames 0..3 --backend cpu {memory} --out {out}"));
    }
    assert_eq!(names(&at.join("whole")).len(), 7);
    for name in names(&at.join("whole")) {
        assert!(png(&at.join("whole").join(&name)) == png(&at.join("parts").join(&name)), "{name}");
    }
    let output = gs3(at, "render demo --memory 5T --out o").output().unwrap();
    assert!(
        stderr(&output).contains("--memory: expected bytes, or a number with K, M or G, found 5T"),
        "{}",
        stderr(&output)
    );
}
