//! The page.

use std::fmt::Write;

use gs3::KEYFRAMES;
use gs3_evaluate::protocol::{MachineReport, PSNR_CAP};

use crate::along::{ANALYTIC, BICUBIC, HISTORY, KRIGING, NATIVE, OVERSCAN};
use crate::score::{Row, mean, mean_of_rendered, shown};
use crate::{SCALE, SIZE, front, networks, parts, rest};

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

/// What the names of methods and measures mean.
const METHODS: &str = "\
    | method | is |\n\
    |---|---|\n\
    | `native` | gs3's own rasterizer, every pixel, with AccuTile culling |\n\
    | `bicubic`, `hermite` | one LR frame enlarged; `hermite` reads exact gradients |\n\
    | `history`, `analytic` | super sampling without learning; the second name of each pair also \
    shows one in-between frame before each rendered one |\n\
    | `kriging`, `kriged` | the same, with kriging where first-order predictions err visibly |\n\
    | `overscan`, `overscanned` | the same, with LR frames rasterized beyond the edges that the \
    camera turns to |\n\
    | `fast_ss`, `fast`, `balanced_ss`, `balanced`, `high_ss`, `high` | the same, with super sampling \
    by the tier's network; kriging is coarse below `fast` and fine below `high` |\n\
    | `refined_fast`, `refined`, `refined_high` | `history` with exact pixels at the quality fast, balanced and high; \
    `+warp` also shows one in-between frame before each rendered one, `+warp2` two; `default` is `refined+warp2`: what gs3 does \
    unless it is told otherwise |\n\
    \n\
    | measure | is |\n\
    |---|---|\n\
    | PSNR rendered, PSNR between | one mean squared error a frame over RGB in [0, 1], mean over \
    frames; in-between frames are compared with native rendering at their true poses, half-way between two rendered frames, or \
    at one and two thirds of the way, nearer to rendered frames |\n\
    | SSIM | as in scikit-image, over rendered frames |\n\
    | edge PSNR | PSNR of the pixels within 2 px of a discontinuity of the native depth of 10 %, over rendered frames |\n\
    | block RMSE | 99th percentile of the RMSE of 8×8 blocks, of 255, mean over rendered frames |\n\
    | tPSNR | PSNR of the differences of consecutive displayed frames; one in-between frame leaves a half \
    of the time between them, two a third |\n\
    | displayed FPS | frames displayed for a rendered frame, over the median time of the rendered \
    frame |\n";

/// What published networks are given.
const NETWORKS: &str = "\
    `span`, `safmn` and `rt4ksr` are as published, trained on photographs. `ecbsr_trained`, \
    `rt4ksr_trained` and `ninasr_trained` (B1) were trained by gs3's trainer, on matched LR frames of \
    other scenes. Published networks compute in f32, gs3 as `gs3 render` does on the machine. The \
    rows of gs3 are of the same frames of its run. The LR frames decide how methods rank:\n\
    \n\
    | LR frames | are |\n\
    |---|---|\n\
    | `matched` | point samples of the native image (dilation 0.3/S²) |\n\
    | `kerbl` | rendered at LR with the dilation 0.3 of 3D Gaussian Splatting (Kerbl et al.) |\n\
    | `antialiased` | the native image reduced by a bicubic filter, as networks are trained; no \
    renderer has such frames without native rendering |\n";

/// The text of the page. `plot` is the plot's file beside the page.
pub fn page(sections: &Sections, frames: usize, plot: &str) -> String {
    let machine = MachineReport::this();
    let mut text = format!(
        "# Results\n\n\
         Written by `cargo run --release -p gs3-evaluate --example results -- FOLDER {frames}`; gs3 {}, {}, \
         {} threads, {}. FOLDER has the folders `scenes`, `paths` and `weights`.\n\n\
         {}×{} from {}×{} (×{SCALE}), frames 0..{frames} of each path, against the scene's own native rendering. \
         The history is empty at frame 0. Means over rendered frames leave frame 0 and every \
         {KEYFRAMES}nd frame out, which `refined*` makes natively as a whole; displayed FPS are of median frames. Networks compute in \
         bf16 where bf16 is faster.{}\n\n{METHODS}\n",
        env!("CARGO_PKG_VERSION"),
        machine.processor,
        machine.threads,
        machine.simd,
        SIZE.width,
        SIZE.height,
        SIZE.width / SCALE,
        SIZE.height / SCALE,
        sections.absent.iter().map(|reason| format!(" Absent: {reason}.")).collect::<String>(),
    );
    let _ = writeln!(
        text,
        "## Quality and speed\n\n![PSNR over displayed frames, by path]({plot})\n\n\
         PSNR of rendered frames over displayed frames a second, as a multiple of native rendering's, by path. The line joins \
         the methods that no other method of gs3 or baseline exceeds in both.\n\n{}\n",
        front::dominated(&sections.paths)
    );
    text += &behind(sections);
    for (path, gaussians, rows) in &sections.paths {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "## {path} ({gaussians} Gaussians)\n\n| method | PSNR rendered | PSNR between | SSIM | edge PSNR | block RMSE | \
             tPSNR | displayed FPS | × native |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|"
        );
        let native = rows[NATIVE].fps();
        for row in rows {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                row.name,
                shown(mean_of_rendered(&row.rendered.psnr), 2),
                shown(mean(&row.between.psnr), 2),
                shown(mean_of_rendered(&row.rendered.ssim), 4),
                shown(mean_of_rendered(&row.rendered.edge_psnr), 2),
                shown(mean_of_rendered(&row.rendered.block_rmse_p99), 1),
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
        "## At rest\n\nPSNR after {} frames of the path's first camera, at most {PSNR_CAP} dB. The first frame of `refined*` is native \
         as a whole.\n\n| path | method | {} |\n|---|---|{}\n{}",
        of_rest.map(|k| k.to_string()).join(", "),
        of_rest.map(|k| format!("{k} frames")).join(" | "),
        "--:|".repeat(of_rest.len()),
        sections.rest
    );
    let _ = writeln!(
        text,
        "## Parts left out ({of_parts} frames of each path)\n\nThe paper's ablations. The weights are the shipped \
         ones: no network was trained again without a part. So gradients, jitter and recurrence are left out of \
         the pipeline without learning, overscan and kriging (*all three*).\n\n{}",
        sections.parts
    );
    let _ = writeln!(
        text,
        "## Published networks ({of_networks} frames of each path)\n\n{NETWORKS}\n{}",
        sections.networks
    );
    text.trim_end().to_owned() + "\n"
}

/// Where gs3 is behind, said first.
fn behind(sections: &Sections) -> String {
    let mut lines: Vec<String> = sections.ahead.iter().map(|line| format!("- {line}\n")).collect();
    let mut add = |line: String| lines.push(format!("- {line}\n"));
    for (path, _, rows) in &sections.paths {
        let psnr = |i: usize| mean_of_rendered(&rows[i].rendered.psnr).unwrap_or_default();
        let ssim = |i: usize| mean_of_rendered(&rows[i].rendered.ssim).unwrap_or_default();
        let between = |i: usize| mean(&rows[i].between.psnr).unwrap_or_default();
        let name = |i: usize| &rows[i].name;
        for ours in HISTORY..rows.len() {
            if rows[ours].in_between > 0 {
                let lead = between(ANALYTIC) - between(ours);
                if lead >= 0.005 {
                    add(format!("{path}: between, analytic has {lead:.2} dB more PSNR than {}.", name(ours)));
                }
                if let (Some(native), Some(fps)) = (rows[NATIVE].fps(), rows[ours].fps())
                    && fps < native
                {
                    let shows = format!("shows {fps:.2} frames a second, native rendering {native:.2}");
                    add(format!("{path}: {} {shows}.", name(ours)));
                }
                continue;
            }
            // Super sampling against baselines, and against what of ours it builds on: exact pixels on history alone.
            let parts = if name(ours).starts_with("refined") {
                &[HISTORY][..]
            } else {
                &[HISTORY, KRIGING, OVERSCAN]
            };
            let simpler = (BICUBIC..HISTORY).chain(parts.iter().copied().filter(|part| *part < ours));
            for other in simpler {
                // Half a step of what is written, and more.
                let lead = psnr(other) - psnr(ours);
                if lead >= 0.005 {
                    add(format!("{path}: {} has {lead:.2} dB more PSNR than {}.", name(other), name(ours)));
                }
                let lead = ssim(other) - ssim(ours);
                if lead >= 0.000_05 {
                    add(format!("{path}: {} has {lead:.4} more SSIM than {}.", name(other), name(ours)));
                }
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
