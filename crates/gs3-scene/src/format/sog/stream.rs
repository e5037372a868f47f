//! Streamed SOG: a tree of ranges over chunks, per level of detail.

use super::super::LoadOptions;
use super::super::error::LoadError;
use super::super::progress::Progress;
use super::super::source::{Files, Source, inside};
use super::budget::{leaves, levels};
use super::chunk::{Chunk, Ranges};
use super::meta::{LodMeta, Node, Run};
use super::{Decoded, Selection, decode};
use crate::axes::Axes;

/// A chunk that `lod-meta.json` names.
struct Wanted<'a> {
    field: &'static str,
    file: &'a str,
    /// `None` for all of it.
    ranges: Option<Ranges>,
}

/// What a streamed SOG scene has to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Streamed {
    /// Number of levels of detail.
    pub levels: u32,
    /// Whether it has an environment (sky, far background).
    pub has_environment: bool,
    /// Whether [`LoadOptions::budget`] chooses levels of it.
    pub takes_budget: bool,
}

/// What the `lod-meta.json` states.
pub(in super::super) fn streamed(source: &Source<'_>) -> Result<Streamed, LoadError> {
    let meta = LodMeta::parse(source)?;
    Ok(Streamed { levels: meta.level_count, has_environment: meta.environment.is_some(), takes_budget: true })
}

/// Reads the wanted level of detail of all leaves, then the environment.
pub(in super::super) fn read(
    source: &Source<'_>,
    files: &dyn Files,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let meta = LodMeta::parse(source)?;
    let name = source.name();
    if let Some(level) = options.level_of_detail
        && level >= meta.level_count
    {
        let expected = format!("a level below {}, the number of levels", meta.level_count);
        return Err(LoadError::invalid(name, "level of detail", expected, level.to_string()));
    }
    let mut runs = vec![Vec::new(); meta.filenames.len()];
    let leaves = leaves(&meta.tree);
    let levels = match (&options.budget, options.level_of_detail) {
        (None, level) => vec![level; leaves.len()],
        (Some(budget), None) => levels(&meta.tree, budget, options.axes.unwrap_or(Axes::RDF).to_rdf()),
        (Some(budget), Some(level)) => {
            let actual = format!("a budget of {} Gaussians and level {level}", budget.gaussians);
            return Err(LoadError::invalid(name, "level of detail", "a budget or one level", actual));
        }
    };
    for (leaf, level) in leaves.into_iter().zip(levels) {
        add_run(name, leaf, level, &mut runs)?;
    }

    let mut wanted: Vec<Wanted<'_>> = Vec::new();
    for (file, runs) in meta.filenames.iter().zip(runs) {
        if !runs.is_empty() {
            wanted.push(Wanted { field: "filenames", file, ranges: Some(merged(name, file, runs)?) });
        }
    }
    if let Some(file) = meta.environment.as_deref().filter(|_| options.environment) {
        wanted.push(Wanted { field: "environment", file, ranges: None });
    }
    // All files are asked for before one that is missing is told: who fetches files learns of all at once.
    let open = |Wanted { field, file, .. }: &Wanted<'_>| files.open(&inside(name, field, "", file)?);
    let sources: Vec<_> = wanted.iter().map(open).collect();
    let sources = sources.into_iter().collect::<Result<Vec<_>, _>>()?;
    let chunks: Vec<_> = sources
        .iter()
        .zip(&wanted)
        .map(|(source, Wanted { file, .. })| {
            Chunk::open(source, files, file.rsplit_once('/').map_or("", |(folder, _)| folder))
        })
        .collect();
    let mut selections: Vec<Selection<'_>> = Vec::with_capacity(wanted.len());
    for (chunk, Wanted { ranges, .. }) in chunks.into_iter().zip(wanted) {
        let chunk = chunk?;
        let ranges = ranges.unwrap_or_else(|| chunk.all());
        if let Some(end) = ranges.last().map(|range| range.end)
            && end > chunk.count()
        {
            let expected = format!("ranges within the {} Gaussians of {}", chunk.count(), chunk.name());
            return Err(LoadError::invalid(name, "tree", expected, format!("one that ends at {end}")));
        }
        selections.push((chunk, ranges));
    }
    decode(name, selections, progress)
}

/// Adds the range of `leaf` at `level`, or at its finest one, to the runs of its chunk.
fn add_run(name: &str, leaf: &Node, level: Option<u32>, runs: &mut [Ranges]) -> Result<(), LoadError> {
    let run = match level {
        Some(level) => leaf.lods.get(&level),
        None => leaf.lods.first_key_value().map(|(_, run)| run),
    };
    let Some(Run { file, offset, count }) = run.filter(|run| run.count > 0) else { return Ok(()) };
    let known = runs.len();
    let (Some(runs), Some(end)) = (runs.get_mut(*file), offset.checked_add(*count)) else {
        let expected = format!("a file below {known} and a range within it");
        let actual = format!("file {file}, offset {offset}, count {count}");
        return Err(LoadError::invalid(name, "tree", expected, actual));
    };
    runs.push(*offset..end);
    Ok(())
}

/// The ranges in order, neighbours joined. They must not overlap: no Gaussian is in two leaves.
fn merged(name: &str, file: &str, mut ranges: Ranges) -> Result<Ranges, LoadError> {
    ranges.sort_unstable_by_key(|range| (range.start, range.end));
    let mut merged: Ranges = Vec::new();
    for range in ranges {
        match merged.last_mut() {
            Some(last) if range.start < last.end => {
                let expected = format!("ranges of {file} that do not overlap");
                let actual = format!("{}..{} and {}..{}", last.start, last.end, range.start, range.end);
                return Err(LoadError::invalid(name, "tree", expected, actual));
            }
            Some(last) if range.start == last.end => last.end = range.end,
            _ => merged.push(range),
        }
    }
    Ok(merged)
}
