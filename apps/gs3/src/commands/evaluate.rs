//! `gs3 evaluate`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use gs3::scene::Scene;
use gs3_evaluate::methods::{DEFAULT_METHODS, MethodSpec};
use gs3_evaluate::photos::{DEFAULT_PHOTO_METHODS, PhotoProtocol};
use gs3_evaluate::protocol::{Case, Event, Failure, Paper, Protocol};
use gs3_evaluate::report;
use indicatif::ProgressBar;
use serde_json::{Value, json};

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::{CullingArg, SceneOptions, View};
use crate::cli::terminal::{note, print};
use crate::cli::threads::start_threads;
use crate::cli::values::{FrameRange, Rgb, scale};
use crate::io;
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::write_text;

/// Frames that are evaluated unless others are asked for, as far as the path has them.
const DEFAULT_FRAMES: usize = 30;

/// Arguments of `gs3 evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Rendered frames of the path, the last one excluded [default: the first 30]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    /// High-resolution over low-resolution size
    #[arg(long, default_value_t = 4, value_name = "S", value_parser = scale(2))]
    pub scale: u32,
    /// What to run: `methods` compares --methods; `paper` fills the tables of the 3DGS³ paper (methods, accelerations,
    /// parts left out)
    #[arg(long, default_value = "methods")]
    pub protocol: ProtocolArg,
    /// The scene after `gs3 simplify`, for `--protocol paper`
    #[arg(long, value_name = "SCENE")]
    pub simplified: Option<PathBuf>,
    /// Compare with the photos that the scene was trained on, instead of native rendering. CAMERAS is their capture: COLMAP
    /// model, transforms.json or cameras.json. Photos of lenses with distortion are undistorted first. Each photo is compared
    /// at its own size, twice: alone, and at the end of a short path to it
    #[arg(long, value_name = "CAMERAS", conflicts_with_all = ["path", "size", "frames", "case", "warm_up", "protocol", "simplified", "jod"])]
    pub photos: Option<PathBuf>,
    /// Folder of the photos [default: the capture's own, or `images` beside it]
    #[arg(long, value_name = "DIR", requires = "photos")]
    pub images: Option<PathBuf>,
    /// Judge every Nth photo only; 8 are the ones that training leaves out by convention
    #[arg(long, default_value_t = 1, value_name = "N", requires = "photos", value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
    #[arg(long, value_delimiter = ',', value_name = "A,B,…", help = methods_help())]
    pub methods: Vec<MethodSpec>,
    /// How the camera moves over the frames
    #[arg(long, default_value = "path")]
    pub case: CaseArg,
    /// Which tiles a splat is assigned to; `--protocol paper` tries them all
    #[arg(long, default_value = "accutile")]
    pub culling: CullingArg,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
    /// Rendered frames that every method runs before it is timed and judged
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub warm_up: u16,
    /// Folder with the weights of span (span28_x4.safetensors), safmn (safmnpp_light_x4.safetensors) and
    /// rt4ksr (rt4ksr_x2.safetensors), and of learned tiers and of *_trained in place of those that come with gs3
    /// (ecbsr_x4.safetensors, super_sample_balanced_x4.safetensors, interpolate_balanced_x4.safetensors, …)
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
    /// Also judge by ColorVideoVDP (JOD), the middle 1280x720 pixels of all frames, which takes longer
    #[arg(long)]
    pub jod: bool,
    /// Folder for report.html, results.json, table.md and what an interrupted run resumes from
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// From the lists that names are looked up in.
fn methods_help() -> String {
    format!(
        "Methods, each NAME[@FORMATION][+INTERPOLATION]; names: {}; formations of low-resolution frames: {}; \
         interpolations: {} [default: {DEFAULT_METHODS}; for photos {DEFAULT_PHOTO_METHODS}]",
        MethodSpec::names(),
        MethodSpec::formations(),
        MethodSpec::interpolations(),
    )
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProtocolArg {
    Methods,
    Paper,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CaseArg {
    /// Along the path
    Path,
    /// Not at all
    Rest,
    /// Along the path, with a cut to the far side of it in the middle
    Cut,
}

impl From<CaseArg> for Case {
    fn from(case: CaseArg) -> Self {
        match case {
            CaseArg::Path => Self::Path,
            CaseArg::Rest => Self::Rest,
            CaseArg::Cut => Self::Cut,
        }
    }
}

pub fn run(args: &EvaluateArgs) -> Result<Outcome, CliError> {
    check_protocol(args)?;
    destination::check(
        &[Destination::folder("--out", &args.out)],
        args.view.inputs().chain(args.simplified.as_deref()),
    )?;
    start_threads(args.view.threads)?;
    let (scene, _) = inputs::scene_of(&args.view, args.scene_options)?;
    if let Some(capture) = &args.photos {
        return photos(args, scene, capture);
    }
    let path = inputs::cameras(&args.view, &scene)?;
    inputs::check_is_perspective(&path)?;
    let frames = inputs::first_frames(args.frames.as_ref(), DEFAULT_FRAMES, &path);
    inputs::check_frames("--frames", &frames, &path)?;
    inputs::check_one_size("--path", "the evaluation", &frames, &path)?;
    let first = path.cameras()[frames.start];
    let protocol = Protocol {
        reference: Arc::clone(&scene),
        scene,
        scene_name: stem(&args.view.scene),
        frames,
        path,
        path_name: args.view.path.as_ref().map_or_else(|| "generated path".into(), |path| stem(path)),
        case: args.case.into(),
        size: first.size(),
        scale: args.scale,
        methods: methods(args, DEFAULT_METHODS)?,
        culling: args.culling.into(),
        beside: args.culling.into(),
        background: args.background.0,
        warm_up_frames: args.warm_up.into(),
        weights: args.weights.clone(),
        jod: args.jod,
        command: io::report::command_line(),
    };
    if args.protocol == ProtocolArg::Paper {
        return paper(args, protocol);
    }
    let results = watched(|watch| protocol.run(&args.out, watch))?;
    write_report(&args.out, &json!(results), &report::markdown(&results), &report::html(&results))?;
    check_failures(&results.failures, &args.out)
}

/// Refuses options that the protocol would not read.
fn check_protocol(args: &EvaluateArgs) -> Result<(), CliError> {
    let is_paper = args.protocol == ProtocolArg::Paper;
    let (option, expected) = match (is_paper, args.methods.is_empty(), &args.simplified) {
        (true, false, _) => ("--methods", "none with --protocol paper, which names its own"),
        (true, ..) if args.jod => ("--jod", "none with --protocol paper: its tables have no such column"),
        (false, _, Some(_)) => ("--simplified", "--protocol paper with it"),
        _ => return Ok(()),
    };
    Err(CliError::Option { option, expected: expected.into(), actual: "it given".into() })
}

/// Fills the paper's tables.
fn paper(args: &EvaluateArgs, protocol: Protocol) -> Result<Outcome, CliError> {
    let simplified = args
        .simplified
        .as_deref()
        .map(|file| inputs::scene_at(file, args.scene_options.of_whole()))
        .transpose()?
        .map(|(scene, _)| scene);
    let paper = Paper { protocol, simplified };
    let results = watched(|watch| paper.run(&args.out, watch))?;
    write_report(
        &args.out,
        &json!(results),
        &report::paper_markdown(&results),
        &report::paper_html(&results),
    )?;
    check_failures(&results.failures, &args.out)
}

/// Compares renders with photos.
fn photos(args: &EvaluateArgs, scene: Arc<Scene>, capture: &Path) -> Result<Outcome, CliError> {
    let protocol = PhotoProtocol {
        capture: inputs::capture(capture, &args.view.stated, None, &scene)?,
        scene,
        scene_name: stem(&args.view.scene),
        capture_path: capture.to_owned(),
        images: args.images.clone(),
        every: args.every as usize,
        scale: args.scale,
        methods: methods(args, DEFAULT_PHOTO_METHODS)?,
        culling: args.culling.into(),
        background: args.background.0,
        weights: args.weights.clone(),
        command: io::report::command_line(),
    };
    let results = watched(|watch| protocol.run(&args.out, watch))?;
    let (table, page) = (report::photos_markdown(&results), report::photos_html(&results));
    write_report(&args.out, &json!(results), &table, &page)?;
    check_failures(&results.failures, &args.out)
}

/// The methods asked for, else `default`.
fn methods(args: &EvaluateArgs, default: &str) -> Result<Vec<MethodSpec>, CliError> {
    if !args.methods.is_empty() {
        return Ok(args.methods.clone());
    }
    Ok(default.split(',').map(str::parse).collect::<Result<_, _>>()?)
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn write_report(out: &Path, results: &Value, table: &str, page: &str) -> Result<(), CliError> {
    write_text(&out.join("results.json"), &format!("{results:#}\n"))?;
    write_text(&out.join("table.md"), table)?;
    write_text(&out.join("report.html"), page)?;
    print(format_args!("{table}\n{}\n", out.join("report.html").display()))?;
    Ok(())
}

/// If a requested method gives no result, the user must learn of it without reading the report.
fn check_failures(failures: &[Failure], out: &Path) -> Result<Outcome, CliError> {
    if failures.is_empty() {
        return Ok(Outcome::Done);
    }
    let failures = failures.iter().map(Failure::to_string).collect();
    Err(CliError::Methods { failures, report: out.join("report.html") })
}

/// Does `work`, showing its progress.
fn watched<T>(work: impl FnOnce(&mut dyn FnMut(Event<'_>)) -> T) -> T {
    let bar = ProgressBar::new(0).with_style(inputs::style("{msg:24} {pos}/{len} {wide_bar} {eta} left"));
    let show = |what: String, done: usize, total: usize| {
        if done == 1 {
            bar.reset();
            bar.set_length(total as u64);
            bar.set_message(what);
        }
        bar.set_position(done as u64);
    };
    let results = work(&mut |event| match event {
        Event::GroundTruth { done, total } => show("ground truth".into(), done, total),
        Event::Method { method, done, total } => show(method.to_string(), done, total),
        Event::PhotosMissing { names } => bar.suspend(|| {
            note(format_args!(
                "{} of the capture's photos have no file and are left out, {} the first",
                names.len(),
                names.first().map_or("", String::as_str)
            ));
        }),
        Event::Resumed { method } => bar.println(format!("{method}: finished in an earlier run")),
        Event::Failed { failure } => bar.println(failure.to_string()),
    });
    bar.finish_and_clear();
    results
}
