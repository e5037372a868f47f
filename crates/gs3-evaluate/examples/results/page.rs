//! The page.

use std::fmt::Write;

use gs3_evaluate::protocol::Machine;

use crate::along::{ANALYTIC, BICUBIC, HISTORY, KRIGING, NATIVE, OVERSCAN};
use crate::score::{Row, mean, shown};
use crate::{SCALE, SIZE, networks, parts, rest};

/// What the page says.
#[derive(Default)]
pub struct Sections {
    /// Paths, Gaussians of their scenes, and rows of [`crate::along`].
    pub paths: Vec<(&'static str, usize, Vec<Row>)>,
    /// Why some of ours are absent.
    pub absent: Vec<String>,
    /// Tables of [`networks`].
    pub networks: String,
    /// Tables of [`parts`].
    pub parts: String,
    /// Where either are ahead of gs3.
    pub ahead: Vec<String>,
    /// Rows of [`rest`].
    pub rest: String,
}

/// Differences of times below this factor are noise.
const NOTABLE: f64 = 1.1;

/// The text of the page.
pub fn page(sections: &Sections, frames: usize) -> String {
    let machine = Machine::this();
    let mut text = format!(
        "# Results\n\nWritten by `cargo run --release -p gs3-evaluate --example results -- ../shared {frames}`; gs3 {}, {}, \
         {} threads, {}.\n\n\
         {}×{} from {}×{} (×{SCALE}), frames 0..{frames} of each path, against the scene's own native rendering. `history` is \
         gs3's super sampling without learning, `analytic` adds a frame before each rendered one: its PSNR between is against \
         native rendering at the true pose. `kriging` and `kriged` krige the pixels where first-order predictions err visibly; `overscan` and `overscanned` are that \
         with LR frames rasterized beyond the edges that the camera turns to; `fast`, `balanced` and `high` are that with learned super sampling, kriged coarsely below `fast` and finely below `high`, `fast_ss` and so on without the frames between. PSNR: one mean squared error per frame over RGB in [0, 1], mean over frames; SSIM as \
         in scikit-image, over rendered frames; tPSNR: PSNR of the differences of consecutive displayed frames, which are half as \
         far apart where there are frames between. History starts empty at frame 0, and these first frames count. Displayed FPS: \
         frames shown per rendered one over its median time; native rendering is gs3's own rasterizer with AccuTile culling. gs3's \
         networks compute in bf16 where that is faster.{}\n\n",
        env!("CARGO_PKG_VERSION"),
        machine.processor,
        machine.threads,
        machine.simd,
        SIZE.0,
        SIZE.1,
        SIZE.0 / SCALE,
        SIZE.1 / SCALE,
        sections.absent.iter().map(|reason| format!(" Absent: {reason}.")).collect::<String>(),
    );
    text += &behind(sections);
    for (path, gaussians, rows) in &sections.paths {
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
    let (of_networks, of_parts, of_rest) = (networks::FRAMES, parts::FRAMES, rest::FRAMES);
    let _ = writeln!(
        text,
        "## At rest\n\nPSNR after {} frames of the path's first camera.\n\n| path | method | {} |\n|---|---|{}\n{}",
        of_rest.map(|k| k.to_string()).join(", "),
        of_rest.map(|k| format!("{k} frames")).join(" | "),
        "--:|".repeat(of_rest.len()),
        sections.rest
    );
    let _ = writeln!(
        text,
        "## Parts left out ({of_parts} frames of each path)\n\nThe paper's ablations. Weights are those of the whole: no network \
         was trained anew without a part, so gradients, jitter and recurrence are left out of the pipeline without learning, overscan and kriging.\n\n{}",
        sections.parts
    );
    let _ = writeln!(
        text,
        "## Published networks ({of_networks} frames of each path)\n\nAs published, trained on photographs, not on splats; \
         `ecbsr_trained`, `rt4ksr_trained` and `ninasr_trained` (B1) by gs3's trainer, on matched LR frames of other scenes; all in f32, gs3 in what `gs3 render` \
         uses on the machine. How LR frames come about decides how they rank: `matched` are point samples of the native image (dilation 0.3/S²), `stock` \
         has the dilation 0.3 of 3D Gaussian Splatting at LR, `antialiased` is the native image reduced by a bicubic filter, as \
         networks are trained, which no renderer has without rendering natively. gs3 stands for comparison, at the same \
         frames of its run.\n\n{}",
        sections.networks
    );
    text.trim_end().to_owned() + "\n"
}

/// Where gs3 is behind, said first.
fn behind(sections: &Sections) -> String {
    let mut lines: Vec<String> = sections.ahead.iter().map(|line| format!("- {line}\n")).collect();
    let mut add = |line: String| lines.push(format!("- {line}\n"));
    for (path, _, rows) in &sections.paths {
        let psnr = |i: usize| mean(&rows[i].rendered.psnr).unwrap_or_default();
        let ssim = |i: usize| mean(&rows[i].rendered.ssim).unwrap_or_default();
        let between = |i: usize| mean(&rows[i].between.psnr).unwrap_or_default();
        let name = |i: usize| &rows[i].name;
        // Ours against baselines, and against what of ours they build on.
        for ours in (HISTORY..rows.len()).step_by(2) {
            let simpler = (BICUBIC..HISTORY)
                .chain([HISTORY, KRIGING, OVERSCAN].into_iter().filter(|part| *part < ours));
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
