//! Folders that others write to at the same time, and folders that nobody may write to.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use super::{gs3, names, refused, stderr, succeed};

const RENDER: &str = "render demo --size 64x36 --frames 0..6 --tier analytic --backend cpu --threads 1";

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    names(folder).into_iter().map(|name| (name.clone(), fs::read(folder.join(&name)).unwrap())).collect()
}

#[test]
fn processes_that_write_the_same_files_leave_whole_ones() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, &format!("{RENDER} --out alone"));
    succeed(at, "convert demo alone.spz");
    for command in [format!("{RENDER} --out o"), "convert demo o.spz".to_owned()] {
        let start = || gs3(at, &command).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let running: Vec<_> = (0..3).map(|_| start()).collect();
        for child in running {
            let output = child.wait_with_output().unwrap();
            assert!(output.status.success(), "{command}: {}", stderr(&output));
        }
    }
    assert_eq!(files(&at.join("o")), files(&at.join("alone")));
    assert_eq!(fs::read(at.join("o.spz")).unwrap(), fs::read(at.join("alone.spz")).unwrap());
    assert_eq!(names(at), ["alone", "alone.spz", "o", "o.spz"], "something is left over");
}

/// Root writes wherever it likes, except where the system has no files of its own.
#[test]
#[cfg(target_os = "linux")]
fn folders_that_cannot_be_written_are_told_before_the_work() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let locked = at.join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    let is_root = fs::write(locked.join("try"), "").is_ok();
    // Files of the kernel can be made by nobody.
    let place = if is_root { "/proc/sys" } else { "locked" };
    for command in [
        format!("{RENDER} --out {place}/o"),
        format!("{RENDER} --out {place}/o.mp4"),
        format!("render demo --size 64x36 --mode native --out {place}/o.png"),
        format!("convert demo {place}/o.spz"),
        format!("convert demo {place}/o/lod-meta.json"),
        format!("gbuffer demo --size 64x36 --out {place}/o.npz"),
        format!("simplify demo --keep 0.5 --out {place}/o.ply"),
    ] {
        let said = refused(&mut gs3(at, &command));
        assert!(said.starts_with(&format!("error: {place}/o")), "{command}: {said}");
        assert!(said.contains("cannot be written: "), "{command}: {said}");
    }
    assert_eq!(names(at), ["locked"]);
}
