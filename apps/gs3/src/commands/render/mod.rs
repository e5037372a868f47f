//! `gs3 render`.

mod aov;
mod args;
mod compare;
mod course;
mod panorama;
mod parts;
mod tiles;

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use gs3::scene::camera_path::Pace;
use gs3::scene::{Camera, CameraPath};
use gs3::{Backend, Mode, Networks, PipelineSettings, Session};
use indicatif::ProgressBar;
use serde_json::{Value, json};

use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::options::AovFormat;
use crate::cli::terminal::note;
use crate::cli::threads::start_threads;
use crate::io::alpha::coverage;
use crate::io::destination::{self, Destination};
use crate::io::frame_files::others;
use crate::io::inputs;
use crate::io::manifest::Manifest;
use crate::io::output::{FrameWriter, Target, Written, write_text};
use crate::io::report::{self, Times};
use aov::LayerMaker;
pub use args::RenderArgs;
use compare::Comparison;
use course::Course;
use parts::{claim, end, frames_missing, is_there, numbers_of, stream_of, tell_of_high_rate};

pub fn run(args: &RenderArgs) -> Result<Outcome, CliError> {
    start_threads(args.view.threads)?;
    let mode = Mode::from(args.mode);
    if args.compare.is_some() && mode == Mode::Native {
        return Err(CliError::Option {
            option: "--compare",
            expected: "a mode other than native, which is what it compares with".into(),
            actual: "--mode native".into(),
        });
    }
    let target = Target::of(&args.out)?;
    let in_numbers = target.file(0, args.aov_format.name());
    let mut destinations = target.destinations();
    destinations.extend(aov_destination(args, &target, &in_numbers)?);
    destinations.extend(args.compare.iter().map(|file| Destination::file("--compare", file, "png")));
    destinations.extend(args.json.iter().map(|file| Destination::file("--json", file, "json")));
    destination::check(&destinations, args.view.inputs())?;
    let (scene, load_time) = inputs::scene_of(&args.view, args.scene_options)?;
    let mut path = inputs::cameras_of_any_size(&args.view, &scene)?;
    if let Some(frames) = args.smooth {
        path = path.smoothed(frames as usize, Pace::Speed);
    }
    let range = frames_to_render(args, &target, &path)?;
    if args.skip_existing && !matches!(target, Target::Folder(_)) {
        return Err(CliError::Option {
            option: "--skip-existing",
            expected: "--out DIR (gs3 join makes a video of it)".to_owned(),
            actual: format!("--out {}", args.out.display()),
        });
    }
    let may_be_large = mode == Mode::Native && !path.facts().is_panorama;
    if !may_be_large {
        inputs::check_renderable(&args.view, &path)?;
    }
    let in_tiles = may_be_large && path.cameras()[range.clone()].iter().any(inputs::is_large);
    inputs::tell_what_is_too_near(&scene, &path.cameras()[range.clone()]);
    let (networks, tier) = inputs::networks(&args.frame_options)?;
    if mode == Mode::SuperSample && networks.interpolate.is_some() {
        return Err(CliError::Option {
            option: "--weights",
            expected: "--mode full, which has frames to interpolate".into(),
            actual: "--mode super-sample".into(),
        });
    }
    let settings = args.frame_options.settings(mode);
    if in_tiles {
        return tiles::run(args, &target, &scene, &path, range, load_time);
    }
    if path.facts().is_panorama {
        return panorama::run(args, &target, &scene, &path, range, &networks);
    }
    // Not before the rest is right: a driver may take long to wake, and talk.
    let features = args.frame_options.features();
    let session = backend::session(scene, settings, &networks, &args.device, features)?;
    let covering = match args.alpha {
        true => Some(session.beside(coverage(session.scene())?, settings, &networks)?),
        false => None,
    };
    // Colour, and coverage where it is asked for.
    let mut sessions: Vec<Session> = [Some(session), covering].into_iter().flatten().collect();
    let mut layer_maker = LayerMaker::new(args, &target, &sessions[0])?;
    let first = path.cameras()[range.start];
    if mode.has_history()
        && args.frame_options.refine.is_on()
        && !sessions[0].pipeline().makes_exact_pixels(&first)
    {
        note(
            "no pixels are rasterized exactly: frames of a GPU have no exact pixels with a super-sampling network, \
             with --culling aabb3sigma or adr, and where the CPU runs the networks",
        );
    }
    if mode.has_history()
        && !sessions[0].pipeline().is_on_device(&first)
        && sessions[0].backend() == Backend::Gpu
    {
        note(
            "the GPU rasterizes, networks run on the CPU (--tier analytic makes all of the frame on the GPU)",
        );
    }
    let shown_each = settings.displayed_per_rendered();
    let stream = stream_of(&path, &range, shown_each);
    tell_of_high_rate(&target, &stream, shown_each);

    let scene = &Arc::clone(sessions[0].scene());
    let (machine, pipeline) = (sessions[0].machine(), sessions[0].pipeline());
    let scale_of = |camera: &Camera| pipeline.scale_of(camera);
    let facts = Manifest::new(scene, &path, &settings, &networks, scale_of, machine, args.alpha)?
        .with_aovs(&args.aov, args.aov_format);
    let missing = frames_missing(args, &target, &facts, &range, shown_each)?;
    let mut comparison = match &args.compare {
        Some(_) => Some(Comparison::new(&sessions[0], &missing)?),
        None => None,
    };
    let mut writer = None;
    let mut times = Times::default();
    interrupt::watch()?;
    let bar = ProgressBar::new(missing.len() as u64)
        .with_style(inputs::style("{pos}/{len} rendered {wide_bar} {per_sec}, {eta} left"));
    let mut course = Course::new(args.warm_up);
    let mut done = 0;
    let mut first_number = None;
    let mut is_blank = true;
    while let Some(&k) = missing.get(done)
        && !interrupt::requested()
    {
        // Settings that the rasterizer refuses show before any file is made.
        let is_alone = course.render(&mut sessions, &path, k)?;
        let session = &sessions[0];
        let pipeline = session.pipeline();
        let shown = pipeline.presented();
        let writer = match &mut writer {
            Some(writer) => writer,
            none => {
                let writer = none.insert(FrameWriter::new(target.clone(), &stream)?);
                claim(&target, &facts, &numbers_of(&range, shown_each))?;
                writer
            }
        };
        let is_single = matches!(target, Target::Single(_)) || is_alone;
        let frames: Vec<_> = if is_single { vec![shown.current] } else { shown.iter().collect() };
        // Displayed frames are counted from the start of the path, so that the parts of a path fit together.
        let last_number = k * shown_each;
        first_number.get_or_insert(last_number + 1 - frames.len());
        let covered: Vec<_> =
            sessions[1..].iter().flat_map(|session| session.pipeline().presented().iter()).collect();
        let views = aov::views(pipeline, &path, k, is_alone);
        for (i, image) in frames.iter().enumerate() {
            let number = last_number + i + 1 - frames.len();
            // A frame that is there is made again where the one beside it is missing, and its file stays.
            if args.skip_existing && is_there(args, &target, number) {
                continue;
            }
            // The last of all is the rendered frame.
            let covered = (covered.len() + i).checked_sub(frames.len()).map(|i| covered[i]);
            let view = (views.len() + i).checked_sub(frames.len()).and_then(|i| views.get(i));
            let layers = match (&mut layer_maker, view) {
                (Some(maker), Some(view)) => Some(maker.make(image, covered, view)?),
                _ => None,
            };
            writer.write(number, image, covered, layers.as_ref())?;
        }
        let displayed = frames.len();
        times.add(pipeline.times(), displayed);
        if let Some(comparison) = &mut comparison {
            comparison.observe(session, k, &path.cameras()[k], displayed)?;
        }
        is_blank &= session.pipeline().visible_count() == Some(0);
        done += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let session = &mut sessions[0];
    let is_complete = done == missing.len();
    if is_blank && done > 0 {
        inputs::warn_of_nothing_visible(session.scene().details().near);
    }
    let written = writer.map_or(Ok(Written::default()), |w| w.finish(is_complete))?;

    let mut figures = json!({
        "frames_displayed": times.displayed(),
        "frames_rendered": done,
        "frames_written": written.frames,
        "displayed_fps": times.displayed_fps(),
        "stage_ms": times.stage_ms(),
        "load_s": load_time.as_secs_f64(),
        "encode_s": written.encode_time.as_secs_f64(),
        "gaussians": session.scene().gaussians().len(),
        "is_all_on_device": session.pipeline().is_on_device(&first),
        "size": first.size().to_array(),
        "is_complete": is_complete,
        "alpha": args.alpha,
        "aov": args.aov.iter().map(|aov| aov.name()).collect::<Vec<_>>(),
    });
    let scale = session.pipeline().scale_of(&first);
    figures = report::join(figures, what_ran(&settings, scale, &networks, &tier));
    figures = report::join(figures, report::asked(&args.view, &range, &settings));
    if let Some((comparison, file)) =
        comparison.zip(args.compare.as_ref()).filter(|_| is_complete && done > 0)
    {
        let compared = comparison.write(session, file)?;
        figures = report::join(figures, json!({ "compare": compared }));
    }
    figures = report::join(figures, report::machine(session.machine()));
    if let Some(file) = &args.json {
        write_text(file, &format!("{figures:#}\n"))?;
    }
    note(format_args!(
        "{} frames shown, {:.2} per second of rendering ({} in {}); loading {:.2} s, encoding {:.2} s, not included",
        times.displayed(),
        times.displayed_fps(),
        mode.name(),
        args.out.display(),
        load_time.as_secs_f64(),
        written.encode_time.as_secs_f64(),
    ));
    let numbers = first_number.unwrap_or_default()..numbers_of(&range, shown_each).end;
    // A user who skips existing frames knows of them.
    if let Target::Folder(folder) | Target::Video { frames: folder, .. } = &target
        && !args.skip_existing
        && let count @ 1.. = others(folder, &numbers)
    {
        note(format_args!("{count} frames in {} are of other runs than this one", folder.display()));
    }
    end(&target, &range, missing.get(done).copied(), &numbers, &stream, written.no_video)
}

/// The file in numbers beside a single picture, if there is one.
fn aov_destination<'a>(
    args: &RenderArgs,
    target: &Target,
    file: &'a Path,
) -> Result<Option<Destination<'a>>, CliError> {
    if args.aov.is_empty() {
        return Ok(None);
    }
    match (target, args.aov_format) {
        (Target::Single(_), AovFormat::Npz) if target.is_exr() => Err(CliError::Option {
            option: "--aov-format",
            expected: format!("exr, as all of the frame is in {}", args.out.display()),
            actual: "npz".to_owned(),
        }),
        (Target::Single(_), format) if !target.is_exr() => {
            Ok(Some(Destination::file("--aov", file, format.name())))
        }
        // Frames of a folder have names of their own.
        _ => Ok(None),
    }
}

/// The mode with those settings that it reads.
fn what_ran(settings: &PipelineSettings, scale: u32, networks: &Networks, tier: &str) -> Value {
    let mode = settings.mode;
    let mut ran = json!({ "mode": mode.name() });
    if mode != Mode::Native {
        ran["scale"] = json!(scale);
    }
    if mode.has_history() {
        ran["tier"] = json!(tier);
    }
    if mode == Mode::Full {
        ran["interpolation"] = json!(if networks.interpolate.is_some() { "learned" } else { "analytic" });
        ran["in_between"] = json!(settings.in_between);
    }
    ran
}

/// The frames asked for, checked against the path and the output.
fn frames_to_render(args: &RenderArgs, target: &Target, path: &CameraPath) -> Result<Range<usize>, CliError> {
    let is_single = matches!(target, Target::Single(_));
    let default = if is_single { 0..1 } else { 0..path.cameras().len() };
    let range = args.frames.as_ref().map_or(default, |frames| frames.0.clone());
    inputs::check_frames("--frames", &range, path)?;
    if is_single && range.len() > 1 {
        return Err(CliError::Option {
            option: "--out",
            expected: format!("a folder or FILE.mp4 for {} frames", range.len()),
            actual: args.out.display().to_string(),
        });
    }
    if matches!(target, Target::Video { .. }) {
        if args.alpha {
            return Err(CliError::Option {
                option: "--alpha",
                expected: "--out DIR or FILE.png, as MP4 files have no transparency".to_owned(),
                actual: format!("--out {}", args.out.display()),
            });
        }
        inputs::check_one_size("--out", "a video", &range, path)?;
    }
    Ok(range)
}
