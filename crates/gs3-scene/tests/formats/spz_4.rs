//! SPZ versions 1 and 4 and axes in SPZ, spelled out here, independent of the writers.

use std::collections::BTreeMap;
use std::io::Write;

use gs3_scene::Axes;
use gs3_scene::format::{LoadOptions, Source, load_source};
use gs3_scene::scene::AxesKnownBy;
use half::f16;

use crate::handmade::{spz, spz_payload};
use crate::{assert_close, assert_error, load_bytes};

/// A Zstandard frame of one raw block.
fn zstd_frame(bytes: &[u8]) -> Vec<u8> {
    let mut frame = 0xfd2f_b528_u32.to_le_bytes().to_vec();
    // A single segment with its size in 4 bytes; no checksum.
    frame.push(0b1010_0000);
    frame.extend((bytes.len() as u32).to_le_bytes());
    // The last block, raw.
    let header = (bytes.len() as u32) << 3 | 1;
    frame.extend(&header.to_le_bytes()[..3]);
    frame.extend_from_slice(bytes);
    frame
}

/// The Gaussians of [`spz_payload`] of version 3 in version 4, with `extensions`.
pub fn spz_4(extensions: &[u8]) -> Vec<u8> {
    let payload = spz_payload(3);
    let mut file = payload[..15].to_vec();
    file[4] = 4;
    if !extensions.is_empty() {
        file[14] |= 2;
    }
    file.push(6);
    file.extend((32 + extensions.len() as u32).to_le_bytes());
    file.resize(32, 0);
    file.extend_from_slice(extensions);
    let mut rest = &payload[16..];
    let frames: Vec<(usize, Vec<u8>)> = [9, 1, 3, 3, 4, 9]
        .into_iter()
        .map(|size| {
            let (array, others) = rest.split_at(2 * size);
            rest = others;
            (array.len(), zstd_frame(array))
        })
        .collect();
    for (size, frame) in &frames {
        file.extend((frame.len() as u64).to_le_bytes());
        file.extend((*size as u64).to_le_bytes());
    }
    file.extend(frames.iter().flat_map(|(_, frame)| frame));
    file
}

/// An extension that states axes by their number.
fn axes_extension(code: u32) -> Vec<u8> {
    [0xadbe_0003, 4, code].into_iter().flat_map(u32::to_le_bytes).collect()
}

/// Two Gaussians of version 1: positions as halves.
pub fn spz_1_payload() -> Vec<u8> {
    let mut file = spz_payload(2);
    file[4] = 1;
    let rest = file.split_off(16 + 18);
    file.truncate(16);
    for value in [1.0, 2.0, -0.5, -32768.0, 65504.0, 0.0] {
        file.extend(f16::from_f32(value).to_le_bytes());
    }
    [file, rest].concat()
}

fn gzip(payload: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gzip.write_all(payload).unwrap();
    gzip.finish().unwrap()
}

#[test]
fn spz_version_4_is_version_3_in_frames() {
    let expected = load_bytes("s.spz", &spz(3)).unwrap();
    assert_eq!(load_bytes("s.spz", &spz_4(&[])).unwrap(), expected);
    let stated = load_bytes("s.spz", &spz_4(&axes_extension(4))).unwrap();
    assert_eq!(stated.gaussians(), expected.gaussians());
    assert_eq!(stated.details().axes.known_by, AxesKnownBy::File);

    let whole = spz_4(&[]);
    for length in 0..whole.len() {
        assert!(load_bytes("cut.spz", &whole[..length]).is_err(), "{length}");
    }
    let with = |at: usize, value: u8| {
        let mut file = spz_4(&[]);
        file[at] = value;
        load_bytes("v.spz", &file)
    };
    assert_error(with(4, 3), &["v.spz", "version", "4 outside of gzip", "3"]);
    assert_error(with(12, 5), &["v.spz", "shDegree", "at most 4", "5"]);
    assert_error(with(12, 0), &["v.spz", "numStreams", "5 streams", "6"]);
    assert_error(with(16, 31), &["v.spz", "tocByteOffset", "31"]);
    assert_error(with(32, 1), &["v.spz", "table of streams"]);
    assert_error(with(40, 17), &["v.spz", "positions", "18", "17"]);
    assert_error(with(11, 255), &["v.spz", "numPoints", "at most"]);
    // The first frame's block says that it is longer than the stream.
    assert_error(with(32 + 96 + 9, 0xf9), &["v.spz", "positions", "Zstandard"]);
}

#[test]
fn spz_version_1_has_halves() {
    let scene = load_bytes("s.spz", &gzip(&spz_1_payload())).unwrap();
    assert_eq!(scene.gaussians().mean(0), [1.0, -2.0, 0.5]);
    assert_eq!(scene.gaussians().mean(1), [-32768.0, -65504.0, 0.0]);
    let second = load_bytes("s.spz", &spz(2)).unwrap();
    assert_eq!(scene.gaussians().rotations, second.gaussians().rotations);
    assert_eq!(scene.gaussians().sh, second.gaussians().sh);
}

/// The caller's axes count first, then the file's, then the format's. Scenes in memory are right-down-front.
#[test]
fn spz_axes_are_honoured() {
    let file = |code: u32| {
        let mut payload = spz_payload(3);
        payload[14] |= 2;
        gzip(&[payload, axes_extension(code)].concat())
    };
    let load = |bytes: &[u8], axes: Option<Axes>| {
        let options = LoadOptions { axes, ..LoadOptions::default() };
        load_source(&Source::memory("a.spz", bytes), &BTreeMap::new(), &options, &|_| {}).unwrap()
    };
    // As stored: 1, 2, −0.5.
    assert_eq!(load(&file(6), None).gaussians().mean(0), [1.0, 2.0, -0.5]);
    assert_eq!(load(&file(4), None).gaussians().mean(0), [1.0, -2.0, 0.5]);
    // Left, front, down: x is left, y forward, z down.
    assert_eq!(load(&file(9), None).gaussians().mean(0), [-1.0, -0.5, 2.0]);
    let told = load(&file(4), Some(Axes::RDF));
    assert_eq!(told.gaussians().mean(0), [1.0, 2.0, -0.5]);
    assert_eq!(told.details().axes.known_by, AxesKnownBy::Caller);
    assert!(told.details().notes[0].contains("right-up-back"), "{:?}", told.details().notes);
    assert_eq!(load(&spz(3), Some(Axes::RDF)).gaussians().mean(0), [1.0, 2.0, -0.5]);
    // A mirrored scene has mirrored harmonics: y changes sign, z and x do not.
    let [plain, mirrored] = [load(&file(6), None), load(&file(8), None)];
    let (a, b) = (plain.gaussians().sh_of(0), mirrored.gaussians().sh_of(0));
    assert_close(&b[3..6], &[-a[3], -a[4], -a[5]], 1e-6);
    assert_close(&b[6..12], &a[6..12], 1e-6);
    let other = load_bytes("o.spz", &spz_4(&[7u32.to_le_bytes(), [0; 4]].concat())).unwrap();
    assert!(other.details().notes[0].contains("0x00000007"), "{:?}", other.details().notes);
}
