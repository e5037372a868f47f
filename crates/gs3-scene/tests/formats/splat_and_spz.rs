//! `.splat` and SPZ.

use std::io::Write;

use gs3_scene::OpacityMode;

use crate::handmade::{splat, spz, spz_extended, spz_payload};
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
    // Coordinates may begin as JSON or gzip does.
    for start in [&b"{"[..], b"  {", &[0x1f, 0x8b]] {
        let mut file = splat();
        file[..start.len()].copy_from_slice(start);
        assert_eq!(load_bytes("two.splat", &file).unwrap().gaussians().len(), 2);
    }
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

fn gzip(payload: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gzip.write_all(payload).unwrap();
    gzip.finish().unwrap()
}

#[test]
fn spz_errors() {
    let changed = |at: usize, value: u8| {
        let mut payload = spz_payload(3);
        payload[at] = value;
        gzip(&payload)
    };
    assert_error(load_bytes("m.spz", &changed(0, b'X')), &["m.spz", "magic", "NGSP"]);
    assert_error(load_bytes("v.spz", &changed(4, 4)), &["v.spz", "version", "1, 2 or 3 within gzip", "4"]);
    assert_error(load_bytes("d.spz", &changed(12, 5)), &["d.spz", "shDegree", "4", "5"]);
    assert_error(load_bytes("f.spz", &changed(13, 25)), &["f.spz", "fractionalBits", "24", "25"]);
    assert_error(load_bytes("x.spz", &changed(14, 4)), &["x.spz", "flags", "0 to 3", "4"]);
    // More Gaussians than the file has, and than any file of its size has.
    assert_error(load_bytes("n.spz", &changed(8, 3)), &["n.spz", "arrays", "gzip"]);
    assert_error(load_bytes("bomb.spz", &changed(11, 255)), &["bomb.spz", "numPoints", "at most"]);
    let whole = spz(3);
    assert_error(load_bytes("cut.spz", &whole[..whole.len() / 2]), &["cut.spz"]);
    assert_error(load_bytes("cut.spz", &whole[..12]), &["cut.spz", "header"]);
}

/// What is damaged or inconsistent shows at the end of the file, where nobody needs to look for the arrays.
#[test]
fn an_spz_is_read_to_its_end() {
    for version in [2, 3] {
        let whole = spz(version);
        let scene = load_bytes("s.spz", &whole).unwrap();
        for length in 0..whole.len() {
            assert!(load_bytes("cut.spz", &whole[..length]).is_err(), "{length} of {} bytes", whole.len());
        }
        // The ten bytes before are the header of the gzip, where a time and a system mean nothing; so do the last bits
        // before the checksum, which fill a byte.
        for place in 10..whole.len() {
            for bit in 0..8 {
                let mut damaged = whole.clone();
                damaged[place] ^= 1 << bit;
                match load_bytes("bit.spz", &damaged) {
                    Ok(other) => {
                        assert!(other == scene && place < whole.len() - 8, "bit {bit} of byte {place}")
                    }
                    Err(error) => assert!(error.to_string().starts_with("bit.spz: "), "{error}"),
                }
            }
        }
        assert_error(load_bytes("more.spz", &[&whole[..], b"more"].concat()), &["more.spz", "end", "gzip"]);
        // A stream may be in several pieces.
        let (head, tail) = (&spz_payload(version)[..20], &spz_payload(version)[20..]);
        assert_eq!(load_bytes("two.spz", &[gzip(head), gzip(tail)].concat()).unwrap(), scene);

        let with = |at: usize, value: u8| {
            let mut payload = spz_payload(version);
            payload[at] = value;
            load_bytes("header.spz", &gzip(&payload))
        };
        assert_error(with(8, 1), &["header.spz", "arrays", "1 Gaussians of degree 1", "more"]);
        assert_error(with(12, 0), &["header.spz", "arrays", "2 Gaussians of degree 0", "more"]);
        assert_error(with(12, 2), &["header.spz", "arrays", "gzip"]);
        assert_error(with(4, 5 - version as u8), &["header.spz", "arrays"]);
        let longer = [spz_payload(version), vec![0]].concat();
        assert_error(load_bytes("longer.spz", &gzip(&longer)), &["longer.spz", "arrays", "more"]);
    }
}

#[test]
fn spz_extensions_are_skipped_if_they_are_whole() {
    let with = |extensions: &[u8]| {
        let mut payload = spz_payload(3);
        payload[14] |= 2;
        payload.extend_from_slice(extensions);
        load_bytes("e.spz", &gzip(&payload))
    };
    let record = |kind: u32, payload: &[u8]| {
        [&kind.to_le_bytes()[..], &(payload.len() as u32).to_le_bytes(), payload].concat()
    };
    let scene = load_bytes("s.spz", &spz(3)).unwrap();
    let (orbit, axes) = (record(0xadbe_0002, &[1; 12]), |value: u8| record(0xadbe_0003, &[value, 0, 0, 0]));
    for extensions in [&[][..], &orbit, &axes(0)] {
        assert_eq!(with(extensions).unwrap(), scene, "{extensions:?}");
    }
    let unknown = with(&[&orbit[..], &record(7, &[])].concat()).unwrap();
    assert_eq!((unknown.gaussians(), unknown.details().notes.len()), (scene.gaussians(), 1));
    assert_eq!(with(&axes(4)).unwrap().gaussians(), scene.gaussians());
    assert_eq!(load_bytes("e.spz", &gzip(&spz_extended())).unwrap().gaussians(), scene.gaussians());
    for length in 1..orbit.len() {
        assert_error(with(&orbit[..length]), &["e.spz", "extensions", &length.to_string()]);
    }
    assert_error(with(&axes(17)), &["e.spz", "coordinate system", "16 coordinate systems", "found 17"]);
    assert_error(with(&record(0xadbe_0003, &[4; 5])), &["e.spz", "coordinate system", "found 5 bytes"]);
    assert_error(with(&vec![0; (1 << 20) + 1]), &["e.spz", "arrays", "1048576", "more"]);
}
