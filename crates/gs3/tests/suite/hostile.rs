//! Hostile scenes, cameras and weights: an error in one line or finite pixels, never a panic.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::Config;

use crate::found::found;
use crate::frames::{self, TARGETS};

fn files(folder: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let files = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
    files.map(|file| fs::read(file).unwrap()).collect()
}

fn corpus(target: &str) -> Vec<Vec<u8>> {
    files(&format!("../../fuzz/corpus/{target}"))
}

#[test]
fn the_fuzz_corpus_is_harmless() {
    for (target, run) in TARGETS {
        let seeds = corpus(target);
        assert!(!seeds.is_empty(), "{target} has no seed");
        seeds.iter().for_each(|seed| run(seed));
    }
}

#[test]
fn what_fuzzing_found_is_harmless() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/found");
    for (target, run) in TARGETS {
        found(&folder, target).iter().for_each(|input| run(input));
    }
}

proptest! {
    #![proptest_config(Config { cases: 200, failure_persistence: None, ..Config::default() })]

    #[test]
    fn any_numbers_make_harmless_frames(
        changes in prop::collection::vec((0.0f64..1.0, prop_oneof![any::<f32>(), Just(f32::MAX), Just(1e-40), Just(0.0)]), 1..8),
    ) {
        for mut bytes in corpus("frames") {
            for (place, value) in &changes {
                // After the four switches every four bytes are a number.
                let place = 4 + (place * (bytes.len() / 4 - 1) as f64) as usize * 4;
                bytes[place..place + 4].copy_from_slice(&value.to_le_bytes());
            }
            frames::frames(&bytes);
        }
    }

    #[test]
    fn damaged_weights_are_harmless(place in 0.0f64..1.0, value in any::<u8>(), cut in prop_oneof![Just(1.0), 0.0f64..1.0]) {
        let mut bytes = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/super_sample_fast_x4.safetensors")).unwrap();
        bytes.truncate((bytes.len() as f64 * cut) as usize);
        // Half of the changes are in the header.
        let end = if place < 0.5 { 4096.min(bytes.len()) } else { bytes.len() };
        if let Some(byte) = bytes.get_mut((place * end as f64) as usize) {
            *byte = value;
        }
        frames::weights(&bytes);
    }
}
