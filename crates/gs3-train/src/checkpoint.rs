//! Checkpoints: folders from which a training goes on as if it had never stopped, bit for bit.
//!
//! A folder `step-N` holds `weights`, `average` and, once there is one, `best` as weights files, `adam.safetensors` and
//! `state.json`. It is written under another name and renamed when it is whole; older ones are removed then.

use std::fs;
use std::path::{Path, PathBuf};

use gs3_neural::{Adam, WeightError, Weights};
use serde::{Deserialize, Serialize};

use crate::error::TrainError;
use crate::trainer::{Best, State};

/// What folders of checkpoints are called, before their step.
const PREFIX: &str = "step-";

/// The end of the name of a folder that is not whole.
const UNFINISHED: &str = ".unfinished";

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
    let whole = folder.join(format!("{PREFIX}{}", state.steps()));
    let unfinished = folder.join(format!("{PREFIX}{}{UNFINISHED}", state.steps()));
    for old in [&unfinished, &whole] {
        if old.exists() {
            fs::remove_dir_all(old).map_err(at(old))?;
        }
    }
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
    fs::write(file("state.json"), rest).map_err(at(&file("state.json")))?;
    fs::rename(&unfinished, &whole).map_err(at(&whole))?;
    for (_, old) in all(folder)?.into_iter().filter(|(step, _)| *step != state.steps()) {
        fs::remove_dir_all(&old).map_err(at(&old))?;
    }
    Ok(())
}

/// The last state saved in `folder`, if there is one.
///
/// # Errors
/// [`TrainError`] if it cannot be read or is damaged.
pub fn load(folder: &Path) -> Result<Option<State>, TrainError> {
    let Some((step, place)) = all(folder)?.into_iter().max() else { return Ok(None) };
    let file = |name: &str| place.join(name);
    let weights = |name: &str| Weights::load(&file(name)).map_err(within(&file(name)));
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
    if !(rest.seconds.is_finite() && rest.seconds >= 0.0) {
        let (expected, actual) = ("at least 0".to_owned(), rest.seconds.to_string());
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

/// Whole checkpoints in a folder: their steps and places. None where there is no folder.
fn all(folder: &Path) -> Result<Vec<(u64, PathBuf)>, TrainError> {
    let mut found = Vec::new();
    if !folder.exists() {
        return Ok(found);
    }
    for entry in fs::read_dir(folder).map_err(at(folder))? {
        let path = entry.map_err(at(folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(step) = name.strip_prefix(PREFIX).and_then(|step| step.parse().ok()) {
            found.push((step, path));
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
