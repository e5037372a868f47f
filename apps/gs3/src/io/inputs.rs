//! Scenes and cameras named on the command line.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::Networks;
use gs3::neural::model::Tier;
use gs3::neural::{Arithmetic, WeightError, Weights};
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::capture::CaptureOptions;
use gs3::scene::format::{self, Budget, LoadOptions, Streamed};
use gs3::scene::glam::{DMat3, DVec3};
use gs3::scene::transform::Similarity;
use gs3::scene::{Camera, CameraPath, Scene, Size, capture, demo, orbit};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;

use crate::cli::error::{CliError, single_line};
use crate::cli::options::{FrameOptions, InterpolationArg, SceneOptions, StatedCameras, Switch, View};
use crate::cli::terminal::note;
use crate::cli::values::{Degrees, Distance, FrameRange};

/// Size of frames along generated paths.
const DEFAULT_SIZE: Size = Size::new(1920, 1080);

/// Frames of a generated orbit: 15 s at the 20 rendered frames per second of generated paths.
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

/// What to load of `scene`, which `cameras` see. Options that the scene would not read are refused.
fn load_options(options: SceneOptions, scene: &Path, cameras: Vec<Camera>) -> Result<LoadOptions, CliError> {
    let given = options.lod.map(|_| "--lod");
    let given = given.or(options.budget.map(|_| "--budget")).or(options.environment.map(|_| "--environment"));
    if let Some(option) = given
        && streamed(scene)?.is_none()
    {
        return Err(CliError::Option {
            option,
            expected: "a streamed scene (lod-meta.json), which has levels and an environment".to_owned(),
            actual: scene.display().to_string(),
        });
    }
    if options.axes.is_some() && is_demo(scene) {
        let expected = "a scene file, which has axes to state".to_owned();
        return Err(CliError::Option { option: "--axes", expected, actual: "demo".to_owned() });
    }
    let environment = !matches!(options.environment, Some(Switch::Off));
    let budget = options.budget.map(|gaussians| Budget { gaussians, cameras });
    Ok(LoadOptions { level_of_detail: options.lod, budget, environment, axes: options.axes })
}

/// As [`scene_at`]. A budget of Gaussians is spent where the cameras of `view` see most of it.
pub fn scene_of(view: &View, options: SceneOptions) -> Result<(Arc<Scene>, Duration), CliError> {
    /// More cameras of a path change little, and each visits all parts of a scene.
    const CAMERAS: usize = 64;
    let cameras = match (&view.path, options.budget) {
        (Some(file), Some(_)) => {
            let path = capture::load_with(file, &capture_options(&view.stated, view.size))?;
            let cameras = path.cameras();
            cameras.iter().step_by(cameras.len().div_ceil(CAMERAS)).copied().collect()
        }
        _ => Vec::new(),
    };
    load(&view.scene, options, cameras)
}

/// Loads the scene as `options` ask for, showing progress; says what its file has that is not used, and how long it took.
pub fn scene_at(path: &Path, options: SceneOptions) -> Result<(Arc<Scene>, Duration), CliError> {
    load(path, options, Vec::new())
}

fn load(
    path: &Path,
    options: SceneOptions,
    cameras: Vec<Camera>,
) -> Result<(Arc<Scene>, Duration), CliError> {
    let started = Instant::now();
    let load_options = load_options(options, path, cameras)?;
    let mut scene = if is_demo(path) {
        demo::scene()?
    } else {
        let bar = ProgressBar::new(1000).with_style(style("loading {wide_bar} {percent}%"));
        let scene = format::load(path, &load_options, &|share| bar.set_position((share * 1000.0) as u64))?;
        bar.finish_and_clear();
        scene
    };
    if let Some(Distance(near)) = options.near {
        scene = scene.with_near(near);
    }
    for text in &scene.details().notes {
        note(format_args!("{}: {}", path.display(), single_line(text)));
    }
    if scene.dropped().total() > 0 {
        note(format_args!("{}: {} invalid Gaussians are left out", path.display(), scene.dropped()));
    }
    Ok((Arc::new(scene), started.elapsed()))
}

/// Says that figures or pictures are of nothing.
pub fn warn_of_nothing_visible(near: f32) {
    note(format_args!(
        "warning: no Gaussian is visible in any frame: cameras look elsewhere, or from nearer than the near plane, {near}"
    ));
}

/// Checks that the cameras of the frames `range` have pictures of one size, which `what` needs. The error names
/// `option`.
pub fn check_one_size(
    option: &'static str,
    what: &str,
    range: &Range<usize>,
    path: &CameraPath,
) -> Result<(), CliError> {
    let size = |k: usize| path.cameras()[k].size();
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
pub fn networks(look: &FrameOptions) -> Result<(Networks, String), CliError> {
    let (networks, tier) = weights(look)?;
    let has_none = networks.super_sample.is_none() && networks.interpolate.is_none();
    let option = match look {
        FrameOptions { arithmetic: Some(_), .. } => Some("--arithmetic"),
        FrameOptions { matrix_products: true, .. } => Some("--matrix-products"),
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
fn weights(look: &FrameOptions) -> Result<(Networks, String), CliError> {
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
            // Weights replace the weights of their own network only; the other network stays as without them.
            tiers.insert(0, "analytic".to_owned());
        }
        tiers.dedup();
        return Ok((networks, tiers.join("+")));
    }
    let is_learned = look.interpolation == InterpolationArg::Learned;
    let shipped = |tier: Tier| {
        let scale = look.scale.of_networks();
        let networks = Networks::shipped(scale, tier)?;
        if is_learned && networks.interpolate.is_none() {
            return Err(no_interpolation(&format!("{} at scale {scale}", tier.name())));
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

fn capture_options(stated: &StatedCameras, size: Option<Size>) -> CaptureOptions {
    CaptureOptions {
        size,
        fov_y: stated.fov.map(|fov| fov.0.to_radians()),
        dataparser: stated.dataparser.clone(),
    }
}

/// The cameras in `file`, brought into the frame of `scene`, as far as they are `stated` outside of it; `size` is for
/// cameras without a size in their file. Says what the file has that is not used.
pub fn capture(
    file: &Path,
    stated: &StatedCameras,
    size: Option<Size>,
    scene: &Scene,
) -> Result<CameraPath, CliError> {
    let mut path = capture::load_with(file, &capture_options(stated, size))?;
    for text in &path.facts().notes {
        note(format_args!("{}: {}", file.display(), single_line(text)));
    }
    if let Some(Degrees(fov)) = stated.fov {
        path = path.with_fov_y(fov.to_radians())?;
    }
    let origin = scene.details().origin;
    if origin != DVec3::ZERO {
        path =
            path.in_moved_world(&Similarity { shift: -origin, ..Similarity::orthogonal(DMat3::IDENTITY) })?;
    }
    Ok(path)
}

/// Says how many Gaussians in view of a camera are nearer than the near plane, if any are: a look at a few of `cameras`.
pub fn tell_what_is_too_near(scene: &Scene, cameras: &[Camera]) {
    /// A look takes as long as a tenth of a frame.
    const LOOKS: usize = 8;
    let near = scene.details().near;
    let cut = |camera: &Camera| {
        let intrinsics = camera.intrinsics();
        let gaussians = scene.gaussians();
        let is_cut = |i: &usize| {
            let (pixel, z) = camera.project(DVec3::from(gaussians.mean(*i).map(f64::from)));
            let is_inside = pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x <= f64::from(intrinsics.width)
                && pixel.y <= f64::from(intrinsics.height);
            // Fainter ones are not drawn anywhere.
            z > 0.0 && z <= f64::from(near) && is_inside && gaussians.opacities[*i] >= 1.0 / 255.0
        };
        (0..gaussians.len()).into_par_iter().filter(is_cut).count()
    };
    let most = cameras.iter().step_by(cameras.len().div_ceil(LOOKS).max(1)).map(cut).max().unwrap_or(0);
    if most > 0 {
        note(format_args!(
            "{most} Gaussians in view of a camera are nearer than the near plane, {near}, and not shown (--near sets it)"
        ));
    }
}

/// Whether the camera's image is larger than what is rendered at once.
pub fn is_large(camera: &Camera) -> bool {
    camera.width().max(camera.height()) > MAX_SIDE
}

/// Refuses cameras of `view` with images larger than what is rendered at once.
pub fn check_renderable(view: &View, path: &CameraPath) -> Result<(), CliError> {
    let Some(camera) = path.cameras().iter().find(|camera| is_large(camera)) else { return Ok(()) };
    let size = camera.size();
    let most = format!("a size up to {MAX_SIDE}x{MAX_SIDE} (gs3 render --mode native makes larger pictures)");
    let (expected, actual) = match view.size {
        Some(_) => (most, size.to_string()),
        None => (format!("{most}, as the images of the cameras are larger"), format!("none, for {size}")),
    };
    Err(CliError::Option { option: "--size", expected, actual })
}

/// The cameras of `view` at the size asked for, none of them larger than what is rendered at once.
pub fn cameras(view: &View, scene: &Scene) -> Result<CameraPath, CliError> {
    let path = cameras_of_any_size(view, scene)?;
    check_renderable(view, &path)?;
    Ok(path)
}

/// The cameras of `view` at the size asked for.
pub fn cameras_of_any_size(view: &View, scene: &Scene) -> Result<CameraPath, CliError> {
    let given = view.stated.fov.map(|_| "--fov").or(view.stated.dataparser.as_ref().map(|_| "--dataparser"));
    if let (None, Some(option)) = (&view.path, given) {
        let expected = "--path with it, for it is about cameras of a file".to_owned();
        return Err(CliError::Option { option, expected, actual: "none".to_owned() });
    }
    let path = match &view.path {
        Some(file) => capture(file, &view.stated, view.size, scene)?,
        None if is_demo(&view.scene) => demo::path(),
        None => orbit::around(scene, ORBIT_FRAMES, DEFAULT_SIZE.width, DEFAULT_SIZE.height)?,
    };
    let size = view.size.or(view.path.is_none().then_some(DEFAULT_SIZE));
    Ok(size.map_or(Ok(path.clone()), |size| path.resized(size.width, size.height))?)
}

/// Refuses panoramas, which only `gs3 render` makes.
pub fn check_is_perspective(path: &CameraPath) -> Result<(), CliError> {
    match path.facts().is_panorama {
        false => Ok(()),
        true => Err(CliError::Option {
            option: "--path",
            expected: "perspective cameras (gs3 render makes panoramas)".to_owned(),
            actual: "equirectangular ones".to_owned(),
        }),
    }
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
