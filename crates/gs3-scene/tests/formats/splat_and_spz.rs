//! `.splat` and SPZ.

use std::io::Write;

use gs3_scene::OpacityMode;

use crate::handmade::{splat, spz, spz_payload};
use crate::{assert_close, assert_error, load_bytes};

#[test]
fn splat_records() {
    let scene = load_bytes("two.splat", &splat()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!(gaussians.len(), 2);
    assert_eq!(gaussians.mean(0), [1.0, -2.0, 3.0]);
    assert_eq!(gaussians.scale(0), [0.1, 0.2, 0.3]);
    assert_eq!(gaussians.rotation(0), [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(gaussians.rotation(1), [0.0, 0.0, 0.0, -1.0]);
    assert_close(&gaussians.opacities, &[1.0, 0.2], 1e-6);
    assert_close(gaussians.sh_of(0), &[1.772_453_9, -1.772_453_9, 0.006_950_8], 1e-5);
}

#[test]
fn splat_goes_by_name_and_needs_whole_records() {
    assert_error(load_bytes("two.bin", &splat()), &["two.bin", "format", "00 00 80 3f"]);
    assert_error(load_bytes("cut.splat", &splat()[..63]), &["cut.splat", "size", "32", "63"]);
    assert_error(load_bytes("empty.splat", &[]), &["empty.splat", "no valid Gaussian"]);
}

#[test]
fn spz_versions_2_and_3() {
    for version in [2, 3] {
        let scene = load_bytes("s.spz", &spz(version)).unwrap();
        let gaussians = scene.gaussians();
        assert_eq!((gaussians.len(), gaussians.sh_degree), (2, 1));
        assert_eq!(scene.opacity_mode(), OpacityMode::Antialiased);
        // y and z change sign.
        assert_eq!(gaussians.mean(0), [1.0, -2.0, 0.5]);
        assert_eq!(gaussians.mean(1), [-32768.0, -32767.996, 0.0]);
        assert_close(&gaussians.scale(0), &[1.0, 1f32.exp(), (-1f32).exp()], 1e-6);
        assert_close(&gaussians.opacities, &[1.0, 0.2], 1e-6);
        assert_close(&gaussians.sh_of(0)[..3], &[-0.5 / 0.15, 0.5 / 0.15, 0.013_071_9], 1e-5);
        // Coefficients y, z, x, RGB each: y and z change sign.
        let expected = [1.0, 0.0, -0.992_187_5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5];
        assert_close(&gaussians.sh_of(0)[3..], &expected, 1e-6);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        if version == 2 {
            // x 1, y ~0, z −1 as stored: normalised, z with its sign changed.
            assert_close(&gaussians.rotation(0), &[0.0, half, 0.0, half], 5e-3);
            assert_close(&gaussians.rotation(1), &[1.0, 0.0, 0.0, 0.0], 8e-3);
        } else {
            assert_close(&gaussians.rotation(0), &[half, half, 0.0, 0.0], 1e-6);
            let y = half * 255.0 / 511.0;
            assert_close(&gaussians.rotation(1), &[0.0, (1.0 - y * y).sqrt(), y, 0.0], 1e-6);
        }
    }
}

#[test]
fn spz_errors() {
    let gzip = |payload: &[u8]| {
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        gzip.write_all(payload).unwrap();
        gzip.finish().unwrap()
    };
    let changed = |at: usize, value: u8| {
        let mut payload = spz_payload(3);
        payload[at] = value;
        gzip(&payload)
    };
    assert_error(load_bytes("m.spz", &changed(0, b'X')), &["m.spz", "magic", "NGSP"]);
    assert_error(load_bytes("v.spz", &changed(4, 4)), &["v.spz", "version", "2 or 3", "4"]);
    assert_error(load_bytes("d.spz", &changed(12, 4)), &["d.spz", "shDegree", "3", "4"]);
    assert_error(load_bytes("f.spz", &changed(13, 25)), &["f.spz", "fractionalBits", "24", "25"]);
    assert_error(load_bytes("x.spz", &changed(14, 2)), &["x.spz", "flags", "2"]);
    // More Gaussians than the file has, and than any file of its size has.
    assert_error(load_bytes("n.spz", &changed(8, 3)), &["n.spz", "arrays", "gzip"]);
    assert_error(load_bytes("bomb.spz", &changed(11, 255)), &["bomb.spz", "numPoints", "at most"]);
    let whole = spz(3);
    assert_error(load_bytes("cut.spz", &whole[..whole.len() / 2]), &["cut.spz"]);
    assert_error(load_bytes("cut.spz", &whole[..12]), &["cut.spz", "header"]);
}
