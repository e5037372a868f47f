//! `.rad`, spelled out here.

use std::io::Write;

use crate::{assert_close, assert_error, load_bytes};

/// A chunk of `.rad`.
fn rad_chunk(base: u64, count: u64, properties: &[(&str, &str, Vec<u8>)], is_packed: bool) -> Vec<u8> {
    let (mut payload, mut described) = (Vec::new(), Vec::new());
    for (name, encoding, bytes) in properties {
        let packed = match is_packed {
            true => {
                let mut deflate = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
                deflate.write_all(bytes).unwrap();
                deflate.finish().unwrap()
            }
            false => bytes.clone(),
        };
        let compression = if is_packed { r#","compression":"gz""# } else { "" };
        described.push(format!(
            r#"{{"offset":{},"bytes":{},"property":"{name}","encoding":"{encoding}","min":0,"max":1{compression}}}"#,
            payload.len(),
            packed.len()
        ));
        payload.extend(packed);
        payload.resize(payload.len().next_multiple_of(8), 0);
    }
    let json = format!(
        r#"{{"version":1,"base":{base},"count":{count},"payloadBytes":{},"properties":[{}]}}"#,
        payload.len(),
        described.join(",")
    );
    let mut chunk = b"RADC".to_vec();
    chunk.extend((json.len() as u32).to_le_bytes());
    chunk.extend(json.bytes());
    chunk.resize(chunk.len().next_multiple_of(8), 0);
    chunk.extend((payload.len() as u64).to_le_bytes());
    chunk.extend(payload);
    chunk
}

/// Three Gaussians of degree 1 in two chunks; with a tree, the first is an inner node.
pub fn rad(has_tree: bool) -> Vec<u8> {
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut first = vec![
        ("center", "f32", floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
        ("alpha", "r8", vec![255, 51]),
        ("rgb", "r8_delta", vec![255, 1, 0, 51, 51, 0]),
        ("scales", "f32", floats(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6])),
        ("orientation", "oct88r8", vec![128, 128, 255, 128, 128, 0]),
        ("sh1", "s8", vec![127; 18]),
    ];
    let mut second = vec![
        ("center", "f32", floats(&[7.0, 8.0, 9.0])),
        ("alpha", "f32", floats(&[0.5])),
        ("rgb", "f32", floats(&[0.5, 0.5, 0.5])),
        ("scales", "f32", floats(&[1.0, 1.0, 1.0])),
        ("orientation", "f32", floats(&[0.0, 0.0, 0.0, 1.0])),
        ("sh1", "f32", floats(&[0.25; 9])),
    ];
    if has_tree {
        first.push(("child_count", "u16", vec![1, 0, 0, 0]));
        second.push(("child_count", "u16", vec![0, 0]));
    }
    let chunks = [rad_chunk(0, 2, &first, true), rad_chunk(2, 1, &second, false)];
    let json = format!(
        r#"{{"version":1,"type":"gsplat","count":3,"maxSh":1,"lodTree":{has_tree},"chunkSize":2,"allChunkBytes":{},
        "chunks":[{{"offset":0,"bytes":{}}},{{"offset":{},"bytes":{}}}]}}"#,
        chunks[0].len() + chunks[1].len(),
        chunks[0].len(),
        chunks[0].len(),
        chunks[1].len()
    );
    let mut file = b"RAD0".to_vec();
    file.extend((json.len() as u32).to_le_bytes());
    file.extend(json.bytes());
    file.resize(file.len().next_multiple_of(8), 0);
    [file, chunks.concat()].concat()
}

#[test]
fn rad_chunks_and_leaves() {
    let scene = load_bytes("s.rad", &rad(false)).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (3, 1));
    assert_eq!([0, 1, 2].map(|i| gaussians.mean(i)), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0], [7.0, 8.0, 9.0]]);
    assert_close(&gaussians.opacities, &[1.0, 0.2, 0.5], 1e-6);
    assert_close(&gaussians.sh_of(0)[..3], &[1.772_453_9, -1.772_453_9, -1.063_472_3], 1e-5);
    assert_close(&gaussians.sh_of(1)[..2], &[-1.772_453_9, -1.063_472_3], 1e-5);
    assert_eq!((gaussians.sh_of(0)[3], gaussians.sh_of(2)[11]), (1.0, 0.25));
    assert_close(&gaussians.rotation(0), &[0.0, 0.0, 0.0, 1.0], 0.01);
    assert_eq!(gaussians.rotation(2), [1.0, 0.0, 0.0, 0.0]);

    let tree = load_bytes("s.rad", &rad(true)).unwrap();
    assert_eq!(tree.gaussians().means[0], [2.0, 7.0]);
    assert!(tree.details().notes[0].contains("leaves"), "{:?}", tree.details().notes);
    let whole = rad(false);
    for length in 0..whole.len() {
        assert!(load_bytes("cut.rad", &whole[..length]).is_err(), "{length}");
    }
    assert_error(load_bytes("c.bin", b"RADC        "), &["c.bin", "one chunk"]);
}
