//! Published single-image networks on a few frames, as published and trained by gs3's trainer.

use std::error::Error;
use std::fmt::Write;

use gs3::Stage;
use gs3_evaluate::methods::{MethodSettings, MethodSpec, build};
use gs3_scene::{Camera, CameraPath, Image};

use crate::along::HISTORY;
use crate::score::{Row, mean, milliseconds, shown};

/// The paths of the networks' frames, and how many of them.
pub const PATHS: [&str; 3] = ["flowers_drift", "fungi_drift", "hqgarden_drift"];
pub const FRAMES: usize = 4;
const METHODS: [&str; 16] = [
    "bicubic",
    "hermite",
    "span",
    "safmn",
    "rt4ksr",
    "ecbsr_trained",
    "rt4ksr_trained",
    "ninasr_trained",
    "bicubic@kerbl",
    "span@kerbl",
    "safmn@kerbl",
    "rt4ksr@kerbl",
    "bicubic@antialiased",
    "span@antialiased",
    "safmn@antialiased",
    "rt4ksr@antialiased",
];

/// Networks on the last frame and frames evenly before it, with gs3 without in-between frames at the same frames from
/// `rows`; and who is ahead of its best.
pub fn table(
    path_name: &str,
    path: &CameraPath,
    frames: usize,
    settings: &MethodSettings,
    rows: &[Row],
) -> Result<(String, Vec<String>), Box<dyn Error>> {
    let at: Vec<usize> = (1..=FRAMES).map(|i| i * frames / FRAMES - 1).collect();
    let cameras: Vec<Camera> = at.iter().map(|k| path.cameras()[*k]).collect();
    let mut native = build("native".parse()?, settings)?;
    let truths = cameras
        .iter()
        .map(|camera| Ok(native.render(camera, &[])?.current.clone()))
        .collect::<Result<Vec<Image>, Box<dyn Error>>>()?;
    let mut text =
        String::from("| LR frames | method | PSNR | SSIM | ms per frame |\n|---|---|--:|--:|--:|\n");
    let of = |values: &[f64]| at.iter().map(|k| values[*k]).sum::<f64>() / at.len() as f64;
    let ours = || rows[HISTORY..].iter().filter(|row| row.in_between == 0);
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
    for name in METHODS {
        let spec: MethodSpec = name.parse()?;
        let (mut method, mut row) = (build(spec, settings)?, Row::new(spec));
        for (camera, truth) in cameras.iter().zip(&truths) {
            let image = method.render(camera, &[])?.current.clone();
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
