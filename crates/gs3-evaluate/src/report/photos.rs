//! Reports of comparisons with photos.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::base64;
use super::html::{comparison, escape, failed, page, section};
use crate::photos::PhotoResults;

/// The comparison as a Markdown table, one row per method.
#[must_use]
pub fn photos_markdown(results: &PhotoResults) -> String {
    let facts = &results.protocol;
    let mut text = format!(
        "{} ({} Gaussians) against {} of {} photos, ×{}\n\n| method | PSNR | SSIM | FLIP | PSNR on the way | SSIM | FLIP |\n\
         |---|--:|--:|--:|--:|--:|--:|\n",
        facts.scene, facts.gaussians, facts.judged, facts.photos, facts.scale
    );
    for row in &results.results {
        let [alone, way] = [row.mean, row.after_way]
            .map(|score| format!("{:.2} | {:.4} | {:.4}", score.psnr, score.ssim, score.flip));
        // Writing to a string does not fail.
        let _ = writeln!(text, "| {} | {alone} | {way} |", row.method);
    }
    let _ = writeln!(
        text,
        "\nOn the way: the photo is the last of {} frames on a short way to it.{}",
        facts.scale * facts.scale + 1,
        missing(&facts.missing)
    );
    for failure in &results.failures {
        let _ = writeln!(text, "\n{} failed: {}", failure.method, failure.error);
    }
    text
}

/// Says which photos have no file.
fn missing(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [first] => format!(" {first} of the capture has no file."),
        [first, ..] => format!(" {} photos of the capture have no file, {first} the first.", names.len()),
    }
}

/// The comparison as a self-contained page: means, every photo, details to compare.
#[must_use]
pub fn photos_html(results: &PhotoResults) -> String {
    let facts = &results.protocol;
    let header = format!(
        "<h1>gs3 evaluate</h1><p class=\"soft\">{} ({} Gaussians) against {} of {} photos, gs3 {}, {}.{}</p>",
        escape(&facts.scene),
        facts.gaussians,
        facts.judged,
        facts.photos,
        facts.version,
        escape(&facts.machine.processor),
        escape(&missing(&facts.missing)),
    );
    let notes: String = facts.conventions.iter().map(|c| format!("<li>{}</li>", escape(c))).collect();
    let notes = format!(
        "<div class=\"card\"><ul>{notes}</ul><p>Command: <code>{}</code></p></div>",
        escape(&facts.command)
    );
    page(
        &format!("{}, photos", facts.scene),
        &[
            header,
            failed(&results.failures),
            section("Quality", &means(results)),
            section("Look closer", &details(results)),
            section("Every photo", &images(results)),
            section("How this was measured", &notes),
        ],
    )
}

fn means(results: &PhotoResults) -> String {
    let rows: String = (results.results.iter())
        .map(|row| {
            let formation = row.lr_formation.as_deref().unwrap_or("–");
            let [alone, way] = [row.mean, row.after_way].map(|mean| {
                format!("<td>{:.2}</td><td>{:.4}</td><td>{:.4}</td>", mean.psnr, mean.ssim, mean.flip)
            });
            format!("<tr><td>{}</td><td>{formation}</td>{alone}{way}</tr>", escape(&row.method))
        })
        .collect();
    format!(
        "<div class=\"card\"><table><thead><tr><th>Method</th><th>LR frames</th><th>PSNR</th><th>SSIM</th><th>FLIP</th>\
         <th>PSNR<br>on the way</th><th>SSIM</th><th>FLIP</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )
}

/// PSNR, SSIM and FLIP of every photo, a row per photo.
fn images(results: &PhotoResults) -> String {
    let methods: String = results.results.iter().map(|r| format!("<th>{}</th>", escape(&r.method))).collect();
    let Some(first) = results.results.first() else { return String::new() };
    let rows: String = (first.images.iter().enumerate())
        .map(|(i, image)| {
            let cells: String = (results.results.iter().filter_map(|row| row.images.get(i)))
                .map(|image| {
                    let [alone, way] = [image.score, image.after_way].map(|s| {
                        format!("{:.2} <span class=\"soft\">{:.4} {:.4}</span>", s.psnr, s.ssim, s.flip)
                    });
                    format!("<td>{alone}<br>{way}</td>")
                })
                .collect();
            format!("<tr><td>{} ({}×{})</td>{cells}</tr>", escape(&image.name), image.size[0], image.size[1])
        })
        .collect();
    format!(
        "<div class=\"card\"><table><thead><tr><th>Photo</th>{methods}</tr></thead><tbody>{rows}</tbody></table></div>\
         <p class=\"soft\">PSNR, SSIM, FLIP: on its own, and on the way.</p>"
    )
}

fn details(results: &PhotoResults) -> String {
    let mut crops: BTreeMap<String, BTreeMap<&str, String>> = BTreeMap::new();
    for (method, photos) in &results.crops {
        for (name, crop) in photos {
            // Names are content here, and `</script>` in one would end the element.
            let crops = crops.entry(name.replace('<', "‹")).or_default();
            crops.entry("photo").or_insert_with(|| base64(&crop.truth_png));
            crops.insert(method, base64(&crop.png));
        }
    }
    comparison(&crops, crops.keys(), ["photo", "native"])
}
