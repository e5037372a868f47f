//! `gs3 view`.

use std::path::PathBuf;
use std::sync::Arc;

use gs3::scene::{CameraPath, Scene, Size, demo};
use gs3::{MAX_IN_BETWEEN, Mode, Networks, PipelineSettings, Refine, SessionSettings};
use gs3_viewer::opening::nothing;
use gs3_viewer::window::{self, WindowSettings};
use gs3_viewer::{Script, ViewerSettings};

use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::{Device, SceneOptions, StatedCameras, TierArg};
use crate::cli::threads::start_threads;
use crate::cli::values::size;
use crate::io::inputs;

/// What the keys do.
const HELP: &str = "Keys: H in the window lists them. Left drag orbits, right drag pans, the wheel moves closer, W A S D Q E fly, a double \
click sets the pivot, F frames the scene, R goes back, C compares, V shows depth and more, P takes a screenshot, O asks \
for files to open; a file dropped into the window is opened, too. The controls (M) record a camera path and make videos. \
docs/viewer.md has the rest, and the steps of scripts.";

#[derive(Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct ViewArgs {
    /// Scene file or folder, `demo` for the built-in scene, or the http or https URL of a scene file or a lod-meta.json
    #[arg(default_value = "demo")]
    pub scene: PathBuf,
    /// Cameras to begin with and to play: COLMAP model, transforms.json, cameras.json, camera_path.json,
    /// settings of SuperSplat or RealityScan's CSV [default: all of the scene in view]
    #[arg(long, value_name = "CAMERAS")]
    pub path: Option<PathBuf>,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Size of the window's picture
    #[arg(long, value_name = "WxH", default_value = "1280x720", allow_hyphen_values = true, value_parser = size)]
    pub size: Size,
    /// Displayed frames per second to aim at: as many pixels are exact as the time allows
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=240))]
    pub fps: u16,
    /// Most frames interpolated before each rendered one; there are some where rendering is slower than --fps
    #[arg(long, value_name = "N", default_value_t = MAX_IN_BETWEEN, value_parser = clap::value_parser!(u32).range(..=i64::from(MAX_IN_BETWEEN)))]
    pub in_between: u32,
    #[command(flatten)]
    pub device: Device,
    /// Network that improves the frames: none (analytic) or the paper's in three sizes
    #[arg(long, value_name = "TIER", default_value = "analytic")]
    pub tier: TierArg,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Play the inputs in this file, for tests and demonstrations
    #[arg(long, value_name = "FILE.json")]
    pub script: Option<PathBuf>,
}

pub fn run(args: &ViewArgs) -> Result<Outcome, CliError> {
    start_threads(args.threads)?;
    backend::check(&args.device)?;
    // First, since it is quick.
    let script = args.script.as_deref().map(script).transpose()?;
    let (scene, cameras, open) = match window::url_of(&args.scene) {
        // The window opens it, and the cameras after it.
        Some(_) => {
            check_fetched(args)?;
            let open = [Some(&args.scene), args.path.as_ref()];
            (Arc::new(nothing()?), None, open.into_iter().flatten().cloned().collect())
        }
        None => {
            let (scene, cameras) = read(args)?;
            (scene, cameras, Vec::new())
        }
    };
    let pipeline = PipelineSettings {
        mode: if args.in_between > 0 { Mode::Full } else { Mode::SuperSample },
        in_between: args.in_between,
        refine: Refine::FrameTime(std::time::Duration::from_secs_f64(1.0 / f64::from(args.fps))),
        ..PipelineSettings::default()
    };
    let networks = match args.tier.network() {
        Some(tier) => {
            Networks { interpolate: None, ..Networks::shipped(pipeline.scale.of_networks(), tier)? }
        }
        None => Networks::default(),
    };
    let Device { backend, adapter } = args.device;
    let session = SessionSettings { pipeline, networks, backend, adapter, ..SessionSettings::default() };
    let size = args.size;
    let name = args.scene.file_name().unwrap_or(args.scene.as_os_str()).to_string_lossy().into_owned();
    let viewer = ViewerSettings {
        session,
        // The window has a waker of its own.
        waker: None,
        native_when_fast: true,
        fps: f64::from(args.fps),
        size,
    };
    let budget = args.scene_options.budget;
    window::run(WindowSettings { name, scene, cameras, viewer, open, budget, script })?;
    Ok(Outcome::Done)
}

/// The scene in the file system, and cameras for it.
fn read(args: &ViewArgs) -> Result<(Arc<Scene>, Option<CameraPath>), CliError> {
    let (scene, _) = inputs::scene_at(&args.scene, args.scene_options)?;
    let cameras = match &args.path {
        Some(file) => Some(inputs::capture(file, &StatedCameras::default(), Some(args.size), &scene)?),
        None => inputs::is_demo(&args.scene).then(demo::path),
    };
    cameras.as_ref().map_or(Ok(()), inputs::check_is_perspective)?;
    Ok((scene, cameras))
}

/// Refuses options that a scene from a URL would not read.
fn check_fetched(args: &ViewArgs) -> Result<(), CliError> {
    let SceneOptions { lod, budget: _, environment, axes, near } = args.scene_options;
    let given = lod.map(|_| "--lod").or(environment.map(|_| "--environment"));
    match given.or(axes.map(|_| "--axes")).or(near.map(|_| "--near")) {
        None => Ok(()),
        Some(option) => Err(CliError::Option {
            option,
            expected: "a scene in the file system".to_owned(),
            actual: args.scene.display().to_string(),
        }),
    }
}

/// Bytes of a script at most: hours of hands.
const MAX_SCRIPT_BYTES: u64 = 16 << 20;

fn script(file: &std::path::Path) -> Result<Script, CliError> {
    let option = |actual: String| CliError::Option {
        option: "--script",
        expected: format!("steps that can be played in {}", file.display()),
        actual,
    };
    let bytes = gs3_files::read_within(file, MAX_SCRIPT_BYTES).map_err(|e| option(e.to_string()))?;
    Script::parse(&bytes).map_err(|e| option(e.to_string()))
}
