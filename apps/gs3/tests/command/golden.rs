//! Frames of the demo scene as they were when somebody last looked at them: changes that shift the picture are seen
//! here.
//!
//! The stored frames are what this writes, the first of `full` being the interpolated one:
//! `gs3 render demo --size 160x90 --frames 8..9 --mode MODE --tier analytic --out DIR`, with `--refine off` where the mode
//! has a history.

use std::path::Path;
use std::process::Command;

use gs3_test_support::psnr_of_bytes;

use super::png;

/// PSNR that a frame must have against the stored one. The margin is for SIMD levels that round differently; the
/// frames were stored on AVX-512, and how far the others differ has not been measured.
const SAME: f64 = 50.0;

fn pixels(file: &Path) -> Vec<u8> {
    let (width, height, pixels) = png(file);
    assert_eq!((width, height), (160, 90), "{}", file.display());
    pixels
}

fn check(mode: &str, frame: &str) {
    let folder = tempfile::tempdir().unwrap();
    // Modes without history have none to refine.
    let refine: &[&str] = if ["native", "bicubic"].contains(&mode) { &[] } else { &["--refine", "off"] };
    let output = Command::new(env!("CARGO_BIN_EXE_gs3"))
        .args(["render", "demo", "--size", "160x90", "--frames", "8..9", "--mode", mode])
        .args(refine)
        .args(["--tier", "analytic", "--out"])
        .arg(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{mode}.png"));
    let psnr = psnr_of_bytes(&pixels(&folder.path().join(frame)), &pixels(&stored));
    assert!(psnr >= SAME, "{mode}: expected at least {SAME} dB against the stored frame, found {psnr:.1}");
}

#[test]
fn native_frame_is_the_stored_one() {
    check("native", "frame_000008.png");
}

#[test]
fn bicubic_frame_is_the_stored_one() {
    check("bicubic", "frame_000008.png");
}

#[test]
fn super_sampled_frame_is_the_stored_one() {
    check("super-sample", "frame_000008.png");
}

#[test]
fn interpolated_frame_is_the_stored_one() {
    check("full", "frame_000015.png");
}
