//! `gs3 train clips`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use gs3::NetworkError;
use gs3::neural::Weights;
use gs3::scene::{CameraPath, Scene, Size, demo, orbit};
use gs3_train::clips::{Batch, ClipSettings, ClipSource, preview};
use gs3_train::{ClipFile, ClipWindow, Network};
use indicatif::ProgressBar;

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::options::{KrigingArg, SceneOptions, StatedCameras};
use crate::cli::terminal::print;
use crate::cli::threads::start_threads;
use crate::cli::values::{DilationArg, size};
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::write_png;

/// Cameras of an orbit that clips start from; poses between them are used as well.
const ORBIT_CAMERAS: usize = 120;

/// Arguments of `gs3 train clips`.
#[derive(Debug, Args)]
pub struct ClipsArgs {
    /// Scene files or folders, or `demo` for the built-in scene; clips are spread evenly over them
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Cameras that clips are taken near, for a single scene: COLMAP model, transforms.json, cameras.json,
    /// camera_path.json, settings of SuperSplat or RealityScan's CSV [default: an orbit]
    #[arg(long, num_args = 1.., value_name = "CAMERAS")]
    pub paths: Vec<PathBuf>,
    /// The network that the clips are for
    #[arg(long)]
    pub network: NetworkArg,
    /// High-resolution over low-resolution size
    #[arg(long, default_value_t = 4, value_name = "S")]
    pub scale: u32,
    /// Clips in all
    #[arg(long, default_value_t = 400, value_name = "N")]
    pub count: usize,
    /// Frames of a clip
    #[arg(long, default_value_t = 8, value_name = "T")]
    pub frames: usize,
    /// High-resolution size of a clip, a window of a view of 1280x720 to 4096x2160
    #[arg(long, default_value = "256x256", value_name = "WxH", allow_hyphen_values = true, value_parser = size)]
    pub size: Size,
    /// Dilation of splats in px² of the low-resolution grid: matched (0.3/S²), kerbl (0.3, as in Kerbl et al.) or a number
    #[arg(long, default_value = "matched", value_name = "matched|kerbl|VALUE", allow_hyphen_values = true)]
    pub dilation: DilationArg,
    /// Which pixels are kriged: `coarse` for tier fast, `fine` for tier high, as `gs3 render` does below them
    #[arg(long, default_value = "on", value_name = "coarse|on|fine")]
    pub kriging: KrigingArg,
    /// Share of the clips, and of every path, that is kept for validation
    #[arg(long, default_value_t = 0.08, value_name = "FRACTION", allow_hyphen_values = true)]
    pub held_out: f64,
    /// Weights of super sampling, for the frames to interpolate between and for the previous frame of super sampling:
    /// those of the round of training before [default: frames without networks]
    #[arg(long, value_name = "FILE.safetensors")]
    pub weights: Option<PathBuf>,
    /// What all that is random depends on
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Folder for the clips; those that are there already are kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Also write a picture of the first clip, a row per frame: without networks, its uncertainty, its error, what is
    /// known from the frame before, native
    #[arg(long, value_name = "FILE.png")]
    pub preview: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum NetworkArg {
    /// From low to high resolution
    SuperSample,
    /// In-between frames
    Interpolate,
}

impl From<NetworkArg> for Network {
    fn from(network: NetworkArg) -> Self {
        match network {
            NetworkArg::SuperSample => Self::SuperSample,
            NetworkArg::Interpolate => Self::Interpolate,
        }
    }
}

pub fn run(args: &ClipsArgs) -> Result<Outcome, CliError> {
    start_threads(args.threads)?;
    let settings = ClipSettings {
        network: args.network.into(),
        scale: args.scale,
        frames: args.frames,
        size: args.size,
        dilation: args.dilation.0,
        held_out: args.held_out,
        seed: args.seed,
        kriging: args.kriging.into(),
        super_sample: args.weights.as_deref().map(weights).transpose()?,
    };
    settings.check()?;
    let names = names(args)?;
    let mut destinations = vec![Destination::folder("--out", &args.out)];
    destinations.extend(args.preview.iter().map(|file| Destination::file("--preview", file, "png")));
    let inputs = args.scenes.iter().chain(&args.paths).chain(&args.weights);
    destination::check(&destinations, inputs.map(PathBuf::as_path))?;
    std::fs::create_dir_all(&args.out).map_err(CliError::write(&args.out))?;
    interrupt::watch()?;
    // Rounded, so that a few clips of many scenes still give some to validate on.
    let held_out = (args.count as f64 * args.held_out).round() as usize;
    let share = |all: usize, k: usize| all * (k + 1) / names.len() - all * k / names.len();
    let mut first = None;
    for (k, (file, name)) in args.scenes.iter().zip(&names).enumerate() {
        let (scene, _) = inputs::scene_at(file, args.scene_options)?;
        let paths = paths(args, file, &scene)?;
        let source = ClipSource { name: name.clone(), scene, paths };
        let batch = Batch {
            source: &source,
            settings: &settings,
            training: share(args.count - held_out, k),
            held_out: share(held_out, k),
            folder: &args.out,
        };
        make(&batch)?;
        if interrupt::requested() {
            return Ok(Outcome::Interrupted);
        }
        // With few clips a scene may have none.
        let kind =
            [(batch.training, ""), (batch.held_out, "held_")].into_iter().find(|(count, _)| *count > 0);
        first = first.or_else(|| Some(args.out.join(format!("{}{name}_0000.clip", kind?.1))));
    }
    if let (Some(picture), Some(clip)) = (&args.preview, first) {
        let clip = ClipFile::open(&clip)?;
        let [rows, columns] = clip.lr().map(|side| 0..side);
        write_png(picture, &preview(&clip.read(&ClipWindow { frames: 0..clip.frames(), rows, columns })?))?;
    }
    Ok(Outcome::Done)
}

/// Makes clips of one scene, showing progress, and says how good frames without networks are.
fn make(batch: &Batch<'_>) -> Result<(), CliError> {
    let (name, missing) = (&batch.source.name, batch.missing());
    let bar = ProgressBar::new(missing as u64)
        .with_style(inputs::style("{msg} {pos}/{len} clips {wide_bar} {per_sec}, {eta} left"))
        .with_message(name.clone());
    let started = std::time::Instant::now();
    let mut decibels = Vec::new();
    batch.make(|made| {
        bar.inc(1);
        decibels.push(made.analytic_psnr);
        !interrupt::requested()
    })?;
    bar.finish_and_clear();
    if !decibels.is_empty() {
        decibels.sort_by(f64::total_cmp);
        let at = |share: f64| decibels[(share * (decibels.len() - 1) as f64) as usize];
        print(format_args!(
            "{name}: {} clips, {:.2} clips/s, without networks {:.1} dB at the median, {:.1} to {:.1} dB\n",
            decibels.len(),
            decibels.len() as f64 / started.elapsed().as_secs_f64(),
            at(0.5),
            at(0.0),
            at(1.0),
        ))?;
    }
    Ok(())
}

fn weights(file: &Path) -> Result<Arc<Weights>, CliError> {
    let error = |source| CliError::Weights { path: file.to_owned(), source };
    Ok(Arc::new(Weights::load(file).map_err(|e| error(NetworkError::from(e)))?))
}

/// What the clips of each scene are called.
fn names(args: &ClipsArgs) -> Result<Vec<String>, CliError> {
    let names: Vec<String> = args.scenes.iter().map(|scene| name(scene)).collect();
    let different = names.iter().collect::<BTreeSet<_>>().len();
    if different < names.len() {
        return Err(CliError::Option {
            option: "SCENE",
            expected: "scenes with different names".to_owned(),
            actual: names.join(", "),
        });
    }
    if !args.paths.is_empty() && names.len() > 1 {
        return Err(CliError::Option {
            option: "--paths",
            expected: "a single scene, that the cameras are of".to_owned(),
            actual: format!("{} scenes", names.len()),
        });
    }
    Ok(names)
}

/// The name of a scene's file without extensions, or of the folder that it is the entry of.
fn name(scene: &Path) -> String {
    let is_entry = scene.file_name().is_some_and(|file| file == "lod-meta.json" || file == "meta.json");
    let named = if is_entry { scene.parent().unwrap_or(scene) } else { scene };
    let file = named.file_name().map_or_else(|| "scene".into(), |name| name.to_string_lossy());
    file.split('.').find(|part| !part.is_empty()).unwrap_or("scene").to_owned()
}

/// Cameras that clips of a scene are taken near.
fn paths(args: &ClipsArgs, file: &Path, scene: &Scene) -> Result<Vec<CameraPath>, CliError> {
    if !args.paths.is_empty() {
        let stated = StatedCameras::default();
        return args.paths.iter().map(|path| inputs::capture(path, &stated, None, scene)).collect();
    }
    let orbit = orbit::around(scene, ORBIT_CAMERAS, 1920, 1080)?;
    Ok(if inputs::is_demo(file) { vec![demo::path(), orbit] } else { vec![orbit] })
}
