//! `gs3 bench`: displayed frames per second against native rendering, in the same run.

mod args;
mod copies;
mod gpu;

use std::fmt::Write;
use std::sync::Arc;
use std::time::Duration;

use gs3::raster::{Outputs, RasterSettings, RasterTimes, Rasterizer};
use gs3::scene::{Camera, GBuffer, Scene, Size};
use gs3::{FramePipeline, Machine, Mode, Stage};
use indicatif::ProgressBar;
use serde_json::{Value, json};

use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::options::Device;
use crate::cli::terminal::print;
use crate::cli::threads::start_threads;
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::write_text;
use crate::io::report::{self, Times, median_ms};
pub use args::{BenchArgs, BenchBackendArg};

/// Rounds over the frames. The best of each side counts: other work on the machine only ever slows a round down.
const ROUNDS: usize = 3;

/// Frames that are measured unless others are asked for, as far as the path has them.
const DEFAULT_FRAMES: usize = 20;

pub fn run(args: &BenchArgs) -> Result<Outcome, CliError> {
    start_threads(args.view.threads)?;
    let json = args.json.as_deref().map(|file| Destination::file("--json", file, "json"));
    destination::check(json.as_slice(), args.view.inputs())?;
    let (scene, load_time) = inputs::scene_of(&args.view, args.scene_options)?;
    let path = inputs::cameras(&args.view, &scene)?;
    inputs::check_is_perspective(&path)?;
    let range = inputs::first_frames(args.frames.as_ref(), DEFAULT_FRAMES, &path);
    inputs::check_frames("--frames", &range, &path)?;
    let scene = copies::side_by_side(scene, args.copies, &path.cameras()[range.start])?;
    let device = Device { backend: args.backend.into(), adapter: args.adapter };
    let machine = backend::open(&device, args.frame_options.features())?;
    if let Machine::Gpu(gpu) = &machine {
        let figures = gpu::run(args, gpu, scene, &path.cameras()[range.clone()])?;
        let asked = report::asked(&args.view, &range, &args.frame_options.settings(Mode::Full));
        let figures = report::join(figures, asked);
        return write(args, &report::join(figures, report::machine(&machine)), &gpu::text);
    }
    let (networks, tier) = inputs::networks(&args.frame_options)?;
    let pipeline =
        |mode| FramePipeline::with_networks(scene.clone(), args.frame_options.settings(mode), &networks);
    let (mut native, mut full) = (pipeline(Mode::Native)?, pipeline(Mode::Full)?);
    // The first frame of each allocates and fills caches, and has nothing before it to interpolate from.
    let first = path.cameras()[range.start];
    native.render(&first)?;
    full.render(&first)?;

    let mut rounds: Vec<[Times; 2]> = Vec::new();
    let bar = ProgressBar::new((ROUNDS * range.len()) as u64)
        .with_style(inputs::style("{pos}/{len} {wide_bar} {eta} left"));
    let mut is_blank = native.visible_count() == Some(0);
    for _ in 0..ROUNDS {
        let mut times = [Times::default(), Times::default()];
        for k in range.clone() {
            let between = full.settings().poses_between(&path, k);
            // Both in turn, so that a disturbance meets both.
            for (pipeline, times) in [&mut native, &mut full].into_iter().zip(&mut times) {
                let displayed = pipeline.render_with_poses(&path.cameras()[k], &between)?.iter().count();
                times.add(pipeline.times(), displayed);
            }
            is_blank &= native.visible_count() == Some(0);
            bar.inc(1);
        }
        rounds.push(times);
    }
    bar.finish_and_clear();
    if is_blank {
        inputs::warn_of_nothing_visible(full.scene().details().near);
    }

    let scale = full.scale_of(&first);
    let figures = figures(&rounds, args, &tier, load_time.as_secs_f64(), first.size(), scale);
    let mut figures = report::join(figures, report::asked(&args.view, &range, full.settings()));
    if args.stages {
        let stages = raster_stages(&scene, &path.cameras()[range], args, &|camera| full.scale_of(camera))?;
        figures = report::join(figures, json!({ "raster_ms": stages }));
    }
    write(args, &report::join(figures, report::machine(&machine)), &text)
}

/// Writes the figures where they were asked for and shows them on the terminal.
fn write(args: &BenchArgs, figures: &Value, text: &dyn Fn(&Value) -> String) -> Result<Outcome, CliError> {
    if let Some(file) = &args.json {
        write_text(file, &format!("{figures:#}\n"))?;
    }
    print(text(figures))?;
    Ok(Outcome::Done)
}

fn figures(
    rounds: &[[Times; 2]],
    args: &BenchArgs,
    tier: &str,
    load_s: f64,
    size: Size,
    scale: u32,
) -> Value {
    let best = |side: usize| {
        rounds.iter().map(|r| &r[side]).max_by(|a, b| a.displayed_fps().total_cmp(&b.displayed_fps()))
    };
    let [native, full] = [best(0).cloned().unwrap_or_default(), best(1).cloned().unwrap_or_default()];
    let gbuffer_over_native = full
        .median_ms(Stage::Rasterize)
        .zip(native.median_ms(Stage::Rasterize))
        .map(|(gbuffer, native)| gbuffer / native);
    let side = |times: &Times| {
        json!({
            "displayed_fps": times.displayed_fps(),
            "frame_ms": times.median_frame_ms(),
            "stage_ms": times.stage_ms(),
        })
    };
    json!({
        "displayed_fps_full_over_native": full.displayed_fps() / native.displayed_fps(),
        "gbuffer_over_native": gbuffer_over_native,
        "native": side(&native),
        "full": side(&full),
        "rounds_displayed_fps": rounds
            .iter()
            .map(|[native, full]| json!([native.displayed_fps(), full.displayed_fps()]))
            .collect::<Vec<_>>(),
        "size": size.to_array(),
        "scale": scale,
        "in_between": args.frame_options.in_between,
        "tier": tier,
        "copies": args.copies,
        "load_s": load_s,
    })
}

/// Median times of the CPU rasterizer's stages in ms: native frames and low-resolution G-buffers of these cameras.
fn raster_stages(
    scene: &Arc<Scene>,
    cameras: &[Camera],
    args: &BenchArgs,
    scale_of: &dyn Fn(&Camera) -> u32,
) -> Result<Value, CliError> {
    let look = args.frame_options.settings(Mode::Full);
    let mut rasterizer = Rasterizer::new(Arc::clone(scene), look.culling);
    let mut measure = |outputs: Outputs, scale_of: &dyn Fn(&Camera) -> u32| {
        let mut gbuffer = GBuffer::default();
        let mut times: Vec<RasterTimes> = Vec::new();
        // Once over all frames to warm up.
        for camera in cameras.iter().chain(cameras) {
            let scale = scale_of(camera);
            let dilation = look.dilation.at_scale(scale);
            let settings =
                RasterSettings { dilation, background: look.background, ..RasterSettings::new(outputs) };
            rasterizer.rasterize(&camera.low_resolution(scale), &settings, &mut gbuffer)?;
            times.push(rasterizer.times());
        }
        let median = |stage: fn(&RasterTimes) -> Duration| {
            median_ms(times[cameras.len()..].iter().map(stage).collect())
        };
        Ok::<_, CliError>(json!({
            "project": median(|t| t.project), "bin": median(|t| t.bin), "blend": median(|t| t.blend),
        }))
    };
    Ok(
        json!({ "native": measure(Outputs::Color, &|_| 1)?, "lr_gbuffer": measure(Outputs::Samples, scale_of)? }),
    )
}

/// The same for people.
fn text(figures: &Value) -> String {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let mut text = format!(
        "displayed fps, full / native    {:.2}\nLR G-buffer / native, time      {:.3}\n",
        number(&figures["displayed_fps_full_over_native"]),
        number(&figures["gbuffer_over_native"]),
    );
    // Writing to a string does not fail.
    for side in ["native", "full"] {
        let figures = &figures[side];
        let _ = write!(text, "{side:<8} {:8.2} fps", number(&figures["displayed_fps"]));
        for (stage, ms) in figures["stage_ms"].as_object().into_iter().flatten() {
            let _ = write!(text, "  {stage} {:.1} ms", number(ms));
        }
        text.push('\n');
    }
    for (what, stages) in figures["raster_ms"].as_object().into_iter().flatten() {
        let _ = write!(text, "{what:<10} rasterizer:");
        for stage in ["project", "bin", "blend"] {
            let _ = write!(text, "  {stage} {:.1} ms", number(&stages[stage]));
        }
        text.push('\n');
    }
    let rounds: Vec<String> = figures["rounds_displayed_fps"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|round| format!("{:.2} / {:.2}", number(&round[1]), number(&round[0])))
        .collect();
    let _ = writeln!(text, "rounds, full / native fps: {}", rounds.join(", "));
    let simd = figures["simd"].as_str().unwrap_or("unknown");
    let _ = writeln!(
        text,
        "{} threads, SIMD level {simd}, {:.0} MB at most",
        figures["threads"],
        number(&figures["peak_rss_mb"])
    );
    text
}
