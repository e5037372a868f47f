//! Checkpoints: folders from which a training goes on as if it had never stopped, bit for bit.
//!
//! A folder `step-N` holds `weights`, `average` and, once there is one, `best` as weights files, `adam.safetensors` and
//! `state.json`. It is written under another name and renamed when it is whole; older ones are removed then, so that at
//! every moment one is there.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use gs3_files::write_atomically;
use gs3_neural::{Adam, WeightError, Weights};
use serde::{Deserialize, Serialize};

use crate::error::TrainError;
use crate::settings::MAX_SECONDS;
use crate::state::{Best, State};

/// What folders of checkpoints are called, before their step.
const PREFIX: &str = "step-";

/// The end of the name of a folder that is not whole.
const UNFINISHED: &str = ".unfinished";

/// The end of the name of a whole folder that another one of its step takes the place of.
const REPLACED: &str = ".replaced";

/// What no other file of a checkpoint says.
#[derive(Debug, Serialize, Deserialize)]
struct Rest {
    seconds: f64,
    best: Option<BestOf>,
}

#[derive(Debug, Serialize, Deserialize)]
struct BestOf {
    step: u64,
    gain: f64,
    /// In hexadecimal. Earlier checkpoints have none: their record is none of any clips.
    #[serde(default)]
    held: String,
}

/// Writes `state` to a folder in `folder`, whole or not at all.
///
/// # Errors
/// [`TrainError`] if it cannot be written.
pub fn save(folder: &Path, state: &State) -> Result<(), TrainError> {
    let place = |end: &str| folder.join(format!("{PREFIX}{}{end}", state.steps()));
    let [whole, unfinished, replaced] = ["", UNFINISHED, REPLACED].map(place);
    remove(&unfinished)?;
    fs::create_dir_all(&unfinished).map_err(at(&unfinished))?;
    let file = |name: &str| unfinished.join(name);
    save_weights(&file("weights.safetensors"), &state.weights)?;
    save_weights(&file("average.safetensors"), &state.average)?;
    state.adam.save(&file("adam.safetensors")).map_err(within(&file("adam.safetensors")))?;
    if let Some(best) = &state.best {
        save_weights(&file("best.safetensors"), &best.weights)?;
    }
    let best = state.best.as_ref().map(|best| BestOf {
        step: best.step,
        gain: best.gain,
        held: format!("{:016x}", best.held),
    });
    let rest = serde_json::to_string_pretty(&Rest { seconds: state.seconds, best });
    let rest = rest.map_err(|e| at(&file("state.json"))(e.into()))?;
    write_atomically(&file("state.json"), |writer| writer.write_all(rest.as_bytes()))
        .map_err(at(&file("state.json")))?;
    // A folder cannot take the place of another at once; in between the old one is found by its other name.
    if whole.exists() {
        remove(&replaced)?;
        fs::rename(&whole, &replaced).map_err(at(&replaced))?;
    }
    fs::rename(&unfinished, &whole).map_err(at(&whole))?;
    for Found { place, .. } in all(folder)?.into_iter().filter(|found| found.place != whole) {
        remove(&place)?;
    }
    Ok(())
}

/// Removes a folder that may be there.
fn remove(folder: &Path) -> Result<(), TrainError> {
    if folder.exists() { fs::remove_dir_all(folder).map_err(at(folder)) } else { Ok(()) }
}

/// The last state saved in `folder`, if there is one.
///
/// # Errors
/// [`TrainError`] if it cannot be read or is damaged.
pub fn load(folder: &Path) -> Result<Option<State>, TrainError> {
    let Some(Found { step, place, .. }) = all(folder)?.into_iter().max() else { return Ok(None) };
    let file = |name: &str| place.join(name);
    let weights = |name: &str| Weights::load(file(name)).map_err(within(&file(name)));
    let path = file("state.json");
    let text = fs::read_to_string(&path).map_err(at(&path))?;
    let rest: Rest = serde_json::from_str(&text).map_err(|e| TrainError::Checkpoint {
        path: path.clone(),
        field: "content",
        expected: "the state of a training".to_owned(),
        actual: e.to_string(),
    })?;
    let adam = Adam::load(&file("adam.safetensors")).map_err(within(&file("adam.safetensors")))?;
    if adam.steps() != step {
        let (expected, actual) = (step.to_string(), adam.steps().to_string());
        return Err(TrainError::Checkpoint {
            path: file("adam.safetensors"),
            field: "step",
            expected,
            actual,
        });
    }
    if !(0.0..=MAX_SECONDS).contains(&rest.seconds) {
        let (expected, actual) = (format!("0 to {MAX_SECONDS}"), rest.seconds.to_string());
        return Err(TrainError::Checkpoint { path, field: "seconds", expected, actual });
    }
    let best = match rest.best {
        Some(BestOf { step, gain, held }) => {
            let held = u64::from_str_radix(&held, 16).unwrap_or_default();
            Some(Best { weights: weights("best.safetensors")?, step, gain, held })
        }
        None => None,
    };
    let (weights, average) = (weights("weights.safetensors")?, weights("average.safetensors")?);
    Ok(Some(State { weights, average, adam, best, seconds: rest.seconds }))
}

/// Writes a weights file, whole or not at all, and its folder where there is none.
///
/// # Errors
/// [`TrainError`] if it cannot be written.
pub fn save_weights(path: &Path, weights: &Weights) -> Result<(), TrainError> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(at(folder))?;
    }
    weights.save(path).map_err(within(path))
}

/// A whole checkpoint; the one to go on from is the greatest.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Found {
    step: u64,
    /// Whether none of its step was to take its place.
    is_newest: bool,
    place: PathBuf,
}

/// Whole checkpoints in a folder. None where there is no folder.
fn all(folder: &Path) -> Result<Vec<Found>, TrainError> {
    let mut found = Vec::new();
    if !folder.exists() {
        return Ok(found);
    }
    for entry in fs::read_dir(folder).map_err(at(folder))? {
        let place = entry.map_err(at(folder))?.path();
        let name = place.file_name().unwrap_or_default().to_string_lossy();
        let Some(step) = name.strip_prefix(PREFIX) else { continue };
        let (step, is_newest) = step.strip_suffix(REPLACED).map_or((step, true), |step| (step, false));
        if let Ok(step) = step.parse() {
            found.push(Found { step, is_newest, place });
        }
    }
    Ok(found)
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> TrainError + '_ {
    |source| TrainError::File { path: path.to_owned(), source }
}

/// What is wrong with the weights file at `path`.
pub(crate) fn within(path: &Path) -> impl Fn(WeightError) -> TrainError + '_ {
    |source| match source {
        // It names the file itself.
        source @ WeightError::File { .. } => source.into(),
        source => TrainError::WeightsFile { path: path.to_owned(), source },
    }
}
