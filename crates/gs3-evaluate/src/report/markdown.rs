//! A Markdown table for READMEs.

use std::fmt::Write;

use crate::protocol::{Results, Subset};

/// The results as a Markdown table, one row per method, all of its frames together, with a line on how they were made.
#[must_use]
pub fn markdown(results: &Results) -> String {
    let protocol = &results.protocol;
    let mut text = format!(
        "{} ({} Gaussians), {} frames {}..{} ({}), {}×{}, ×{}, {} ({} threads)\n\n",
        protocol.scene,
        protocol.gaussians,
        protocol.path,
        protocol.frames[0],
        protocol.frames[1],
        protocol.case,
        protocol.size[0],
        protocol.size[1],
        protocol.scale,
        protocol.machine.processor,
        protocol.machine.threads,
    );
    let has_jod = results.results.iter().any(|row| row.jod.is_some());
    let jod = |value: String| if has_jod { format!(" {value} |") } else { String::new() };
    let has_refined = results.results.iter().any(|row| row.refined_share.is_some());
    let refined = |value: String| if has_refined { format!(" {value} |") } else { String::new() };
    let _ = writeln!(
        text,
        "| method | PSNR rendered | PSNR between | SSIM | FLIP | edge PSNR | block p99 | tPSNR | warping error |{}{} displayed \
         FPS | × native |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|{}{}--:|--:|",
        jod("JOD".into()),
        refined("refined".into()),
        if has_jod { "--:|" } else { "" },
        if has_refined { "--:|" } else { "" },
    );
    for (method, _) in &results.scores {
        let Some(all) = results.row(method, Subset::All) else { continue };
        let psnr = |subset| number(results.row(method, subset).map(|row| row.psnr), 2);
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| {method} | {} | {} | {} | {} | {} | {} | {} | {} |{}{} {} | {} |",
            psnr(Subset::SuperSampled),
            psnr(Subset::Interpolated),
            number(Some(all.ssim), 4),
            number(Some(all.flip), 4),
            number(all.edge_psnr, 2),
            number(Some(all.block_rmse_p99), 2),
            number(all.tpsnr, 2),
            all.warping_error.map_or_else(|| "–".into(), |v| format!("{v:.2e}")),
            jod(number(all.jod, 2)),
            refined(all.refined_share.map_or_else(|| "–".into(), |share| format!("{:.1} %", 100.0 * share))),
            number(all.displayed_fps, 2),
            number(all.speedup_over_native, 2),
        );
    }
    let _ = writeln!(
        text,
        "\nPSNR is of rendered frames and of those between apart, all else of all frames shown. Edge PSNR: of pixels near depth \
         discontinuities. Block p99: 99th percentile of the RMSE of 8×8 blocks, of 255. × native: of native frames timed in turn \
         with the method's, not of the row above."
    );
    for failure in &results.failures {
        let _ = writeln!(text, "\n{} failed: {}", failure.method, failure.error);
    }
    text
}

/// A number with `digits` decimals, or a dash.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".into(), |v| format!("{v:.digits$}"))
}
