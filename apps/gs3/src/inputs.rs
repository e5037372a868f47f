//! Scenes and cameras named on the command line.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::Networks;
use gs3::neural::model::Tier;
use gs3::neural::{Arithmetic, WeightError, Weights};
use gs3::raster::NEAR;
use gs3::scene::format::{self, Streamed};
use gs3::scene::{CameraPath, Scene, capture, demo, orbit};
use indicatif::{ProgressBar, ProgressStyle};

use crate::args::{InterpolationArg, Look, View};
use crate::error::CliError;
use crate::levels::Levels;
use crate::terminal::note;
use crate::values::{FrameRange, Size};

/// Size of frames along generated paths.
const DEFAULT_SIZE: Size = Size { width: 1920, height: 1080 };

/// Frames of a generated orbit: 10 s at 30 rendered frames per second.
const ORBIT_FRAMES: usize = 300;

/// Whether `path` names the built-in scene.
pub fn is_demo(path: &Path) -> bool {
    path.as_os_str() == "demo"
}

/// What the scene has to choose from, if it is streamed.
pub fn streamed(path: &Path) -> Result<Option<Streamed>, CliError> {
    // A pipe gives what it has only once.
    let is_there = path.metadata().is_ok_and(|found| found.is_file() || found.is_dir());
    if is_demo(path) || !is_there { Ok(None) } else { Ok(format::streamed(path)?) }
}

/// Loads the scene, showing progress, and says how long it took.
pub fn scene(path: &Path) -> Result<(Arc<Scene>, Duration), CliError> {
    scene_at(path, Levels::default())
}

/// The same, and of a scene that holds several representations of itself what `levels` asks for.
pub fn scene_at(path: &Path, levels: Levels) -> Result<(Arc<Scene>, Duration), CliError> {
    let started = Instant::now();
    let options = levels.options(path)?;
    let scene = if is_demo(path) {
        demo::scene()?
    } else {
        let bar = ProgressBar::new(1000).with_style(style("loading {wide_bar} {percent}%"));
        let scene = format::load(path, &options, &|share| bar.set_position((share * 1000.0) as u64))?;
        bar.finish_and_clear();
        scene
    };
    Ok((Arc::new(scene), started.elapsed()))
}

/// Says that figures or pictures are of nothing.
pub fn warn_of_nothing_visible() {
    note(format_args!(
        "warning: no Gaussian is visible in any frame: cameras look elsewhere, or from nearer than {NEAR}"
    ));
}

/// Checks that the cameras of the frames `range` see pictures of one size, as `what` has; `option` is told.
pub fn check_one_size(
    option: &'static str,
    what: &str,
    range: &Range<usize>,
    path: &CameraPath,
) -> Result<(), CliError> {
    let size = |k: usize| format!("{}x{}", path.cameras()[k].width(), path.cameras()[k].height());
    let first = size(range.start);
    match range.clone().find(|k| size(*k) != first) {
        None => Ok(()),
        Some(other) => Err(CliError::Option {
            option,
            expected: format!("frames of one size for {what}, which --size WxH makes them"),
            actual: format!("{first} in frame {} and {} in frame {other}", range.start, size(other)),
        }),
    }
}

/// The networks that `look` names, and their tier's name for reports.
pub fn networks(look: &Look) -> Result<(Networks, String), CliError> {
    let (networks, tier) = weights(look)?;
    let has_none = networks.super_sample.is_none() && networks.interpolate.is_none();
    let option = match look {
        Look { arithmetic: Some(_), .. } => Some("--arithmetic"),
        Look { matrix_products: true, .. } => Some("--matrix-products"),
        _ => None,
    };
    if let Some(option) = option.filter(|_| has_none) {
        let expected = "a tier with a network, which it is for".to_owned();
        return Err(CliError::Option { option, expected, actual: tier });
    }
    let arithmetic = look.arithmetic.map(Arithmetic::from).unwrap_or_default();
    Ok((Networks { arithmetic, ..networks }, tier))
}

/// The weights that `look` names, and their tier's name.
fn weights(look: &Look) -> Result<(Networks, String), CliError> {
    if !look.weights.is_empty() {
        let mut networks = Networks::default();
        let mut tiers = Vec::new();
        for file in &look.weights {
            let error = |source| CliError::Weights { path: file.clone(), source };
            let weights = weights_in(file)?;
            tiers.push(weights.header.tier.clone());
            networks.add(weights).map_err(error)?;
        }
        if networks.super_sample.is_none() {
            // Weights take the place of those of their network alone: the other one is as it is without them.
            tiers.insert(0, "analytic".to_owned());
        }
        tiers.dedup();
        return Ok((networks, tiers.join("+")));
    }
    let is_learned = look.interpolation == InterpolationArg::Learned;
    let shipped = |tier: Tier| {
        let networks = Networks::shipped(look.scale, tier)?;
        if is_learned && networks.interpolate.is_none() {
            return Err(no_interpolation(&format!("{} at scale {}", tier.name(), look.scale)));
        }
        let interpolate = networks.interpolate.filter(|_| is_learned);
        Ok((Networks { interpolate, ..networks }, tier.name().to_owned()))
    };
    let analytic = || match is_learned {
        false => Ok((Networks::default(), "analytic".to_owned())),
        true => Err(no_interpolation("analytic")),
    };
    match look.tier.network() {
        Some(tier) => shipped(tier),
        None => analytic(),
    }
}

/// The weights in `file`.
pub fn weights_in(file: &Path) -> Result<Weights, CliError> {
    Weights::load(file).map_err(|error| match error {
        // It names the file itself.
        WeightError::File { .. } => CliError::Network(error.into()),
        _ => CliError::Weights { path: file.to_owned(), source: error.into() },
    })
}

/// That no interpolation network comes with a tier.
fn no_interpolation(tier: &str) -> CliError {
    CliError::Option {
        option: "--interpolation",
        expected: format!("analytic, as no interpolation network comes for tier {tier}"),
        actual: "learned".to_owned(),
    }
}

/// The cameras of `view` at the size asked for.
pub fn cameras(view: &View, scene: &Scene) -> Result<CameraPath, CliError> {
    let path = match &view.path {
        Some(file) => capture::load(file)?,
        None if is_demo(&view.scene) => demo::path(),
        None => orbit::around(scene, ORBIT_FRAMES, DEFAULT_SIZE.width, DEFAULT_SIZE.height)?,
    };
    let size = view.size.or(view.path.is_none().then_some(DEFAULT_SIZE));
    Ok(size.map_or(Ok(path.clone()), |size| path.resized(size.width, size.height))?)
}

/// The frames asked for, else the first `count`, or as many as the path has.
pub fn first_frames(asked: Option<&FrameRange>, count: usize, path: &CameraPath) -> Range<usize> {
    asked.map_or_else(|| 0..count.min(path.cameras().len()), |frames| frames.0.clone())
}

/// Checks that the path has these frames.
pub fn check_frames(option: &'static str, range: &Range<usize>, path: &CameraPath) -> Result<(), CliError> {
    let count = path.cameras().len();
    if range.end <= count {
        return Ok(());
    }
    Err(CliError::Option {
        option,
        expected: format!("frames within 0..{count}, as many as the path has"),
        actual: format!("{}..{}", range.start, range.end),
    })
}

/// A progress bar's looks; they are constants of this program, checked by every run.
pub fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}
