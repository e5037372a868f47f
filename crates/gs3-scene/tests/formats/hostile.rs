//! Broken files: an error or a valid scene, never a panic.

use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::Config;

use crate::found::found;
use crate::handmade::{seeds, spz};
use crate::load_bytes;
use crate::readers::TARGETS;

#[test]
fn the_fuzz_corpus_is_harmless() {
    for (target, run) in TARGETS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(target);
        let files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(!files.is_empty(), "{} has no seed", folder.display());
        for file in files {
            run(&std::fs::read(&file).unwrap());
        }
    }
}

#[test]
fn what_fuzzing_found_is_harmless() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/found");
    for (target, run) in TARGETS {
        found(&folder, target).iter().for_each(|input| run(input));
    }
}

/// A cut, and bytes that are changed.
fn damage(seed: &[u8], keep: f64, changes: &[(f64, u8)]) -> Vec<u8> {
    let mut bytes = seed[..(seed.len() as f64 * keep) as usize].to_vec();
    for (place, value) in changes {
        let place = (bytes.len() as f64 * place) as usize;
        if let Some(byte) = bytes.get_mut(place) {
            *byte = *value;
        }
    }
    bytes
}

proptest! {
    #![proptest_config(Config { cases: 400, failure_persistence: None, ..Config::default() })]

    #[test]
    fn damaged_files_are_harmless(
        cut in prop_oneof![3 => Just(1.0), 1 => 0.0f64..1.0],
        changes in prop::collection::vec((0.0f64..1.0, any::<u8>()), 0..4),
    ) {
        for (target, run) in TARGETS {
            for (_, seed) in seeds(target) {
                run(&damage(&seed, cut, &changes));
            }
        }
        // The gzip around an SPZ too.
        let _ = load_bytes("damaged.spz", &damage(&spz(3), cut, &changes));
    }

    #[test]
    fn noise_is_harmless(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for (_, run) in TARGETS {
            run(&bytes);
        }
        for magic in [&b"ply\n"[..], &[0x1f, 0x8b], b"PK\x03\x04", b"{"] {
            let _ = load_bytes("noise.splat", &[magic, &bytes].concat());
        }
    }
}

#[test]
fn every_cut_of_every_seed_is_harmless() {
    for (target, run) in TARGETS {
        for (_, seed) in seeds(target) {
            let step = (seed.len() / 300).max(1);
            for length in (0..seed.len()).step_by(step) {
                run(&seed[..length]);
            }
        }
    }
}
