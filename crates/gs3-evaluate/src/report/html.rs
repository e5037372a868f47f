//! The HTML page: one file, nothing loaded from elsewhere.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::base64;
use super::markdown::number;
use super::plot::{Axes, Series, color, plot, short};
use crate::protocol::{
    Failure, FrameScore, MethodScore, ProtocolFacts, ResultRow, Results, StageStatistics, Subset, TruthFacts,
};

/// The results as a self-contained page: tables, curves, details to compare, and how it was all measured.
#[must_use]
pub fn html(results: &Results) -> String {
    let protocol = &results.protocol;
    let title = format!("{}, {}", protocol.scene, protocol.path);
    let sections = [
        header(results),
        failed(&results.failures),
        section("Quality and speed", &(quality(results) + &speed_plot(results))),
        section("Frame by frame", &curves(results)),
        section("Look closer", &details(results)),
        section("Time of the stages", &stages(results)),
        section("How this was measured", &method_notes(results)),
    ];
    page(&title, &sections)
}

/// A page of these sections.
pub(super) fn page(title: &str, sections: &[String]) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>gs3 evaluate: {}</title>\n<style>\n{}</style></head>\n<body><main>\n{}\n</main>\n<script>\n{}</script></body></html>\n",
        escape(title),
        include_str!("style.css"),
        sections.join("\n"),
        include_str!("script.js"),
    )
}

pub(super) fn section(title: &str, body: &str) -> String {
    if body.is_empty() { String::new() } else { format!("<h2>{title}</h2>{body}") }
}

fn header(results: &Results) -> String {
    let p = &results.protocol;
    let motion = by_frames_between(p, |facts| facts.motion_px.map(|v| format!("{v:.1} px")));
    let facts = [
        ("Scene", format!("{}, {} Gaussians, SH degree {}", p.scene, p.gaussians, p.sh_degree)),
        ("Camera path", format!("{}, frames {}..{} ({})", p.path, p.frames[0], p.frames[1], p.case)),
        ("Displayed size", format!("{}×{}", p.size[0], p.size[1])),
        ("Rendered size", format!("{}×{} (×{})", p.size[0] / p.scale, p.size[1] / p.scale, p.scale)),
        ("Motion from frame to frame", motion),
        (
            "MachineReport",
            format!("{}, {} threads, {}", p.machine.processor, p.machine.threads, p.machine.simd),
        ),
        ("Version", format!("gs3 {}", p.version)),
    ];
    let facts: String =
        facts.iter().map(|(name, value)| format!("<div><b>{name}</b>{}</div>", escape(value))).collect();
    format!(
        "<h1>gs3 evaluate</h1><p class=\"soft\">Against the scene's own native rendering.</p><div class=\"card facts\">{facts}</div>"
    )
}

/// A fact of the ground truth of rendered frames, and of all frames with one, two or three between two rendered ones.
fn by_frames_between(protocol: &ProtocolFacts, fact: impl Fn(&TruthFacts) -> Option<String>) -> String {
    let of = |facts: &TruthFacts| {
        let value = fact(facts).unwrap_or_else(|| "–".into());
        match facts.in_between {
            0 => format!("{value} of rendered frames"),
            count => format!("{value} with {count} between"),
        }
    };
    protocol.truth.iter().map(of).collect::<Vec<_>>().join(", ")
}

/// A card of the methods that failed; nothing without any.
pub(super) fn failed(failures: &[Failure]) -> String {
    let of = |f: &Failure| format!("<p><b>{}</b> failed: {}</p>", escape(&f.method), escape(&f.error));
    let items: String = failures.iter().map(of).collect();
    match items.is_empty() {
        true => items,
        false => format!("<div class=\"card failed\" style=\"margin-top:16px\">{items}</div>"),
    }
}

/// A column of the table: its title, the value of a row, how it is written, and which values win.
struct Column {
    title: &'static str,
    value: fn(&MethodRows<'_>) -> Option<f64>,
    write: fn(f64) -> String,
    wins: Wins,
}

/// Which value of a column is the best.
#[derive(Clone, Copy, PartialEq)]
enum Wins {
    Most,
    Least,
    /// Neither: blur lowers the warping error below the ground truth's own.
    None,
}

/// The rows of one method.
struct MethodRows<'a> {
    index: usize,
    name: &'a str,
    all: &'a ResultRow,
    rendered: Option<&'a ResultRow>,
    between: Option<&'a ResultRow>,
}

fn rows(results: &Results) -> Vec<MethodRows<'_>> {
    let rows = |(index, (name, _)): (usize, &'_ (String, MethodScore))| {
        let all = results.row(name, Subset::All)?;
        let (rendered, between) =
            (results.row(name, Subset::SuperSampled), results.row(name, Subset::Interpolated));
        Some(MethodRows { index, name: &all.method, all, rendered, between })
    };
    results.scores.iter().enumerate().filter_map(rows).collect()
}

const COLUMNS: [Column; 14] = [
    Column {
        title: "PSNR<br>rendered",
        value: |m| Some(m.rendered?.psnr),
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
    Column {
        title: "PSNR<br>between",
        value: |m| Some(m.between?.psnr),
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
    Column {
        title: "PSNR<br>all",
        value: |m| Some(m.all.psnr),
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
    Column { title: "SSIM", value: |m| Some(m.all.ssim), write: |v| format!("{v:.4}"), wins: Wins::Most },
    Column { title: "FLIP", value: |m| Some(m.all.flip), write: |v| format!("{v:.4}"), wins: Wins::Least },
    Column {
        title: "Edge<br>PSNR",
        value: |m| m.all.edge_psnr,
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
    Column {
        title: "Block<br>p99",
        value: |m| Some(m.all.block_rmse_p99),
        write: |v| format!("{v:.2}"),
        wins: Wins::Least,
    },
    Column { title: "tPSNR", value: |m| m.all.tpsnr, write: |v| format!("{v:.2}"), wins: Wins::Most },
    Column {
        title: "Warping<br>error",
        value: |m| m.all.warping_error,
        write: |v| format!("{v:.2e}"),
        wins: Wins::None,
    },
    Column { title: "Flicker", value: |m| m.all.flicker, write: |v| format!("{v:.4}"), wins: Wins::Least },
    Column { title: "JOD", value: |m| m.all.jod, write: |v| format!("{v:.2}"), wins: Wins::Most },
    Column {
        title: "Refined",
        value: |m| m.all.refined_share,
        write: |v| format!("{:.1} %", 100.0 * v),
        wins: Wins::None,
    },
    Column {
        title: "Displayed<br>FPS",
        value: |m| m.all.displayed_fps,
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
    Column {
        title: "×&nbsp;native",
        value: |m| m.all.speedup_over_native,
        write: |v| format!("{v:.2}"),
        wins: Wins::Most,
    },
];

fn quality(results: &Results) -> String {
    let rows = rows(results);
    let best = |column: &Column| {
        // Native rendering is the reference of quality, no contender.
        let values = rows.iter().filter(|m| m.name != "native").filter_map(|m| (column.value)(m));
        match column.wins {
            Wins::Most => values.reduce(f64::max),
            Wins::Least => values.reduce(f64::min),
            Wins::None => None,
        }
    };
    // Columns that some method has a value in.
    let columns: Vec<&Column> =
        COLUMNS.iter().filter(|column| rows.iter().any(|m| (column.value)(m).is_some())).collect();
    let best: Vec<Option<f64>> = columns.iter().map(|column| best(column)).collect();
    let titles: String = columns.iter().map(|c| format!("<th>{}</th>", c.title)).collect();
    let mut body = String::new();
    for m in &rows {
        let cells: String = (columns.iter().zip(&best))
            .map(|(column, best)| match (column.value)(m) {
                None => "<td>–</td>".into(),
                Some(v) if Some(v) == *best && m.name != "native" => {
                    format!("<td class=\"best\">{}</td>", (column.write)(v))
                }
                Some(v) => format!("<td>{}</td>", (column.write)(v)),
            })
            .collect();
        let formation = m.all.lr_formation.as_deref().unwrap_or("–");
        let jitter = if m.all.lr_jitter { ", jittered" } else { "" };
        // Writing to a string does not fail.
        let _ = write!(
            body,
            "<tr><td>{}{}</td><td>{formation}{jitter}</td>{cells}</tr>",
            dot(m.index),
            escape(m.name)
        );
    }
    let p = &results.protocol;
    let warping = by_frames_between(p, |facts| facts.warping_error.map(|v| format!("{v:.2e}")));
    let edge_share = p.truth.first().and_then(|facts| facts.edge_share);
    format!(
        "<div class=\"card\"><table><thead><tr><th>Method</th><th>LR frames</th>{titles}</tr></thead><tbody>{body}</tbody></table></div>\
         <p class=\"soft\">Rendered: frames at rendered poses. Between: frames interpolated between them. All: every frame that the \
         method displays; the columns from SSIM on are over all. The ground truth's own warping error is {warping}. \
         Edge PSNR looks at {} of the pixels, near depth discontinuities; block p99 is the \
         99th percentile of the RMSE of 8×8 blocks, of 255. Bold: the best but native.</p>",
        edge_share.map_or_else(|| "–".into(), |v| format!("{:.1} %", 100.0 * v)),
    )
}

fn dot(method: usize) -> String {
    format!("<i class=\"dot\" style=\"background:{}\"></i>", color(method))
}

fn speed_plot(results: &Results) -> String {
    let series: Vec<Series> = (rows(results).iter())
        .filter(|m| m.name != "native")
        .filter_map(|m| {
            let points = vec![(m.all.displayed_fps?, m.all.psnr)];
            Some(Series { method: m.index, name: escape(m.name), points })
        })
        .collect();
    let axes = Axes {
        x: "displayed frames per second (logarithmic)",
        y: "PSNR of all frames, dB",
        log_x: true,
        scatter: true,
    };
    format!("<div class=\"card\" style=\"margin-top:12px\">{}</div>", plot(&axes, &series))
}

fn curves(results: &Results) -> String {
    // Native rendering is perfect; its line would only press the others together.
    let contenders = || results.scores.iter().enumerate().filter(|(_, (name, _))| name != "native");
    let legend: String = contenders()
        .map(|(i, (name, _))| {
            format!(
                "<label><input type=\"checkbox\" value=\"{i}\" checked> {}{}</label>",
                dot(i),
                escape(name)
            )
        })
        .collect();
    type Value = fn(&FrameScore) -> Option<f64>;
    let values: [(&str, Value); 5] = [
        ("PSNR, dB", |f| Some(f.psnr)),
        ("SSIM", |f| Some(f.ssim)),
        ("FLIP", |f| Some(f.flip)),
        ("edge PSNR, dB", |f| f.edge_psnr),
        ("block p99, of 255", |f| Some(f.block_rmse_p99)),
    ];
    let plots: String = (values.iter())
        .map(|(name, value)| {
            let series: Vec<Series> = contenders()
                .map(|(method, (name, score))| {
                    let first = results.protocol.frames[0] as f64;
                    let points = (score.frames.iter())
                        .filter_map(|f| Some((first + f.moment.time(), value(f)?)))
                        .collect();
                    Series { method, name: escape(name), points }
                })
                .collect();
            plot(&Axes { x: "frame of the path", y: name, log_x: false, scatter: false }, &series)
        })
        .collect();
    format!("<div class=\"card curves\"><div class=\"legend\">{legend}</div>{plots}</div>")
}

/// The details, for the script: `{frame: {method: PNG}}`.
fn details(results: &Results) -> String {
    let mut crops: BTreeMap<String, BTreeMap<&str, String>> = BTreeMap::new();
    for (name, score) in &results.scores {
        for (moment, crop) in &score.crops {
            let kind = if moment.is_rendered() { "rendered" } else { "between" };
            let frame = short(results.protocol.frames[0] as f64 + moment.time());
            let crops = crops.entry(format!("{kind} (frame {frame})")).or_default();
            crops.entry("ground truth").or_insert_with(|| base64(&crop.truth_png));
            if name != "native" {
                crops.insert(name, base64(&crop.png));
            }
        }
    }
    // Rendered frames first: they have all methods.
    comparison(&crops, crops.keys().rev(), ["bicubic", "analytic"])
}

/// Two of the details `{frame: {method: PNG in base 64}}` side by side, for the script, `shown` at first. No name holds
/// `<`.
pub(super) fn comparison<'a>(
    crops: &BTreeMap<String, BTreeMap<&str, String>>,
    frames: impl Iterator<Item = &'a String>,
    shown: [&str; 2],
) -> String {
    let frames: String = frames.map(|key| format!("<option>{}</option>", escape(key))).collect();
    // `<` cannot end the script element early in base 64 and method names.
    let Ok(json) = serde_json::to_string(crops) else { return String::new() };
    format!(
        "<div class=\"card\"><div class=\"bar\"><label>Frame <select id=\"frame\">{frames}</select></label>\
         <label>Left <select id=\"left\"></select></label><label>Right <select id=\"right\"></select></label></div>\
         <div class=\"compare\" data-left=\"{}\" data-right=\"{}\"><img alt=\"right\"><img alt=\"left\">\
         <div class=\"edge\"></div><span class=\"left\"></span><span class=\"right\"></span></div>\
         <p class=\"soft\">The part of the frame with most detail, enlarged without smoothing. Move the pointer to slide.</p></div>\
         <script type=\"application/json\" id=\"crops\">{json}</script>",
        shown[0], shown[1]
    )
}

fn stages(results: &Results) -> String {
    let cell = |stage: Option<StageStatistics>| {
        let (median, p99) = (stage.map(|s| s.median_ms), stage.map(|s| s.p99_ms));
        format!("<td>{}</td><td class=\"soft\">{}</td>", number(median, 1), number(p99, 1))
    };
    let body: String = (rows(results).iter())
        .map(|m| {
            let cells: String =
                [m.all.rasterize, m.all.super_sample, m.all.refine, m.all.interpolate, m.all.total]
                    .map(cell)
                    .concat();
            format!("<tr><td>{}{}</td>{cells}</tr>", dot(m.index), escape(m.name))
        })
        .collect();
    let titles: String = ["Rasterize", "Super sample", "Refine", "Interpolate", "All"]
        .map(|t| format!("<th>{t}<br>median</th><th>99 %</th>"))
        .concat();
    format!(
        "<div class=\"card\"><table><thead><tr><th>Method</th>{titles}</tr></thead><tbody>{body}</tbody></table></div>\
         <p class=\"soft\">Milliseconds per rendered frame.</p>"
    )
}

fn method_notes(results: &Results) -> String {
    let p = &results.protocol;
    let items: String = p.conventions.iter().map(|c| format!("<li>{}</li>", escape(c))).collect();
    format!(
        "<div class=\"card\"><p>Ground truth: {}.</p><ul>{items}</ul><p>{} rendered frames; {} rendered frames to warm up; \
         tile culling {}; background {:?}; {}, {} cores.</p>\
         <p>Command: <code>{}</code></p></div>",
        escape(&p.ground_truth),
        p.rendered_frames,
        p.warm_up_frames,
        escape(&p.culling),
        p.background,
        escape(&p.machine.system),
        p.machine.cores,
        escape(&p.command),
    )
}

/// Text as HTML.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
