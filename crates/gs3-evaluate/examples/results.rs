//! Writes `docs/results.md`: gs3, without learning and with every tier whose weights come with it, against native rendering,
//! baselines and published networks, on captured scenes.
//!
//!     cargo run --release -p gs3-evaluate --example results -- ../shared [FRAMES [FILE]]
//!
//! All methods render every frame in turn, so they share whatever else the machine does. For ꟻLIP, warping error, flicker and
//! percentiles of times run `gs3 evaluate`.

use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gs3::{Culling, Stage};
use gs3_evaluate::methods::{Method, MethodSettings, MethodSpec, build};
use gs3_evaluate::metrics::{Border, Quantisation, psnr, ssim, tpsnr};
use gs3_evaluate::protocol::{Machine, PSNR_CAP};
use gs3_scene::{Camera, CameraPath, Image, Scene, capture};

const SIZE: (u32, u32) = (1920, 1080);
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
/// gs3: the names of super sampling alone and with the frames between. Learned ones are left out, aloud, where their weights
/// are not there.
const OURS: [[&str; 2]; 4] =
    [["history", "analytic"], ["fast_ss", "fast"], ["balanced_ss", "balanced"], ["high_ss", "high"]];
/// Baselines, without frames between.
const BASELINES: [&str; 2] = ["bicubic", "hermite"];
/// Rows of a table: native rendering, [`BASELINES`], [`OURS`].
const NATIVE: usize = 0;
const BICUBIC: usize = 1;
const HISTORY: usize = 1 + BASELINES.len();
const ANALYTIC: usize = HISTORY + 1;

/// The paths whose frames networks get, and how many of them.
const NETWORK_PATHS: [&str; 3] = ["flowers_drift", "fungi_drift", "hqgarden_drift"];
const NETWORK_FRAMES: usize = 4;
const NETWORK_METHODS: [&str; 13] = [
    "bicubic",
    "hermite",
    "span",
    "safmn",
    "rt4ksr",
    "bicubic@stock",
    "span@stock",
    "safmn@stock",
    "rt4ksr@stock",
    "bicubic@antialiased",
    "span@antialiased",
    "safmn@antialiased",
    "rt4ksr@antialiased",
];

/// Differences of times below this factor are noise.
const NOTABLE: f64 = 1.1;

/// A row of a table.
#[derive(Clone)]
struct Row {
    name: String,
    rendered: Scores,
    between: Scores,
    tpsnr: Vec<f64>,
    milliseconds: Vec<f64>,
    displayed_per_rendered: f64,
}

/// Scores of frames.
#[derive(Clone, Default)]
struct Scores {
    psnr: Vec<f64>,
    ssim: Vec<f64>,
}

impl Row {
    fn new(name: &str, displayed_per_rendered: f64) -> Self {
        Self {
            name: name.into(),
            rendered: Scores::default(),
            between: Scores::default(),
            tpsnr: Vec::new(),
            milliseconds: Vec::new(),
            displayed_per_rendered,
        }
    }

    /// Displayed frames per second by the median time; none for methods whose frames need the native image.
    fn fps(&self) -> Option<f64> {
        let mut times = self.milliseconds.clone();
        times.sort_by(f64::total_cmp);
        Some(self.displayed_per_rendered * 1e3 / times.get(times.len() / 2)?)
    }
}

impl Scores {
    fn add(&mut self, truth: &Image, image: &Image) -> Result<(), Box<dyn Error>> {
        self.psnr.push(psnr(truth, image, Quantisation::None)?.min(PSNR_CAP));
        self.ssim.push(ssim(truth, image, Border::Crop)?);
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let shared = PathBuf::from(arguments.next().ok_or("expected the folder of scenes, paths and weights")?);
    let frames: usize = arguments.next().map_or(Ok(FRAMES), |n| n.parse())?;
    let file = arguments
        .next()
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results.md"), PathBuf::from);
    let mut tables = Vec::new();
    let (mut networks, mut ahead, mut absent) = (String::new(), Vec::new(), Vec::new());
    let mut loaded: Option<(&str, Arc<Scene>)> = None;
    for (scene_name, path_name) in PATHS {
        eprintln!("{path_name}");
        let scene = match &loaded {
            Some((name, scene)) if *name == scene_name => Arc::clone(scene),
            _ => Arc::new(gs3::open(&shared.join("scenes").join(scene_name))?),
        };
        loaded = Some((scene_name, Arc::clone(&scene)));
        let path = capture::load(&shared.join("paths").join(format!("{path_name}.json")))?
            .resized(SIZE.0, SIZE.1)?;
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
            weights: Some(shared.join("weights")),
        };
        let rows;
        (rows, absent) = along(&path, frames, &settings)?;
        if NETWORK_PATHS.contains(&path_name) {
            let (table, lines) = network_table(path_name, &path, frames, &settings, &rows)?;
            write!(networks, "### {path_name}\n\n{table}\n")?;
            ahead.extend(lines);
        }
        tables.push((path_name, settings.scene.gaussians().len(), rows));
    }
    std::fs::write(&file, page(&tables, &networks, ahead, &absent, frames))?;
    eprintln!("{}", file.display());
    Ok(())
}

/// Native rendering, [`BASELINES`] and [`OURS`] along the path, the latter in two rows each: without what they make between,
/// and with it. And why some of ours are absent.
fn along(
    path: &CameraPath,
    frames: usize,
    settings: &MethodSettings,
) -> Result<(Vec<Row>, Vec<String>), Box<dyn Error>> {
    let mut native = build(MethodSpec::NATIVE, settings)?;
    let mut rows = vec![Row::new("native", 1.0)];
    let mut baselines = Vec::new();
    for name in BASELINES {
        baselines.push(build(name.parse()?, settings)?);
        rows.push(Row::new(name, 1.0));
    }
    let (mut ours, mut absent) = (Vec::new(), Vec::new());
    for [alone, whole] in OURS {
        let mut name = whole.to_owned();
        let mut method = build(whole.parse()?, settings);
        if let Err(error) = &method {
            eprintln!("{whole} is left out: {error}");
            absent.push(error.to_string());
            // There may be weights for super sampling alone; warping needs none.
            name = format!("{alone}+warp");
            method = build(name.parse()?, settings);
        }
        if let Ok(method) = method {
            ours.push(method);
            rows.extend([Row::new(alone, 1.0), Row::new(&name, 2.0)]);
        }
    }
    // Truth and image of the frame before, by row; of those with frames between, the last one displayed.
    let mut before: Vec<Option<(Image, Image)>> = vec![None; rows.len()];
    let cameras = path.cameras();
    for k in 0..frames {
        let middle = (k > 0).then(|| path.at(k as f64 - 0.5));
        let truth_between = match &middle {
            Some(camera) => Some(native.render(camera, None)?.current.clone()),
            None => None,
        };
        let truth = native.render(&cameras[k], None)?.current.clone();
        if k > 0 {
            rows[NATIVE].milliseconds.push(milliseconds(native.as_ref(), &Stage::ALL));
        }
        for (i, method) in baselines.iter_mut().enumerate() {
            let image = method.render(&cameras[k], None)?.current.clone();
            let ms = milliseconds(method.as_ref(), &Stage::ALL);
            let row = &mut rows[BICUBIC + i];
            row.rendered.add(&truth, &image)?;
            if k > 0 {
                row.milliseconds.push(ms);
            }
            follow(row, &mut before[BICUBIC + i], &truth, image)?;
        }
        for (i, method) in ours.iter_mut().enumerate() {
            let [alone, whole] = [HISTORY + 2 * i, HISTORY + 2 * i + 1];
            let shown = method.render(&cameras[k], middle.as_ref())?;
            let (between, current) = (shown.between.cloned(), shown.current.clone());
            rows[alone].rendered.add(&truth, &current)?;
            rows[whole].rendered = rows[alone].rendered.clone();
            if let (Some(truth), Some(image)) = (&truth_between, between) {
                rows[whole].between.add(truth, &image)?;
                follow(&mut rows[whole], &mut before[whole], truth, image)?;
                rows[alone].milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL[..2]));
                rows[whole].milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL));
            }
            follow(&mut rows[alone], &mut before[alone], &truth, current.clone())?;
            follow(&mut rows[whole], &mut before[whole], &truth, current)?;
        }
    }
    Ok((rows, absent))
}

/// Adds the tPSNR of `image` and the frame before it, and remembers it.
fn follow(
    row: &mut Row,
    before: &mut Option<(Image, Image)>,
    truth: &Image,
    image: Image,
) -> Result<(), Box<dyn Error>> {
    if let Some((truth_before, image_before)) = before {
        let value = tpsnr([truth_before, truth], [image_before, &image], Quantisation::None)?;
        row.tpsnr.push(value.min(PSNR_CAP));
    }
    *before = Some((truth.clone(), image));
    Ok(())
}

fn milliseconds(method: &dyn Method, stages: &[Stage]) -> f64 {
    let durations = method.durations();
    let total: Duration = stages.iter().filter_map(|stage| durations[*stage as usize]).sum();
    total.as_secs_f64() * 1e3
}

/// Networks on the last frame and frames evenly before it, with gs3 without frames between at the same frames from `rows`; and
/// who is ahead of its best.
fn network_table(
    path_name: &str,
    path: &CameraPath,
    frames: usize,
    settings: &MethodSettings,
    rows: &[Row],
) -> Result<(String, Vec<String>), Box<dyn Error>> {
    let at: Vec<usize> = (1..=NETWORK_FRAMES).map(|i| i * frames / NETWORK_FRAMES - 1).collect();
    let cameras: Vec<Camera> = at.iter().map(|k| path.cameras()[*k]).collect();
    let mut native = build("native".parse()?, settings)?;
    let truths = cameras
        .iter()
        .map(|camera| Ok(native.render(camera, None)?.current.clone()))
        .collect::<Result<Vec<Image>, Box<dyn Error>>>()?;
    let mut text =
        String::from("| LR frames | method | PSNR | SSIM | ms per frame |\n|---|---|--:|--:|--:|\n");
    let of = |values: &[f64]| at.iter().map(|k| values[*k]).sum::<f64>() / at.len() as f64;
    let ours = || rows[HISTORY..].iter().step_by(2);
    for row in ours() {
        writeln!(
            text,
            "| matched, jittered | {} | {:.2} | {:.4} | {} |",
            row.name,
            of(&row.rendered.psnr),
            of(&row.rendered.ssim),
            shown(row.fps().map(|fps| 1e3 / fps), 0),
        )?;
    }
    let best = ours().map(|row| of(&row.rendered.psnr)).fold(f64::NEG_INFINITY, f64::max);
    let mut ahead = Vec::new();
    for name in NETWORK_METHODS {
        let mut method = build(name.parse()?, settings)?;
        let mut row = Row::new(name, 1.0);
        for (camera, truth) in cameras.iter().zip(&truths) {
            let image = method.render(camera, None)?.current.clone();
            row.rendered.add(truth, &image)?;
            row.milliseconds.push(milliseconds(method.as_ref(), &Stage::ALL));
        }
        let (method, formation) = name.split_once('@').unwrap_or((name, "matched"));
        // Their LR frames are reductions of the native image, which no renderer would have.
        let time = match (formation, row.fps()) {
            ("antialiased", _) | (_, None) => "–".into(),
            (_, Some(fps)) => format!("{:.0}", 1e3 / fps),
        };
        let (psnr, ssim) = (mean(&row.rendered.psnr), mean(&row.rendered.ssim));
        let lead = psnr.unwrap_or_default() - best;
        if lead > 0.0 {
            ahead.push(format!(
                "{path_name}, {} frames: {method} on {formation} LR frames has {lead:.2} dB more PSNR than the best of gs3.",
                at.len()
            ));
        }
        writeln!(text, "| {formation} | {method} | {} | {} | {time} |", shown(psnr, 2), shown(ssim, 4))?;
    }
    Ok((text, ahead))
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn shown(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".into(), |v| format!("{v:.digits$}"))
}

fn page(
    tables: &[(&str, usize, Vec<Row>)],
    networks: &str,
    ahead: Vec<String>,
    absent: &[String],
    frames: usize,
) -> String {
    let machine = Machine::this();
    let mut text = format!(
        "# Results\n\nWritten by `cargo run --release -p gs3-evaluate --example results -- ../shared {frames}`; gs3 {}, {}, \
         {} threads, {}.\n\n\
         {}×{} from {}×{} (×{SCALE}), frames 0..{frames} of each path, against the scene's own native rendering. `history` is \
         gs3's super sampling without learning, `analytic` adds a frame before each rendered one: its PSNR between is against \
         native rendering at the true pose. `fast`, `balanced` and `high` are the same with learning, `fast_ss` and so on without \
         the frames between. PSNR: one mean squared error per frame over RGB in [0, 1], mean over frames; SSIM as \
         in scikit-image, over rendered frames; tPSNR: PSNR of the differences of consecutive displayed frames, which are half as \
         far apart where there are frames between. History starts empty at frame 0, and these first frames count. Displayed FPS: \
         frames shown per rendered one over its median time; native rendering is gs3's own rasterizer with AccuTile culling. gs3's \
         networks compute in bf16 where the machine has it.{}\n\n",
        env!("CARGO_PKG_VERSION"),
        machine.processor,
        machine.threads,
        machine.simd,
        SIZE.0,
        SIZE.1,
        SIZE.0 / SCALE,
        SIZE.1 / SCALE,
        absent.iter().map(|reason| format!(" Absent: {reason}.")).collect::<String>(),
    );
    text += &behind(tables, ahead);
    for (path, gaussians, rows) in tables {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "## {path} ({gaussians} Gaussians)\n\n| method | PSNR rendered | PSNR between | SSIM | tPSNR | displayed FPS | \
             × native |\n|---|--:|--:|--:|--:|--:|--:|"
        );
        let native = rows[NATIVE].fps();
        for row in rows {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} |",
                row.name,
                shown(mean(&row.rendered.psnr), 2),
                shown(mean(&row.between.psnr), 2),
                shown(mean(&row.rendered.ssim), 4),
                shown(mean(&row.tpsnr), 2),
                shown(row.fps(), 2),
                shown(row.fps().zip(native).map(|(fps, native)| fps / native), 2),
            );
        }
        text += "\n";
    }
    let _ = writeln!(
        text,
        "## Published networks ({NETWORK_FRAMES} frames of each path)\n\nAs published, trained on photographs, not on splats. How \
         LR frames come about decides how they rank: `matched` are point samples of the native image (dilation 0.3/S²), `stock` \
         has the dilation 0.3 of 3D Gaussian Splatting at LR, `antialiased` is the native image reduced by a bicubic filter, as \
         networks are trained, which no renderer has without rendering natively. gs3 stands for comparison, at the same \
         frames of its run.\n\n{networks}"
    );
    text.trim_end().to_owned() + "\n"
}

/// Where gs3 is behind, said first; `ahead` says which networks are.
fn behind(tables: &[(&str, usize, Vec<Row>)], ahead: Vec<String>) -> String {
    let mut lines: Vec<String> = ahead.into_iter().map(|line| format!("- {line}\n")).collect();
    let mut add = |line: String| lines.push(format!("- {line}\n"));
    for (path, _, rows) in tables {
        let psnr = |i: usize| mean(&rows[i].rendered.psnr).unwrap_or_default();
        let ssim = |i: usize| mean(&rows[i].rendered.ssim).unwrap_or_default();
        let between = |i: usize| mean(&rows[i].between.psnr).unwrap_or_default();
        let name = |i: usize| &rows[i].name;
        // Ours against baselines, and learned ours against ours without learning.
        for ours in (HISTORY..rows.len()).step_by(2) {
            let simpler = (BICUBIC..HISTORY).chain((ours != HISTORY).then_some(HISTORY));
            for other in simpler {
                if psnr(other) > psnr(ours) {
                    let lead = psnr(other) - psnr(ours);
                    add(format!("{path}: {} has {lead:.2} dB more PSNR than {}.", name(other), name(ours)));
                }
                if ssim(other) > ssim(ours) {
                    let lead = ssim(other) - ssim(ours);
                    add(format!("{path}: {} has {lead:.4} more SSIM than {}.", name(other), name(ours)));
                }
            }
            let whole = ours + 1;
            if between(ANALYTIC) > between(whole) {
                let lead = between(ANALYTIC) - between(whole);
                add(format!("{path}: between, analytic has {lead:.2} dB more PSNR than {}.", name(whole)));
            }
            if let (Some(native), Some(fps)) = (rows[NATIVE].fps(), rows[whole].fps())
                && fps < native
            {
                let shows = format!("shows {fps:.2} frames a second, native rendering {native:.2}");
                add(format!("{path}: {} {shows}.", name(whole)));
            }
        }
        if let (Some(bicubic), Some(history)) = (rows[BICUBIC].fps(), rows[HISTORY].fps())
            && bicubic > NOTABLE * history
        {
            add(format!("{path}: history takes {:.1} times the time of bicubic.", bicubic / history));
        }
    }
    if lines.is_empty() {
        lines.push("Of these baselines and paths, nowhere.\n".into());
    }
    format!("## Where gs3 is behind\n\n{}\n", lines.concat())
}
