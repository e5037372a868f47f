//! gs3 with parts left out.

use std::error::Error;
use std::fmt::Write;

use gs3_evaluate::methods::{MethodSettings, MethodSpec, build};
use gs3_scene::CameraPath;

use crate::score::{Row, follow, mean, shown};
use crate::truth::Truth;

/// The paths of their frames, and how many of them: from an empty history on, all that it holds, and half of that
/// again.
pub const PATHS: [&str; 3] = ["fungi_pan", "hqgarden_drift", "lacadiere_pan"];
pub const FRAMES: usize = 24;

/// What is left out, and the method without it. Networks are those of the whole, not trained anew. Those from
/// [`UNLEARNED`] on leave out more than it does.
const PARTS: [(&str, &str); 11] = [
    ("nothing, learned", "balanced_ss+balanced"),
    ("learned interpolation", "balanced"),
    ("matched dilation (0.3 instead), learned", "balanced@kerbl"),
    ("learning", "overscanned"),
    ("learning and overscan", "kriged"),
    ("learning, overscan and kriging", "analytic"),
    ("all three and in-between frames (the frame before again)", "history+repeat"),
    ("all three and gradients (those of bicubic interpolation)", "history_gradientless+warp"),
    ("all three and jitter", "history_centered+warp"),
    ("all three and history (recurrence)", "hermite+warp"),
    ("all three and matched dilation (0.3 instead)", "analytic@kerbl"),
];

/// The row that lacks nothing but learning, overscan and kriging.
const UNLEARNED: usize = 5;

/// A table of them along `path`, and which parts do harm.
pub fn table(
    path_name: &str,
    path: &CameraPath,
    settings: &MethodSettings,
) -> Result<(String, Vec<String>), Box<dyn Error>> {
    let mut methods = Vec::new();
    for (_, name) in PARTS {
        let spec: MethodSpec = name.parse()?;
        methods.push((build(spec, settings)?, Row::new(spec), None));
    }
    let mut truth = Truth::new(path, settings, methods.iter().map(|(_, row, _)| row.in_between))?;
    for (k, camera) in path.cameras().iter().take(FRAMES).enumerate() {
        truth.render(k)?;
        for (method, row, before) in &mut methods {
            let (cameras, truths) = truth.between(row.in_between);
            let shown = method.render(camera, &cameras)?;
            for (truth, image) in truths.into_iter().zip(shown.in_between.into_iter().flatten()) {
                row.between.add(truth, image)?;
                follow(row, before, truth, image.clone())?;
            }
            row.rendered.add(&truth.current, shown.current)?;
            follow(row, before, &truth.current, shown.current.clone())?;
        }
    }
    let mut text =
        String::from("| left out | PSNR rendered | PSNR between | SSIM | tPSNR |\n|---|--:|--:|--:|--:|\n");
    for ((part, _), (_, row, _)) in PARTS.iter().zip(&methods) {
        writeln!(
            text,
            "| {part} | {} | {} | {} | {} |",
            shown(mean(&row.rendered.psnr), 2),
            shown(mean(&row.between.psnr), 2),
            shown(mean(&row.rendered.ssim), 4),
            shown(mean(&row.tpsnr), 2),
        )?;
    }
    let psnr = |k: usize| mean(&methods[k].1.rendered.psnr).unwrap_or_default();
    let harm = (UNLEARNED + 1..PARTS.len()).filter(|k| psnr(*k) > psnr(UNLEARNED)).map(|k| {
        let (lead, [part, whole]) = (psnr(k) - psnr(UNLEARNED), [k, UNLEARNED].map(|k| PARTS[k].0));
        format!(
            "{path_name}, {FRAMES} frames: without {part} PSNR is {lead:.2} dB higher than without {whole}."
        )
    });
    Ok((text, harm.collect()))
}
