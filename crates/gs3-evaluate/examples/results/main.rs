//! Writes `docs/results.md` and its plot `docs/results.svg`: gs3, with exact pixels, without learning and with every tier with
//! shipped weights, against native rendering, baselines and published networks, at rest and with parts left out, on captured
//! scenes.
//!
//!     cargo run --release -p gs3-evaluate --example results -- FOLDER [FRAMES [FILE]]
//!
//! FOLDER has `scenes/SCENE`, `paths/PATH.json` and `weights`, with the names of [`PATHS`].
//!
//! All methods render every frame in turn, so they share whatever else the machine does. For ꟻLIP, warping error,
//! flicker and percentiles of times run `gs3 evaluate`.

mod along;
mod front;
mod networks;
mod page;
mod parts;
mod rest;
mod score;
mod truth;

use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::Culling;
use gs3_evaluate::methods::MethodSettings;
use gs3_scene::{Scene, Size, capture};

use page::Sections;

const SIZE: Size = Size::new(1920, 1080);
const SCALE: u32 = 4;
const FRAMES: usize = 30;

/// Camera paths with their scenes.
const PATHS: [(&str, &str); 8] = [
    ("flowers", "flowers_orbit"),
    ("flowers", "flowers_drift"),
    ("fungi", "fungi_drift"),
    ("fungi", "fungi_pan"),
    ("hqgarden", "hqgarden_drift"),
    ("hqgarden", "hqgarden_pan"),
    ("lacadiere", "lacadiere_drift"),
    ("lacadiere", "lacadiere_pan"),
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("expected FOLDER with scenes, paths and weights")?);
    let frames: usize = arguments.next().map_or(Ok(FRAMES), |n| n.parse())?;
    let file = arguments
        .next()
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results.md"), PathBuf::from);
    let mut sections = Sections::default();
    let mut loaded: Option<(&str, Arc<Scene>)> = None;
    for (scene_name, path_name) in PATHS {
        eprintln!("{path_name}");
        let scene = match &loaded {
            Some((name, scene)) if *name == scene_name => Arc::clone(scene),
            _ => Arc::new(gs3::open(folder.join("scenes").join(scene_name))?),
        };
        loaded = Some((scene_name, Arc::clone(&scene)));
        let path = capture::load(folder.join("paths").join(format!("{path_name}.json")))?
            .resized(SIZE.width, SIZE.height)?;
        let available = path.cameras().len();
        if !(3..=available).contains(&frames) {
            return Err(format!("expected 3 to {available} frames, found {frames}").into());
        }
        let settings = MethodSettings {
            scene,
            scale: SCALE,
            culling: Culling::AccuTile,
            background: [0.0; 3],
            training: Vec::new(),
            weights: Some(folder.join("weights")),
        };
        let (rows, absent) = along::along(&path, frames, &settings)?;
        sections.absent = absent;
        if networks::PATHS.contains(&path_name) {
            let (table, lines) = networks::table(path_name, &path, frames, &settings, &rows)?;
            write!(sections.networks, "### {path_name}\n\n{table}\n")?;
            sections.ahead.extend(lines);
        }
        if parts::PATHS.contains(&path_name) {
            let (table, lines) = parts::table(path_name, &path, &settings)?;
            write!(sections.parts, "### {path_name}\n\n{table}\n")?;
            sections.ahead.extend(lines);
        }
        if rest::PATHS.contains(&path_name) {
            sections.rest += &rest::rows(path_name, &path, &settings)?;
        }
        sections.paths.push((path_name, settings.scene.gaussians().len(), rows));
    }
    let plot = file.with_extension("svg");
    std::fs::write(&plot, front::plot(&sections.paths))?;
    let plot_name = plot.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    std::fs::write(&file, page::page(&sections, frames, &plot_name))?;
    eprintln!("{} and {}", file.display(), plot.display());
    Ok(())
}
