//! LCC2 (XGRIDS): an octree in JSON. Its nodes name ranges of SOG or SPZ files beside it, with one level of detail
//! per depth.
//!
//! Source: the code of splat-transform, which agrees with files of LCC Studio; the format has no specification.
//! Coordinates are right-front-up.

use std::collections::BTreeMap;
use std::ops::Range;

use serde_json::Value;

use super::error::{LoadError, quoted};
use super::progress::Progress;
use super::source::{Files, Source, inside};
use super::{Decoded, LoadOptions, sog, spz};
use crate::axes::Axes;
use crate::gaussians::Gaussians;
use crate::scene::{AxesKnownBy, FileAxes, OpacityMode};
use crate::transform::{Similarity, transform};

/// Nodes above one another that are followed.
const DEEPEST: u64 = 64;

/// What an index says.
struct Index {
    levels: u64,
    files: Vec<String>,
    /// The file of the environment.
    environment: Option<usize>,
    root: Value,
}

/// Rows of a file that nodes have, by the file's number.
type Selected = BTreeMap<usize, Vec<Option<Range<usize>>>>;

/// Whether the JSON is such an index.
pub(super) fn is_index(json: &Value) -> bool {
    let has = |key: &str| json.get(key).is_some();
    json.get("root").is_some_and(Value::is_object) && (has("totalLevels") || has("lod_level"))
}

/// Levels of detail, and whether there is an environment.
pub(super) fn streamed(source: &Source<'_>, json: &Value) -> Result<(u32, bool), LoadError> {
    let index = Index::new(source.name(), json)?;
    Ok((index.levels as u32, index.environment.is_some()))
}

pub(super) fn read(
    source: &Source<'_>,
    json: &Value,
    files: &dyn Files,
    options: &LoadOptions,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let name = source.name();
    let index = Index::new(name, json)?;
    if let Some(level) = options.level_of_detail
        && u64::from(level) >= index.levels
    {
        let expected = format!("a level below {}, the number of levels", index.levels);
        return Err(LoadError::invalid(name, "level of detail", expected, level.to_string()));
    }
    let mut selected = Selected::new();
    index.select(name, &index.root, 0, options.level_of_detail, &mut selected)?;
    if let Some(environment) = index.environment.filter(|_| options.environment) {
        selected.entry(environment).or_default().push(None);
    }
    let mut all: Option<Gaussians> = None;
    let mut mode = OpacityMode::Default;
    let mut notes = Vec::new();
    let count = selected.len();
    let open = |(number, ranges): (usize, _)| {
        let Some(file) = index.files.get(number) else {
            let expected = format!("one of {} files", index.files.len());
            return Err(LoadError::invalid(name, "root", expected, number.to_string()));
        };
        Ok((files.open(&inside(name, "splatFiles", "", file)?)?, ranges))
    };
    // All files are asked for before one that is missing is told: who fetches files learns of all at once.
    let parts: Vec<_> = selected.into_iter().map(open).collect();
    for (i, part) in parts.into_iter().collect::<Result<Vec<_>, LoadError>>()?.into_iter().enumerate() {
        let (part, ranges): (_, Vec<Option<Range<usize>>>) = part;
        let part_progress = |share: f32| progress((i as f32 + share) / count as f32);
        let decoded = if part.head(2)?.starts_with(b"PK") {
            sog::read(&part, files, &part_progress)?
        } else {
            spz::read(&part, &part_progress)?
        };
        if decoded.opacity_mode == OpacityMode::Antialiased {
            mode = OpacityMode::Antialiased;
        }
        notes.extend(decoded.notes);
        let mut gaussians = decoded.gaussians;
        // Files of either kind hold the same numbers once SPZ's axes are undone.
        transform(&mut gaussians, &Similarity::orthogonal(decoded.axes.axes.to_rdf()));
        let rows = gaussians.len();
        if let Some(range) = ranges.iter().flatten().find(|range| range.end > rows) {
            let expected = format!("rows within the {rows} of {}", part.name());
            return Err(LoadError::invalid(name, "data.3dgs", expected, format!("{range:?}")));
        }
        let is_whole = ranges.iter().any(Option::is_none);
        if !is_whole {
            let mut is_kept = vec![false; rows];
            ranges.into_iter().flatten().for_each(|range| is_kept[range].fill(true));
            gaussians.retain(|_, i| is_kept[i]);
        }
        match &mut all {
            None => all = Some(gaussians),
            Some(all) => all.append(&gaussians),
        }
    }
    notes.sort_unstable();
    notes.dedup();
    let axes = FileAxes { axes: Axes::RFU, known_by: AxesKnownBy::Format };
    Ok(Decoded { axes, notes, ..Decoded::new(all.unwrap_or_default(), mode) })
}

impl Index {
    /// Of the fields in either of their spellings.
    fn new(name: &str, json: &Value) -> Result<Self, LoadError> {
        let invalid = |field: &str, expected: &str, actual: Option<&Value>| {
            let actual = actual.map_or_else(|| "nothing".to_owned(), |value| quoted(&value.to_string()));
            LoadError::invalid(name, field, expected, actual)
        };
        let levels = json.get("totalLevels").or_else(|| json.get("lod_level"));
        let Some(count) = levels.and_then(Value::as_u64).filter(|count| (1..=DEEPEST).contains(count)) else {
            return Err(invalid("totalLevels", "1 to 64", levels));
        };
        let root = json.get("root").cloned().unwrap_or_default();
        let old = root.get("files");
        let listed = root.get("splatFiles").or(old);
        let Some(names) = listed.and_then(Value::as_array) else {
            return Err(invalid("root.splatFiles", "names of files", listed));
        };
        let mut files = Vec::with_capacity(names.len());
        for file in names {
            let Some(text) = file.as_str() else {
                return Err(invalid("root.splatFiles", "names of files", Some(file)));
            };
            let text = text.trim_start_matches('/');
            let lacks_extension = old.is_some() && !text.ends_with(".sog");
            files.push(if lacks_extension { format!("{text}.sog") } else { text.to_owned() });
        }
        let environment =
            root.pointer("/data/env/name").and_then(Value::as_u64).map(|number| number as usize);
        Ok(Self { levels: count, files, environment, root })
    }

    /// Adds the rows of the nodes of `level` under `node`, which is at `depth`. Without a level, the rows of the
    /// leaves are added. Returns whether any were found.
    fn select(
        &self,
        name: &str,
        node: &Value,
        depth: u64,
        level: Option<u32>,
        selected: &mut Selected,
    ) -> Result<bool, LoadError> {
        if depth > DEEPEST {
            return Err(LoadError::invalid(
                name,
                "root",
                format!("at most {DEEPEST} levels of nodes"),
                "more",
            ));
        }
        let mut is_below = false;
        let children: Vec<&Value> = match node.get("child") {
            Some(Value::Array(children)) => children.iter().collect(),
            Some(Value::Object(children)) => children.values().collect(),
            _ => Vec::new(),
        };
        for child in children {
            is_below |= self.select(name, child, depth + 1, level, selected)?;
        }
        let data = node.pointer("/data/3dgs").filter(|_| depth > 0);
        let Some(number) = data.and_then(|data| data.get("name")).and_then(Value::as_u64) else {
            return Ok(is_below);
        };
        let number = number as usize;
        let is_wanted = match level {
            Some(level) => self.levels.checked_sub(depth) == Some(u64::from(level)),
            None => !is_below,
        };
        if is_wanted && self.environment != Some(number) {
            let of =
                |key: &str| data.and_then(|data| data.get(key)).and_then(Value::as_u64).map(|v| v as usize);
            let range = of("count").map(|count| {
                let start = of("start").unwrap_or(0);
                start..start.saturating_add(count)
            });
            selected.entry(number).or_default().push(range);
        }
        Ok(true)
    }
}

/// JSON with the commas before closing brackets that some exporters write.
pub(super) fn without_trailing_commas(text: &[u8]) -> Vec<u8> {
    let mut kept: Vec<u8> = Vec::with_capacity(text.len());
    let (mut is_text, mut is_escaped) = (false, false);
    for byte in text {
        if is_text {
            (is_text, is_escaped) = match byte {
                _ if is_escaped => (true, false),
                b'\\' => (true, true),
                b'"' => (false, false),
                _ => (true, false),
            };
        } else if *byte == b'"' {
            is_text = true;
        } else if matches!(byte, b'}' | b']') {
            let blank = kept.iter().rev().take_while(|byte| byte.is_ascii_whitespace()).count();
            let last = kept.len() - blank;
            if last > 0 && kept[last - 1] == b',' {
                kept.truncate(last - 1);
            }
        }
        kept.push(*byte);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trailing_commas_go_and_text_stays() {
        let text = br#"{"a": [1, 2, ], "b,}": "x,]", "c": {"d": "\",}", } ,}"#;
        let json: Value = serde_json::from_slice(&without_trailing_commas(text)).unwrap();
        assert_eq!(json["a"][1], 2);
        assert_eq!(json["b,}"], "x,]");
        assert_eq!(json["c"]["d"], "\",}");
    }
}
