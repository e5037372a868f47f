//! Reports of the paper's tables.

use std::fmt::Write;

use super::html::{escape, failed, page, section};
use super::markdown::number;
use crate::protocol::{PaperResults, PaperRow, Subset, Table};

const TABLES: [(Table, &str); 3] = [
    (Table::Comparison, "Methods"),
    (Table::Acceleration, "Accelerations of rasterization"),
    (Table::Ablation, "Parts left out"),
];

const TITLES: [&str; 12] = [
    "row",
    "PSNR super-sampled",
    "SSIM",
    "FLIP",
    "PSNR interpolated",
    "SSIM",
    "FLIP",
    "PSNR all",
    "SSIM",
    "FLIP",
    "displayed FPS",
    "× plain native",
];

/// The tables in Markdown.
#[must_use]
pub fn paper_markdown(results: &PaperResults) -> String {
    let p = &results.protocol;
    let mut text = format!(
        "{} ({} Gaussians), {} frames {}..{}, {}×{}, ×{}, {} ({} threads)\n",
        p.scene,
        p.gaussians,
        p.path,
        p.frames[0],
        p.frames[1],
        p.size[0],
        p.size[1],
        p.scale,
        p.machine.processor,
        p.machine.threads,
    );
    // Writing to a string does not fail.
    for (table, title) in TABLES {
        let _ = writeln!(text, "\n### {title}\n\n| {} |\n|---{}|", TITLES.join(" | "), "|--:".repeat(11));
        for row in rows(results, table) {
            let _ = writeln!(text, "| {} |", row.join(" | "));
        }
        for absent in results.absent.iter().filter(|a| a.table == table) {
            let _ = writeln!(text, "\nAbsent: {}: {}.", absent.row, absent.reason);
        }
    }
    for failure in &results.failures {
        let _ = writeln!(text, "\n{} failed: {}", failure.method, failure.error);
    }
    text
}

/// The tables as a self-contained page.
#[must_use]
pub fn paper_html(results: &PaperResults) -> String {
    let p = &results.protocol;
    let header = format!(
        "<h1>gs3 evaluate</h1><p class=\"soft\">The tables of the 3DGS³ paper: {} ({} Gaussians), {} frames {}..{}, {}×{}, \
         ×{}; {}, {} threads; gs3 {}.</p>",
        escape(&p.scene),
        p.gaussians,
        escape(&p.path),
        p.frames[0],
        p.frames[1],
        p.size[0],
        p.size[1],
        p.scale,
        escape(&p.machine.processor),
        p.machine.threads,
        p.version,
    );
    let mut sections = vec![header, failed(&results.failures)];
    for (table, title) in TABLES {
        let titles: String = TITLES.iter().map(|t| format!("<th>{t}</th>")).collect();
        let body: String = (rows(results, table).iter())
            .map(|row| {
                let cells: String = row.iter().map(|cell| format!("<td>{}</td>", escape(cell))).collect();
                format!("<tr>{cells}</tr>")
            })
            .collect();
        let absent: String = (results.absent.iter().filter(|a| a.table == table))
            .map(|a| format!("<p class=\"soft\">Absent: {}: {}.</p>", escape(&a.row), escape(&a.reason)))
            .collect();
        let body = format!(
            "<div class=\"card\"><table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>{absent}"
        );
        sections.push(section(title, &body));
    }
    let notes: String = p.conventions.iter().map(|c| format!("<li>{}</li>", escape(c))).collect();
    let notes = format!(
        "<div class=\"card\"><p>Ground truth: {}.</p><ul>{notes}</ul><p>Command: <code>{}</code></p></div>",
        escape(&p.ground_truth),
        escape(&p.command)
    );
    sections.push(section("How this was measured", &notes));
    page(&format!("{}, {}, tables of the paper", p.scene, p.path), &sections)
}

/// The rows of one table as text, all subsets of a method in one.
fn rows(results: &PaperResults, table: Table) -> Vec<Vec<String>> {
    let of_table =
        |subset| results.results.iter().filter(move |r| r.table == table && r.row.subset == subset);
    of_table(Subset::All)
        .map(|all| {
            let same = |r: &&PaperRow| r.variant == all.variant && r.row.method == all.row.method;
            let name = match (table, all.variant.as_str()) {
                (_, "") => all.row.method.clone(),
                (Table::Ablation, "nothing") => format!("all of it ({})", all.row.method),
                (Table::Ablation, part) => format!("without {part} ({})", all.row.method),
                (_, variant) => format!("{variant}: {}", all.row.method),
            };
            let mut cells = vec![name];
            for subset in Subset::EACH {
                let row = of_table(subset).find(same).map(|r| &r.row);
                cells.push(number(row.map(|r| r.psnr), 2));
                cells.push(number(row.map(|r| r.ssim), 4));
                cells.push(number(row.map(|r| r.flip), 4));
            }
            cells.push(number(all.row.displayed_fps, 2));
            cells.push(number(all.speedup_over_plain, 2));
            cells
        })
        .collect()
}
