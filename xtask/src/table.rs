//! A report as Markdown.

use std::fmt::Write;

use serde_json::Value;

/// Stages of a frame in their order, then all together; see `gs3 bench --backend gpu`. Super sampling and
/// interpolation have parts, named after a dot, which the report in JSON lists one by one.
const STAGES: [&str; 9] =
    ["project", "order", "bin", "blend", "super_sample", "refine", "blocks", "interpolate", "all"];

/// The report that `measure` makes.
pub fn markdown(report: &Value) -> String {
    let runs = || report["runs"].as_array().into_iter().flatten();
    let mut text = format!(
        "# gs3 on a GPU\n\nMeasured in {} s on adapter {}. Times by the device's clock, median / 99th percentile in ms; fps of displayed \
         frames that follow each other.\n\n```json\n{:#}\n```\n",
        report["seconds"], report["adapter"]["number"], report["devices"],
    );
    // Writing to a string does not fail.
    let _ = write!(text, "\n| scene | Gaussians | size | frame | {} | fps |\n|", STAGES.join(" | "));
    text.push_str(&"---|".repeat(5 + STAGES.len()));
    text.push('\n');
    for run in runs().filter(|run| run["error"].is_null()) {
        for frame in
            ["native", "lr_gbuffer", "super_sample", "full"].into_iter().filter(|f| run[f].is_object())
        {
            let [scene, gaussians] = [&run["scene"], &run["gaussians"]].map(plain);
            let cells = STAGES.map(|stage| cell(&run[frame]["stages"], stage)).join(" | ");
            let fps = run[frame]["fps"].as_f64().unwrap_or(f64::NAN);
            let scale = run["scale"].as_u64().map_or_else(String::new, |scale| format!(", ×{scale}"));
            let size = format!("{}×{}{scale}", run["size"][0], run["size"][1]);
            let networks = networks(run);
            let _ =
                writeln!(text, "| {scene} | {gaussians} | {size} | {frame}{networks} | {cells} | {fps:.1} |");
        }
    }
    // Neither has to do with scenes; every run measured both once more.
    if let Some(ceilings) = runs().map(|run| &run["ceilings"]).find(|ceilings| ceilings.is_object()) {
        let [copy, f32, f16] =
            ["copy_gb_per_s", "f32_tflop_per_s", "f16_tflop_per_s"].map(|key| &ceilings[key]);
        // Not every adapter has it.
        let f16 = f16.as_f64().map_or_else(|| "none".to_owned(), |rate| format!("{rate:.2} TFLOP/s"));
        let [copy, f32] = [copy, f32].map(number);
        let _ = writeln!(text, "\nCeilings: copies {copy:.1} GB/s, f32 {f32:.2} TFLOP/s, f16 {f16}");
    }
    if let Some(sort) = runs().map(|run| &run["sort"]).find(|sort| sort.is_object()) {
        let rate = sort["keys_per_s"].as_f64().unwrap_or(f64::NAN) / 1e6;
        let [pairs, bits] = [&sort["pairs"], &sort["key_bits"]];
        let _ = writeln!(
            text,
            "\nSort of {pairs} pairs by {bits} bits: {rate:.1} million keys/s, {} ms",
            times(sort)
        );
    }
    for run in runs().filter(|run| run["error"].is_string()) {
        let [copies, scene, size, error] = ["copies", "scene", "size", "error"].map(|key| plain(&run[key]));
        let _ = writeln!(text, "\n{copies} × {scene} at {size}{} failed: {error}", networks(run));
    }
    text
}

/// Distinguishes runs with networks from those without.
fn networks(run: &Value) -> &str {
    run["networks"].as_str().unwrap_or_default()
}

/// The parts of `stage` added up: of percentiles, at least their whole.
fn cell(stages: &Value, stage: &str) -> String {
    let is_part = |times: &&Value| plain(&times["stage"]).split('.').next() == Some(stage);
    let parts: Vec<&Value> = stages.as_array().into_iter().flatten().filter(is_part).collect();
    if parts.is_empty() {
        return "–".to_owned();
    }
    let sum = |key: &str| parts.iter().map(|times| number(&times[key])).sum();
    milliseconds(sum("median_ms"), sum("p99_ms"))
}

fn times(times: &Value) -> String {
    milliseconds(number(&times["median_ms"]), number(&times["p99_ms"]))
}

fn milliseconds(median: f64, p99: f64) -> String {
    format!("{median:.3} / {p99:.3}")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn runs_sorts_and_failures_are_told() {
        let stage = |name: &str, ms: f64| json!({ "stage": name, "median_ms": ms, "p99_ms": 2.0 * ms });
        let side = |fps: f64| json!({ "fps": fps, "stages": [stage("project", 0.5), stage("blend", 1.25), stage("all", 1.75)] });
        let report = json!({
            "devices": { "adapters": ["fast"] },
            "adapter": { "number": 0 },
            "seconds": 12,
            "runs": [
                {
                    "scene": "scenes/garden", "gaussians": 3000, "size": [640, 360], "scale": 6,
                    "native": side(10.0), "lr_gbuffer": side(99.96),
                    "full": { "fps": 500.0, "stages": [
                        stage("super_sample.splat", 0.5), stage("super_sample.tile", 0.25),
                        stage("refine.select", 0.25), stage("blocks", 0.125), stage("interpolate.warp", 1.0),
                    ] },
                    "sort": { "pairs": 1024, "key_bits": 32, "keys_per_s": 2.5e9, "median_ms": 1.0, "p99_ms": 3.0 },
                },
                {
                    "scene": "demo", "gaussians": 5, "size": [64, 36], "networks": ", tier balanced", "full": side(20.0),
                    "ceilings": { "copy_gb_per_s": 2345.67, "f32_tflop_per_s": 51.234, "f16_tflop_per_s": 102.5 },
                },
                { "scene": "demo", "size": "9x9", "copies": "3", "networks": "", "error": "error: lost" },
                { "scene": "demo", "size": "9x9", "copies": "1", "networks": ", tier balanced", "error": "killed" },
            ],
        });
        let text = markdown(&report);
        let native = "| scenes/garden | 3000 | 640×360, ×6 | native | 0.500 / 1.000 | – | – | 1.250 / 2.500 | – | – | – | – | \
                      1.750 / 3.500 | 10.0 |\n";
        for expected in [
            "Measured in 12 s on adapter 0.",
            "```json\n{\n  \"adapters\": [\n    \"fast\"\n  ]\n}\n```\n",
            "| project | order | bin | blend | super_sample | refine | blocks | interpolate | all | fps |\n|---|---|---|---|---|",
            native,
            "| full | – | – | – | – | 0.750 / 1.500 | 0.250 / 0.500 | 0.125 / 0.250 | 1.000 / 2.000 | – | 500.0 |\n",
            "| lr_gbuffer | 0.500",
            "| 100.0 |\n",
            "\nSort of 1024 pairs by 32 bits: 2500.0 million keys/s, 1.000 / 3.000 ms\n",
            "| demo | 5 | 64×36 | full, tier balanced | 0.500",
            "\nCeilings: copies 2345.7 GB/s, f32 51.23 TFLOP/s, f16 102.50 TFLOP/s\n",
            "\n3 × demo at 9x9 failed: error: lost\n",
            "\n1 × demo at 9x9, tier balanced failed: killed\n",
        ] {
            assert!(text.contains(expected), "{expected}\n---\n{text}");
        }
    }
    #[test]
    fn ceilings_are_told_where_they_were_measured_with_or_without_half_precision() {
        let text = |run: Value| markdown(&json!({ "runs": [{ "scene": "demo" }, run] }));
        let ceilings = json!({ "copy_gb_per_s": 10.0, "f32_tflop_per_s": 0.25, "f16_tflop_per_s": null });
        let told = text(json!({ "ceilings": ceilings }));
        assert!(told.contains("\nCeilings: copies 10.0 GB/s, f32 0.25 TFLOP/s, f16 none\n"), "{told}");
        assert!(!text(json!({})).contains("Ceilings"));
    }
}
