//! The choice of clips, and parts of clips, for each step of training.

use std::path::{Path, PathBuf};

use gs3_neural::Random;

use crate::clip::{Clip, ClipError, ClipFile, ClipWindow, Symmetry};
use crate::error::TrainError;
use crate::settings::{Settings, Symmetries};

/// What files of clips are called.
const EXTENSION: &str = "clip";

/// How names of clips begin that are kept from training.
const HELD: &str = "held";

/// Clips of a folder.
#[derive(Clone, Debug, Default)]
pub struct ClipFolder {
    /// Those to train on, by name.
    pub train: Vec<ClipFile>,
    /// The clips for validation: their names begin with `held`.
    pub held: Vec<ClipFile>,
}

impl ClipFolder {
    /// Opens all clips of a folder that a training can use.
    ///
    /// # Errors
    /// [`TrainError`] if there are none to train on, or one is damaged, for another network or scale, or too small.
    pub fn open(folder: &Path, settings: &Settings) -> Result<Self, TrainError> {
        let file = |source| TrainError::File { path: folder.to_owned(), source };
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(file)? {
            let path = entry.map_err(file)?.path();
            if path.extension().is_some_and(|extension| extension == EXTENSION) {
                paths.push(path);
            }
        }
        // Folders have no order of their own; what is trained on must not depend on theirs.
        paths.sort();
        let mut clips = Self::default();
        for path in paths {
            let mut clip = ClipFile::open(&path)?;
            let held = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(HELD));
            check(&clip, settings, held)?;
            if let Some(planes) = settings.subject.planes() {
                clip.keep(planes);
            }
            if held { clips.held.push(clip) } else { clips.train.push(clip) }
        }
        match clips.train.is_empty() {
            true => Err(TrainError::NoClips { folder: folder.to_owned() }),
            false => Ok(clips),
        }
    }

    /// A number that stands for names and content of the held-out clips, never 0: other clips have another one, but for
    /// 1 in 2⁶⁴. Clips that were rendered again have the names and sizes of the old ones, so all of them is read.
    ///
    /// # Errors
    /// [`TrainError`] if a clip cannot be read.
    pub fn digest(&self) -> Result<u64, TrainError> {
        let mut state = self.held.len() as u64;
        let mut add = |number: u64| state = Random::new(state ^ number).next_bits();
        for clip in &self.held {
            let path = clip.path();
            let file = |source| TrainError::File { path: path.to_owned(), source };
            let bytes = std::fs::read(path).map_err(file)?;
            let name = path.file_name().unwrap_or_default().as_encoded_bytes();
            for part in [name, &bytes] {
                let (numbers, rest) = part.as_chunks();
                numbers.iter().for_each(|bytes| add(u64::from_le_bytes(*bytes)));
                rest.iter().for_each(|byte| add(u64::from(*byte)));
                add(part.len() as u64);
            }
        }
        Ok(state.max(1))
    }
}

/// Whether `clip` is for the network of `settings`, and large enough.
fn check(clip: &ClipFile, settings: &Settings, held: bool) -> Result<(), TrainError> {
    let path: PathBuf = clip.path().to_owned();
    let fail = |expected: String, actual: String| {
        Err(TrainError::OtherClip { path: path.clone(), expected, actual })
    };
    let (network, scale) = (settings.subject.clips(), settings.scale);
    if (clip.network(), clip.scale()) != (network, scale) {
        return fail(
            format!("a clip for {} at scale {scale}", network.name()),
            format!("one for {} at scale {}", clip.network().name(), clip.scale()),
        );
    }
    let (lr, crop) = (clip.lr(), settings.crop);
    if !held && (clip.frames() < settings.window || lr.iter().any(|side| *side < crop)) {
        return fail(
            format!("at least {} frames of {crop}×{crop} LR pixels", settings.window),
            format!("{} frames of {}×{}", clip.frames(), lr[1], lr[0]),
        );
    }
    Ok(())
}

/// What an item of a step is trained on.
#[derive(Clone, Debug)]
pub struct Choice<'a> {
    clip: &'a ClipFile,
    window: ClipWindow,
    symmetry: Symmetry,
}

impl<'a> Choice<'a> {
    /// Item `item` of step `step`: one of `clips`, the part of it and how that is laid down; none without clips. It
    /// depends on nothing but the seed, so a training that is taken up again goes on as if it had never stopped.
    #[must_use]
    pub fn new(clips: &'a [ClipFile], settings: &Settings, step: u64, item: usize) -> Option<Self> {
        let place = step.wrapping_mul(settings.batch as u64).wrapping_add(item as u64);
        // One output of the generator scatters neighbouring seeds over all states.
        let mut random = Random::new(Random::new(settings.seed).next_bits().wrapping_add(place));
        let mut random = Random::new(random.next_bits());
        let mut below = |n: usize| (random.next_bits() % (n.max(1) as u64)) as usize;
        let clip = clips.get(below(clips.len()))?;
        let mut part = |whole: usize, part: usize| {
            let start = below((whole + 1).saturating_sub(part));
            start..start + part
        };
        let frames = part(clip.frames(), settings.window);
        let [rows, columns] = clip.lr().map(|side| part(side, settings.crop));
        let symmetry = match settings.symmetries {
            Symmetries::All => Symmetry::ALL[below(Symmetry::ALL.len())],
            Symmetries::None => Symmetry::default(),
        };
        Some(Self { clip, window: ClipWindow { frames, rows, columns }, symmetry })
    }

    /// Reads it.
    ///
    /// # Errors
    /// [`ClipError`] if the file has changed.
    pub fn read(&self) -> Result<Clip, ClipError> {
        Ok(self.symmetry.apply(self.clip.read(&self.window)?))
    }
}
