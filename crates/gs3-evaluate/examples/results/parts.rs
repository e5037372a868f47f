//! gs3 with parts left out.

use std::error::Error;
use std::fmt::Write;

use gs3_evaluate::methods::{MethodSettings, MethodSpec, build};
use gs3_scene::CameraPath;

use crate::score::{Row, follow, mean, shown};

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
    let mut native = build(MethodSpec::NATIVE, settings)?;
    let mut methods = Vec::new();
    for (_, name) in PARTS {
        methods.push((build(name.parse()?, settings)?, Row::new(name, 2.0), None));
    }
    for (k, camera) in path.cameras().iter().take(FRAMES).enumerate() {
        let middle = (k > 0).then(|| path.at(k as f64 - 0.5));
        let truth_between = match &middle {
            Some(camera) => Some(native.render(camera, None)?.current.clone()),
            None => None,
        };
        let truth = native.render(camera, None)?.current.clone();
        for (method, row, before) in &mut methods {
            let shown = method.render(camera, middle.as_ref())?;
            if let (Some(truth), Some(image)) = (&truth_between, shown.in_between) {
                row.between.add(truth, image)?;
                follow(row, before, truth, image.clone())?;
            }
            row.rendered.add(&truth, shown.current)?;
            follow(row, before, &truth, shown.current.clone())?;
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
