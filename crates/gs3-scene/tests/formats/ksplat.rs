//! `.ksplat`, spelled out here.

use half::f16;

use crate::{assert_close, assert_error, load_bytes};

/// Three Gaussians of degree 1 in two buckets, at the given level of compression; a second section is empty.
pub fn ksplat(level: u16) -> Vec<u8> {
    let mut file = vec![0; 4096 + 2 * 1024];
    file[1] = 1;
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    for (at, value) in [(4, 2u32), (8, 2), (12, 3), (16, 3)] {
        put(at, &value.to_le_bytes());
    }
    put(20, &level.to_le_bytes());
    put(36, &(-2.0f32).to_le_bytes());
    put(40, &2.0f32.to_le_bytes());
    let is_bucketed = level > 0;
    // Room for four, two a bucket, one of them full.
    let fields = [
        (0, 3u32),
        (4, 4),
        (8, 2),
        (12, if is_bucketed { 2 } else { 0 }),
        (32, 1),
        (36, u32::from(is_bucketed)),
    ];
    for (at, value) in fields {
        put(4096 + at, &value.to_le_bytes());
    }
    put(4096 + 16, &5.0f32.to_le_bytes());
    put(4096 + 20, &12u16.to_le_bytes());
    put(4096 + 40, &1u16.to_le_bytes());
    if is_bucketed {
        file.extend(1u32.to_le_bytes());
        for center in [[10.0f32, 0.0, 0.0], [-10.0, 1.0, 0.0]] {
            file.extend(center.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    for i in 0..4 {
        match level {
            0 => file.extend([i as f32, 2.0, 3.0].iter().flat_map(|v| v.to_le_bytes())),
            // The centre, and half a block to the right of it.
            _ => file.extend(
                [32767u16 + 32767 * (i % 2) as u16, 32767, 32767].iter().flat_map(|v| v.to_le_bytes()),
            ),
        }
        let scale_and_rotation = [0.5f32, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0];
        let sh = [0.1f32, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
        let half = |v: &f32| f16::from_f32(*v).to_le_bytes();
        match level {
            0 => file.extend(scale_and_rotation.iter().flat_map(|v| v.to_le_bytes())),
            _ => file.extend(scale_and_rotation.iter().flat_map(half)),
        }
        file.extend_from_slice(&[255, 0, 128, 51]);
        match level {
            0 => file.extend(sh.iter().flat_map(|v| v.to_le_bytes())),
            1 => file.extend(sh.iter().flat_map(half)),
            _ => file.extend(sh.iter().map(|v| ((v + 2.0) / 4.0 * 255.0).round() as u8)),
        }
    }
    file
}

#[test]
fn ksplat_at_all_levels_of_compression() {
    for level in 0..3 {
        let scene = load_bytes("s.ksplat", &ksplat(level)).unwrap();
        let gaussians = scene.gaussians();
        assert_eq!((gaussians.len(), gaussians.sh_degree), (3, 1));
        let means = [0, 1, 2].map(|i| gaussians.mean(i));
        match level {
            0 => assert_eq!(means, [[0.0, 2.0, 3.0], [1.0, 2.0, 3.0], [2.0, 2.0, 3.0]]),
            _ => assert_eq!(means, [[10.0, 0.0, 0.0], [12.5, 0.0, 0.0], [-10.0, 1.0, 0.0]]),
        }
        assert_eq!(gaussians.scale(2), [0.5, 1.0, 2.0]);
        assert_eq!(gaussians.rotation(1), [1.0, 0.0, 0.0, 0.0]);
        assert_close(&gaussians.opacities, &[0.2; 3], 1e-6);
        assert_close(&gaussians.sh_of(0)[..3], &[1.772_453_9, -1.772_453_9, 0.006_950_8], 1e-5);
        // Red of all functions of the degree first, then green, then blue.
        let expected = [0.1, 0.4, 0.7, 0.2, 0.5, 0.8, 0.3, 0.6, 0.9];
        assert_close(&gaussians.sh_of(2)[3..], &expected, if level == 2 { 0.008 } else { 1e-3 });
    }
    let with = |at: usize, value: u8| {
        let mut file = ksplat(1);
        file[at] = value;
        load_bytes("s.ksplat", &file)
    };
    assert_error(with(0, 1), &["s.ksplat", "version", "1.1"]);
    assert_error(with(20, 3), &["compression level", "3"]);
    assert_error(with(16, 4), &["splat count", "3", "4"]);
    assert_error(with(4096, 5), &["section 0 splat count", "at most 4", "5"]);
    assert_error(with(4096 + 40, 9), &["section 0 SH degree", "9"]);
    assert_error(load_bytes("s.bin", &ksplat(1)), &["s.bin", "format"]);
    let whole = ksplat(1);
    // The room of the last record may be missing.
    for length in 0..whole.len() - 42 {
        assert!(load_bytes("cut.ksplat", &whole[..length]).is_err(), "{length}");
    }
}
