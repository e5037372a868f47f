//! `gs3 evaluate` as its users run it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn evaluate(out: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gs3"))
        .args(["evaluate", "demo", "--size", "96x64", "--frames", "0..3", "--warm-up", "0", "--out"])
        .arg(out)
        .args(arguments)
        .output()
        .unwrap()
}

/// A folder in a folder, by a name that is no text where there are such names.
fn deep() -> PathBuf {
    #[cfg(unix)]
    let name = std::os::unix::ffi::OsStrExt::from_bytes(b"de\xffp");
    #[cfg(not(unix))]
    let name = OsStr::new("deep");
    Path::new::<OsStr>(name).join("out")
}

#[test]
fn a_report_is_written_and_a_second_run_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join(deep());
    let weights = folder.path().join("weights");
    std::fs::create_dir(&weights).unwrap();
    std::fs::write(weights.join("span28_x4.safetensors"), "no weights").unwrap();
    let first =
        evaluate(&out, &["--methods", "bicubic,analytic,span", "--weights", weights.to_str().unwrap()]);
    // Weights that are damaged fail their method alone, but not in silence.
    let said = String::from_utf8_lossy(&first.stderr);
    assert_eq!(first.status.code(), Some(2), "{said}");
    let file = weights.join("span28_x4.safetensors");
    let expected = format!("error: span: {}: expected safetensors", file.display());
    assert!(said.starts_with(&expected) && said.matches("span:").count() == 1, "{said}");
    let results = || -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(out.join("results.json")).unwrap()).unwrap()
    };
    let rows = results()["results"].as_array().unwrap().clone();
    let names: Vec<String> =
        rows.iter().map(|r| format!("{} {}", r["method"], r["subset"]).replace('"', "")).collect();
    let expected = [
        "native super_sampled",
        "native all",
        "bicubic super_sampled",
        "bicubic all",
        "analytic super_sampled",
        "analytic interpolated",
        "analytic all",
    ];
    assert_eq!(names, expected);
    assert!(rows.iter().all(|r| r["psnr"].as_f64().unwrap() > 10.0 && r["speedup_over_native"].is_number()));
    let failure = &results()["failures"][0];
    assert!(failure["method"] == "span", "{failure}");
    assert!(failure["error"].as_str().unwrap().contains("expected safetensors"), "{failure}");
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("<svg"));
    assert!(std::fs::read_to_string(out.join("table.md")).unwrap().contains("| analytic |"));

    assert!(evaluate(&out, &["--methods", "analytic,nearest"]).status.success());
    let again = results()["results"].as_array().unwrap().clone();
    let of = |rows: &[serde_json::Value], name: &str| rows.iter().find(|r| r["method"] == name).cloned();
    assert_eq!(of(&rows, "analytic"), of(&again, "analytic"), "timings and all come from the first run");
    assert!(of(&again, "nearest").is_some() && of(&again, "bicubic").is_none());
}

#[test]
fn bad_input_gets_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    for (arguments, message) in [
        (&["--methods", "bicubik"][..], "one of native"),
        (&["--size", "98x64"], "divisible by the scale 4"),
        (&["--frames", "0..2"], "at least 3 frames"),
        (&["--frames", "0..1000000"], "--frames: expected frames within 0..240"),
        (&["--scale", "1"], "scale: expected 2"),
        (&["--path", "nowhere.json"], "nowhere.json"),
        (&["--protocol", "paper", "--methods", "fsr1"], "--methods: expected none"),
        (&["--methods", "span", "--weights", empty.to_str().unwrap()], "span28_x4.safetensors, found none"),
        (
            &["--methods", "balanced", "--weights", "nowhere"],
            "weights: expected a folder, found none at nowhere",
        ),
        (&["--methods", "bicubic,span"], "span: expected a folder of weights, found none"),
        (
            &["--methods", "high", "--scale", "3", "--size=96x63"],
            "high: tier high at scale 3: expected one of",
        ),
        (&["--jod", "--protocol", "paper"], "--jod: expected none"),
        (&["--simplified", "demo"], "--simplified: expected --protocol paper"),
    ] {
        let arguments: Vec<&str> = ["evaluate", "demo", "--out", out.to_str().unwrap()]
            .into_iter()
            .chain((!arguments.iter().any(|a| a.starts_with("--size"))).then_some("--size=96x64"))
            .chain(arguments.iter().copied())
            .collect();
        let output = Command::new(env!("CARGO_BIN_EXE_gs3")).args(&arguments).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(message) && text.trim_end().lines().count() == 1, "{arguments:?}: {text}");
        assert!(!out.exists(), "{arguments:?} left something behind");
    }
}

#[test]
fn the_papers_tables_are_filled() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = evaluate(&out, &["--protocol", "paper", "--simplified", "demo"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let results: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("results.json")).unwrap()).unwrap();
    assert_eq!(results["failures"], serde_json::json!([]));
    let rows = results["results"].as_array().unwrap();
    let find = |table: &str, variant: &str, method: &str, subset: &str| {
        let is = |row: &&serde_json::Value, key: &str, value: &str| row[key] == value;
        let row = rows.iter().find(|row| {
            is(row, "table", table)
                && is(row, "variant", variant)
                && is(row, "method", method)
                && is(row, "subset", subset)
        });
        row.unwrap_or_else(|| panic!("{table} {variant} {method} {subset}"))["psnr"].as_f64().unwrap()
    };
    for variant in ["plain", "AdR", "SnugBox", "AccuTile", "AccuTile, simplified"] {
        for subset in ["super_sampled", "interpolated", "all"] {
            assert!(find("acceleration", variant, "analytic", subset) > 10.0);
        }
    }
    // Ground truth has no loss by culling, 3σ boxes do.
    assert!(find("acceleration", "SnugBox", "native", "all") > 90.0);
    let plain = find("acceleration", "plain", "native", "all");
    assert!(plain < 80.0, "{plain}");
    let without = |part: &str, method: &str| find("ablation", part, method, "super_sampled");
    let whole = without("nothing", "analytic");
    assert!(whole > without("history", "hermite+warp"));
    let gradientless = without("gradients", "history_gradientless+warp");
    assert!(whole != gradientless && gradientless > without("history and gradients", "bicubic+warp"));
    assert!(whole != without("jitter", "history_centered+warp"));
    let table = std::fs::read_to_string(out.join("table.md")).unwrap();
    for tier in ["fast", "balanced", "high"] {
        let is_there = rows.iter().any(|row| row["table"] == "comparison" && row["method"] == tier);
        assert!(is_there != table.contains(&format!("Absent: {tier}: ")), "{tier}");
    }
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("without jitter"));
}
