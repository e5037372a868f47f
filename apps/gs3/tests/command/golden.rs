//! Frames of the demo scene as they were when somebody last looked at them: changes that shift the picture are seen
//! here.
//!
//! The stored frames are what this writes, the first of `full` being the interpolated one:
//! `gs3 render demo --size 160x90 --frames 8..9 --mode MODE --tier analytic --out DIR`, with `--refine off` where the mode
//! has a history, and with `--in-between 1` in mode `full`.

use std::path::Path;
use std::process::Command;

use gs3_test_support::psnr_of_bytes;

use super::png;

/// PSNR in dB that a frame must have against the stored one, which was made with AVX-512. With AVX2, SSE4.2 and scalar
/// code the frames have 78.4 dB at least, and differ by 2 of 255 at most (`GS3_SIMD`); compilers may fuse otherwise.
const SAME: f64 = 72.0;

/// Largest difference of a byte from the stored one.
const LARGEST: u8 = 4;

fn pixels(file: &Path) -> Vec<u8> {
    let (width, height, pixels) = png(file);
    assert_eq!((width, height), (160, 90), "{}", file.display());
    pixels
}

fn check(mode: &str, frame: &str) {
    let folder = tempfile::tempdir().unwrap();
    // Modes without history have nothing to refine.
    let of_mode: &[&str] = match mode {
        "native" | "bicubic" => &[],
        "full" => &["--refine", "off", "--in-between", "1"],
        _ => &["--refine", "off"],
    };
    let output = Command::new(env!("CARGO_BIN_EXE_gs3"))
        .args(["render", "demo", "--size", "160x90", "--frames", "8..9", "--mode", mode])
        .args(of_mode)
        .args(["--tier", "analytic", "--out"])
        .arg(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{mode}.png"));
    let (found, stored) = (pixels(&folder.path().join(frame)), pixels(&stored));
    let psnr = psnr_of_bytes(&found, &stored);
    assert!(psnr >= SAME, "{mode}: expected at least {SAME} dB against the stored frame, found {psnr:.1}");
    let largest = found.iter().zip(&stored).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(
        largest <= Some(LARGEST),
        "{mode}: expected bytes within {LARGEST} of the stored ones, found {largest:?}"
    );
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
