//! `gs3 simplify`.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use gs3::Culling;
use gs3::raster::{Outputs, RasterSettings, Rasterizer};
use gs3::scene::format::SaveOptions;
use gs3::scene::{Camera, Image, Scene, Size};
use gs3_evaluate::metrics::{Quantisation, psnr};
use gs3_evaluate::simplify::{Criterion, Setting, simplify};
use indicatif::ProgressBar;

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::{SceneOptions, StatedCameras, View};
use crate::cli::terminal::print;
use crate::cli::threads::start_threads;
use crate::cli::values::{FrameRange, Rgb, size};
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::save_scene;

/// Views that the two scenes are compared in: enough for a mean, few beside the views of the choice.
const COMPARED_VIEWS: usize = 16;

/// Arguments of `gs3 simplify`.
#[derive(Debug, Args)]
pub struct SimplifyArgs {
    /// Scene file or folder, or `demo` for the built-in scene
    pub scene: PathBuf,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    #[command(flatten)]
    pub stated: StatedCameras,
    /// Cameras to judge by. Cameras of the training photos are best. A file is a COLMAP model, transforms.json, cameras.json,
    /// camera_path.json, settings of SuperSplat or RealityScan's CSV [default: an orbit]
    #[arg(long, value_name = "CAMERAS")]
    pub cameras: Option<PathBuf>,
    /// Cameras to use, the last one excluded [default: all]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    /// Image size [default: the size of the cameras, 1920x1080 without --cameras]
    #[arg(long, value_name = "WxH", allow_hyphen_values = true, value_parser = size)]
    pub size: Option<Size>,
    /// Fraction of the Gaussians to keep, above 0 and at most 1
    #[arg(long, value_name = "FRACTION", allow_hyphen_values = true)]
    pub keep: f64,
    /// By what to choose
    #[arg(long, default_value = "speedy-splat")]
    pub by: ByArg,
    /// mini-splatting: importance is the blending weight
    #[arg(long, conflicts_with = "outdoor")]
    pub indoor: bool,
    /// mini-splatting: importance is the mean blending weight per pixel [default]
    #[arg(long)]
    pub outdoor: bool,
    /// mini-splatting: of the sampled Gaussians keep the most important, as few as hold this share of their importance;
    /// 0.99 as published
    #[arg(long, default_value_t = 1.0, value_name = "SHARE", allow_hyphen_values = true)]
    pub mass: f64,
    /// mini-splatting: seed of the random choice
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Output file: .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ByArg {
    /// A random choice by share in the images (Mini-Splatting)
    MiniSplatting,
    /// Those that the images react to most (Speedy-Splat)
    SpeedySplat,
}

pub fn run(args: &SimplifyArgs) -> Result<Outcome, CliError> {
    start_threads(args.threads)?;
    let view = View {
        scene: args.scene.clone(),
        path: args.cameras.clone(),
        size: args.size,
        threads: args.threads,
        stated: args.stated.clone(),
    };
    destination::check(&[Destination::scene("--out", &args.out)], view.inputs())?;
    let (scene, _) = inputs::scene_at(&args.scene, args.scene_options)?;
    let path = inputs::cameras(&view, &scene)?;
    inputs::check_is_perspective(&path)?;
    let mut cameras = path.cameras();
    if let Some(FrameRange(frames)) = &args.frames {
        inputs::check_frames("--frames", frames, &path)?;
        cameras = &cameras[frames.clone()];
    }
    let criterion = match args.by {
        ByArg::MiniSplatting => Criterion::MiniSplatting {
            setting: if args.indoor { Setting::Indoor } else { Setting::Outdoor },
            share: args.mass,
            seed: args.seed,
        },
        ByArg::SpeedySplat => Criterion::SpeedySplat,
    };
    let settings = RasterSettings { background: args.background.0, ..RasterSettings::new(Outputs::Color) };

    let bar = ProgressBar::new(cameras.len() as u64)
        .with_style(inputs::style("views {pos}/{len} {wide_bar} {eta} left"));
    let mut show = |done: usize| bar.set_position(done as u64);
    let left = Arc::new(simplify(&scene, cameras, &settings, criterion, args.keep, &mut show)?);
    bar.finish_and_clear();
    save_scene(&left, &args.out, &SaveOptions::default())?;
    let (mean, lowest) = compare(&scene, &left, cameras, &settings)?;
    let (kept, all) = (left.gaussians().len(), scene.gaussians().len());
    print(format_args!(
        "{kept} of {all} Gaussians kept ({:.1} %), PSNR against all {mean:.2} dB on average, {lowest:.2} dB at least\n",
        100.0 * kept as f64 / all as f64,
    ))?;
    Ok(Outcome::Done)
}

/// Mean and lowest PSNR in dB of `left` against `scene`, in views spread over `cameras`.
fn compare(
    scene: &Arc<Scene>,
    left: &Arc<Scene>,
    cameras: &[Camera],
    settings: &RasterSettings,
) -> Result<(f64, f64), CliError> {
    let mut rasterizers = [scene, left].map(|s| Rasterizer::new(s.clone(), Culling::AccuTile));
    let mut images = [Image::default(), Image::default()];
    let (mut sum, mut lowest, mut count) = (0.0, f64::INFINITY, 0);
    for camera in cameras.iter().step_by(cameras.len().div_ceil(COMPARED_VIEWS).max(1)) {
        for (rasterizer, image) in rasterizers.iter_mut().zip(&mut images) {
            rasterizer.rasterize_image(camera, settings, image)?;
        }
        let value = psnr(&images[0], &images[1], Quantisation::None)?;
        (sum, lowest, count) = (sum + value, value.min(lowest), count + 1);
    }
    Ok((sum / f64::from(count), lowest))
}
