//! Measurements without a GPU: tests/stub/gs3 plays the program.
#![cfg(unix)]

use std::os::unix::fs::symlink;

use serde_json::Value;

use super::*;

const STUB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/stub/gs3");
const SOFTWARE: &str = r#"{"adapters": [{"number": 0, "name": "llvmpipe", "kind": "software", "is_taken": true,
    "takes_matrix_products": false}]}"#;
const CARD: &str = r#"{"adapters": [{"number": 0, "name": "card", "kind": "discrete GPU", "is_taken": true,
    "takes_matrix_products": true}]}"#;
const NONE: &str = r#"{"adapters": []}"#;

/// A folder as `gpu-report` makes it, on a machine with `devices`.
fn folder(devices: &str, scenes: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A link, since a program that was just written may still be open for it in a process that another test starts.
    symlink(STUB, at.join("gs3")).unwrap();
    let subjects: Vec<_> = scenes.iter().map(|scene| json!({ "scene": scene, "cameras": null })).collect();
    fs::write(at.join(SUBJECTS), json!(subjects).to_string()).unwrap();
    fs::write(at.join("devices.json"), devices).unwrap();
    folder
}

fn args() -> MeasureArgs {
    let [sizes, copies] = ["8x8", "1"].map(|it| vec![it.to_owned()]);
    MeasureArgs {
        sizes,
        copies,
        frames: "0..2".to_owned(),
        warm_up: "0".to_owned(),
        adapter: None,
        limit: Some(30),
    }
}

fn report(folder: &tempfile::TempDir) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.path().join("report.json")).unwrap()).unwrap()
}

#[test]
fn software_is_measured_only_for_who_asks() {
    let folder = folder(SOFTWARE, &["demo"]);
    let refused = measure(folder.path(), &args());
    assert!(
        matches!(&refused, Err(XtaskError::NoAdapter { actual, .. }) if actual == "0 llvmpipe (software)")
    );
    assert!(!folder.path().join("bench.txt").exists());
    measure(folder.path(), &MeasureArgs { adapter: Some(0), ..args() }).unwrap();
    let report = report(&folder);
    assert_eq!(report["adapter"]["name"], "llvmpipe");
    let networks: Vec<_> = report["runs"].as_array().unwrap().iter().map(|run| &run["networks"]).collect();
    assert_eq!(networks, ["", ", tier balanced"]);
}

#[test]
fn what_only_the_driver_for_egl_shows_is_measured_by_it() {
    for before in [SOFTWARE, NONE] {
        let folder = folder(before, &["demo"]);
        fs::write(folder.path().join("egl.json"), CARD).unwrap();
        measure(folder.path(), &args()).unwrap();
        let report = report(&folder);
        assert_eq!(report["adapter"]["name"], "card");
        let driver = folder.path().join("nvidia_egl.json");
        assert_eq!(report["environment"]["VK_DRIVER_FILES"], driver.to_str().unwrap());
    }
}

#[test]
fn an_adapter_with_matrix_products_is_measured_with_them_too() {
    let folder = folder(CARD, &["demo"]);
    measure(folder.path(), &MeasureArgs { sizes: vec!["8x8".into(), "9x9".into()], ..args() }).unwrap();
    let asked = fs::read_to_string(folder.path().join("bench.txt")).unwrap();
    let common = "bench demo --backend gpu --adapter 0 --json figures.json --size";
    let rest = "--copies 1 --frames 0..2 --warm-up 0";
    let lines = ["8x8", "9x9"].map(|size| {
        ["analytic", "balanced", "balanced --matrix-products"]
            .map(|tier| format!("{common} {size} {rest} --tier {tier}\n"))
    });
    assert_eq!(asked, lines.concat().concat());
    let report = report(&folder);
    assert_eq!(report["runs"].as_array().unwrap().len(), 6);
    let table = fs::read_to_string(folder.path().join("report.md")).unwrap();
    assert_eq!(table.matches("| full, tier balanced by matrix products |").count(), 2, "{table}");
}

#[test]
fn runs_that_fail_or_hang_leave_what_they_said_and_the_others_go_on() {
    let folder = folder(SOFTWARE, &["fails", "hangs", "demo", "crashes"]);
    let ended = measure(folder.path(), &MeasureArgs { adapter: Some(0), limit: Some(3), ..args() });
    assert!(matches!(ended, Err(XtaskError::Incomplete { failed: 6, all: 8 })), "{ended:?}");
    let report = report(&folder);
    // With networks and without.
    let [failed, hung, done, crashed] = [0, 2, 4, 6].map(|run| &report["runs"][run]);
    assert_eq!(failed["error"], "error: no room");
    assert_eq!(failed["status"], "exit status: 3");
    assert_eq!(failed["stderr"], "error: early\n\nerror: no room\nnote: after\n");
    assert_eq!(hung["error"], "killed after 3 s (--limit SECONDS)");
    assert_eq!((&hung["status"], &hung["stderr"]), (&json!("killed after 3 s"), &json!("began\n")));
    assert_eq!(done["full"]["fps"], 1.0);
    assert_eq!(crashed["error"], "signal: 9 (SIGKILL): no message");
}

#[test]
fn by_default_a_run_has_two_minutes_and_all_have_ten() {
    for (asked, spent, expected) in
        [(None, 0, 120), (None, 550, 50), (None, 601, 0), (Some(900), 0, 900), (Some(9), 700, 9)]
    {
        let limit = limit(asked, Duration::from_secs(spent));
        assert_eq!(limit, Duration::from_secs(expected), "{asked:?} after {spent}");
    }
    let folder = folder(SOFTWARE, &["demo"]);
    let machine = Machine::find(folder.path(), Some(0), Duration::from_secs(30)).unwrap();
    let subject = "demo".parse().unwrap();
    let run = Run {
        subject: &subject,
        size: "8x8",
        copies: "1",
        networks: Networks::None,
        frames: "0..2",
        warm_up: "0",
    };
    let late = run.figures(&machine, Duration::ZERO).unwrap();
    assert!(late["error"].as_str().unwrap().starts_with("not begun"), "{late}");
    assert!(!folder.path().join("bench.txt").exists());
}
