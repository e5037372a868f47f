//! Writes `docs/results.md`: gs3 without learning against native rendering, its baselines and published networks, on captured
//! scenes.
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
use gs3_evaluate::methods::{Method, MethodSettings, build};
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
/// The path whose frames networks get, and how many of them.
const NETWORK_PATH: &str = "flowers_drift";
const NETWORK_FRAMES: usize = 2;
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
    let (mut networks, mut ahead) = (String::new(), Vec::new());
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
        let rows = along(&path, frames, &settings)?;
        if path_name == NETWORK_PATH {
            (networks, ahead) = network_table(&path, frames, &settings, &rows)?;
        }
        tables.push((path_name, settings.scene.gaussians().len(), rows));
    }
    std::fs::write(&file, page(&tables, &networks, ahead, frames))?;
    eprintln!("{}", file.display());
    Ok(())
}

/// Native rendering, bicubic, hermite, history and analytic along the path; history is analytic without what it makes between.
fn along(path: &CameraPath, frames: usize, settings: &MethodSettings) -> Result<Vec<Row>, Box<dyn Error>> {
    let method =
        |name: &str| -> Result<Box<dyn Method>, Box<dyn Error>> { Ok(build(name.parse()?, settings)?) };
    let mut native = method("native")?;
    let mut spatial = [method("bicubic")?, method("hermite")?];
    let mut analytic = method("analytic")?;
    let mut rows: Vec<Row> =
        ["native", "bicubic", "hermite", "history"].map(|name| Row::new(name, 1.0)).to_vec();
    rows.push(Row::new("analytic", 2.0));
    // Truth and image of the frame before, by row; of analytic, the last one displayed.
    let mut before: Vec<Option<(Image, Image)>> = vec![None; rows.len()];
    let cameras = path.cameras();
    for k in 0..frames {
        let middle = (k > 0).then(|| path.at(k as f64 - 0.5));
        let truth_between = match &middle {
            Some(camera) => Some(native.render(camera, None)?.current.clone()),
            None => None,
        };
        let truth = native.render(&cameras[k], None)?.current.clone();
        let native_ms = milliseconds(native.as_ref(), &Stage::ALL);
        if k > 0 {
            rows[0].milliseconds.push(native_ms);
        }
        for (i, method) in spatial.iter_mut().enumerate() {
            let image = method.render(&cameras[k], None)?.current.clone();
            let ms = milliseconds(method.as_ref(), &Stage::ALL);
            let row = &mut rows[1 + i];
            row.rendered.add(&truth, &image)?;
            if k > 0 {
                row.milliseconds.push(ms);
            }
            follow(row, &mut before[1 + i], &truth, image)?;
        }
        let shown = analytic.render(&cameras[k], middle.as_ref())?;
        let (between, current) = (shown.between.cloned(), shown.current.clone());
        let [history, whole] = [&Stage::ALL[..2], &Stage::ALL].map(|s| milliseconds(analytic.as_ref(), s));
        rows[3].rendered.add(&truth, &current)?;
        if let (Some(truth), Some(image)) = (truth_between, between) {
            rows[4].between.add(&truth, &image)?;
            follow(&mut rows[4], &mut before[4], &truth, image)?;
            rows[3].milliseconds.push(history);
            rows[4].milliseconds.push(whole);
        }
        follow(&mut rows[3], &mut before[3], &truth, current.clone())?;
        follow(&mut rows[4], &mut before[4], &truth, current)?;
    }
    rows[4].rendered = rows[3].rendered.clone();
    Ok(rows)
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

/// Networks on the last frame and frames evenly before it, with gs3's history at the same frames from `rows`; and who is ahead
/// of it.
fn network_table(
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
    let history = &rows[3].rendered;
    let of = |values: &[f64]| at.iter().map(|k| values[*k]).sum::<f64>() / at.len() as f64;
    writeln!(
        text,
        "| matched, jittered | history | {:.2} | {:.4} | {:.0} |",
        of(&history.psnr),
        of(&history.ssim),
        rows[3].fps().map_or(f64::NAN, |fps| 1e3 / fps)
    )?;
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
        let lead = psnr.unwrap_or_default() - of(&history.psnr);
        if lead > 0.0 {
            ahead.push(format!(
                "{NETWORK_PATH}, {} frames: {method} on {formation} LR frames has {lead:.2} dB more PSNR than history.",
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

fn page(tables: &[(&str, usize, Vec<Row>)], networks: &str, ahead: Vec<String>, frames: usize) -> String {
    let machine = Machine::this();
    let mut text = format!(
        "# Results\n\nWritten by `cargo run --release -p gs3-evaluate --example results -- ../shared {frames}`; gs3 {}, {}, \
         {} threads, {}.\n\n\
         {}×{} from {}×{} (×{SCALE}), frames 0..{frames} of each path, against the scene's own native rendering. `history` is \
         gs3's super sampling without learning, `analytic` adds a frame before each rendered one: its PSNR between is against \
         native rendering at the true pose. PSNR: one mean squared error per frame over RGB in [0, 1], mean over frames; SSIM as \
         in scikit-image, over rendered frames; tPSNR: PSNR of the differences of consecutive displayed frames, which are half as \
         far apart for `analytic` as for the others. History starts empty at frame 0, and these first frames count. Displayed FPS: \
         frames shown per rendered one over its median time; native rendering is gs3's own rasterizer with AccuTile culling. \
         Learned tiers are absent: no trained weights come with this version.\n\n",
        env!("CARGO_PKG_VERSION"),
        machine.processor,
        machine.threads,
        machine.simd,
        SIZE.0,
        SIZE.1,
        SIZE.0 / SCALE,
        SIZE.1 / SCALE,
    );
    text += &behind(tables, ahead);
    for (path, gaussians, rows) in tables {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "## {path} ({gaussians} Gaussians)\n\n| method | PSNR rendered | PSNR between | SSIM | tPSNR | displayed FPS | \
             × native |\n|---|--:|--:|--:|--:|--:|--:|"
        );
        let native = rows[0].fps();
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
        "## Published networks ({NETWORK_PATH}, {NETWORK_FRAMES} frames)\n\nAs published, trained on photographs, not on splats. How \
         LR frames come about decides how they rank: `matched` are point samples of the native image (dilation 0.3/S²), `stock` \
         has the dilation 0.3 of 3D Gaussian Splatting at LR, `antialiased` is the native image reduced by a bicubic filter, as \
         networks are trained, which no renderer has without rendering natively. `history` stands for comparison, at the same \
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
        for baseline in [1, 2] {
            let name = &rows[baseline].name;
            if psnr(baseline) > psnr(3) {
                add(format!("{path}: {name} has {:.2} dB more PSNR than history.", psnr(baseline) - psnr(3)));
            }
            if ssim(baseline) > ssim(3) {
                add(format!("{path}: {name} has {:.4} more SSIM than history.", ssim(baseline) - ssim(3)));
            }
        }
        if let (Some(native), Some(analytic)) = (rows[0].fps(), rows[4].fps())
            && analytic < native
        {
            add(format!(
                "{path}: analytic shows {analytic:.2} frames a second, native rendering {native:.2}."
            ));
        }
        if let (Some(bicubic), Some(history)) = (rows[1].fps(), rows[3].fps())
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
