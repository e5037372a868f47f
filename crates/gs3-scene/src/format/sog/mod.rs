//! SOG (PlayCanvas): Gaussians as the pixels of lossless WebP (or PNG) images beside a `meta.json`.
//!
//! Source: the SOG format specification, versions 1 and 2, and the streamed SOG specification, version 1, both by
//! PlayCanvas. Every per-Gaussian image has Gaussian `i` at pixel `(i mod width, i / width)`.

mod budget;
mod chunk;
mod codebook;
mod meta;
mod palette;
mod plane;
mod stream;
mod version_1;
mod write;
#[cfg(feature = "fs")]
mod write_stream;

use std::io;

use rayon::prelude::*;

use super::error::{LoadError, spelled};
use super::progress::{Progress, Work};
use super::source::{Files, Source, check_allowance};
use super::{Decoded, memory, origin};
use crate::gaussians::Gaussians;
use crate::scene::OpacityMode;
pub use budget::Budget;
use chunk::{Chunk, Ranges};
pub use stream::Streamed;
pub(super) use stream::{read as read_streamed, streamed};
pub(super) use write::{MOST_GAUSSIANS, write};
#[cfg(feature = "fs")]
pub(super) use write_stream::write_streamed;

/// Reads a bundle, or a `meta.json`, which names its images among `files`.
pub(super) fn read(
    source: &Source<'_>,
    files: &dyn Files,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let chunk = Chunk::open(source, files, "")?;
    let all = chunk.all();
    decode(source.name(), vec![(chunk, all)], progress)
}

/// A chunk, and which of its Gaussians are wanted.
type Selection<'a> = (Chunk<'a>, Ranges);

/// Decodes the selected Gaussians of all chunks, in order.
fn decode(file: &str, selections: Vec<Selection<'_>>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    let degree = selections.iter().map(|(chunk, _)| chunk.sh_degree()).max().unwrap_or(0);
    let counts: Vec<usize> =
        selections.iter().map(|(_, ranges)| ranges.iter().map(ExactSizeIterator::len).sum()).collect();
    // Chunk counts are within the size of WebP images, ranges within chunks: neither sum overflows 64 bits.
    let count = counts.iter().sum::<usize>();
    let file_bytes = selections.iter().fold(0, |sum: u64, (chunk, _)| sum.saturating_add(chunk.file_bytes()));
    let stride = Gaussians::zeroed(0, degree).sh_stride();
    let scene_bytes = (count as u64).checked_mul((11 + stride as u64) * 4);
    check_allowance(file, "count", file_bytes, scene_bytes)?;

    let mut notes = Vec::new();
    let mut modes = Vec::new();
    for (chunk, _) in &selections {
        let (mode, of_chunk) = chunk.mode();
        modes.push(mode);
        // A note that all chunks share is given once.
        of_chunk.into_iter().for_each(|note| {
            if !notes.contains(&note) {
                notes.push(note);
            }
        });
    }
    let is_antialiased = |mode: &OpacityMode| *mode == OpacityMode::Antialiased;
    let mode = if modes.iter().any(is_antialiased) { OpacityMode::Antialiased } else { OpacityMode::Default };
    if modes.iter().any(is_antialiased) && !modes.iter().all(is_antialiased) {
        notes.push("some chunks are antialiased and some are not: all are shown antialiased".to_owned());
    }
    let origin = origin::of([0, 1, 2].map(|axis| {
        // Ends twice, so that they are what percentiles find.
        let bounds = selections.iter().flat_map(|(chunk, _)| {
            let [low, high] = chunk.bounds(axis);
            [low, low, f64::midpoint(low, high), high, high]
        });
        bounds.collect()
    }));
    let work = Work::new(selections.iter().map(|(chunk, _)| chunk.work()).sum(), progress);
    let mut gaussians = memory::gaussians(file, count, degree)?;
    let mut rest = gaussians.slots();
    let mut tasks = Vec::with_capacity(selections.len());
    for ((chunk, ranges), count) in selections.into_iter().zip(counts) {
        let (slots, others) = rest.split_at(count);
        rest = others;
        tasks.push((chunk, ranges, slots));
    }
    tasks
        .into_par_iter()
        .try_for_each(|(chunk, ranges, slots)| chunk.decode(ranges, slots, origin, &work))?;
    Ok(Decoded { origin, notes, ..Decoded::new(gaussians, mode) })
}

/// The error of a file that a SOG scene names and does not have.
pub(super) fn missing(name: &str) -> LoadError {
    LoadError::Io { file: spelled(name), source: io::Error::from(io::ErrorKind::NotFound) }
}
