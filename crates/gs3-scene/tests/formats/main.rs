//! Scene files: files made by hand for every reader, round trips through every writer, real captures, and
//! files that somebody broke.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod cameras;
#[path = "../../../../fuzz/src/entry.rs"]
mod entry;
#[path = "../../../../fuzz/src/found.rs"]
mod found;
mod gltf;
mod handmade;
mod hostile;
mod ksplat;
mod lcc2;
mod ply;
mod rad;
#[path = "../../../../fuzz/src/readers.rs"]
#[allow(dead_code, reason = "shared with the fuzz targets, which use all of it")]
mod readers;
mod real;
mod round_trip;
mod sog;
mod sog_1;
mod splat_and_spz;
mod splat_transform;
mod spz_4;
mod streamed;

use std::collections::BTreeMap;

use gs3_scene::Scene;
use gs3_scene::format::{LoadError, LoadOptions, Source, load_source};

/// Loads a scene in one piece.
fn load_bytes(name: &str, bytes: &[u8]) -> Result<Scene, LoadError> {
    load_source(&Source::memory(name, bytes), &BTreeMap::new(), &LoadOptions::default(), &|_| {})
}

/// Loads a folder in memory by its index file.
fn load_folder(
    index: &str,
    files: &BTreeMap<String, Vec<u8>>,
    options: &LoadOptions,
) -> Result<Scene, LoadError> {
    load_source(&Source::memory(index, &files[index]), files, options, &|_| {})
}

#[track_caller]
fn assert_close(actual: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(actual.len(), expected.len());
    for (a, e) in actual.iter().zip(expected) {
        assert!((a - e).abs() <= tolerance, "{actual:?} is not {expected:?} within {tolerance}");
    }
}

/// The message of a failed load, which must name `parts`.
#[track_caller]
fn assert_error(result: Result<Scene, LoadError>, parts: &[&str]) {
    let message = result.expect_err("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "{message:?} does not name {part:?}");
    }
    assert!(!message.contains('\n'));
}
