//! `xtask measure`: what run.sh does on the machine that is measured.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Instant;

use serde_json::{Value, json};

use crate::XtaskError;
use crate::folder::{SUBJECTS, Subject};
use crate::table;

/// Arguments of `measure`. The defaults take a few minutes on a GPU.
#[derive(Debug, clap::Args)]
pub struct MeasureArgs {
    /// Sizes of native frames; low-resolution G-buffers have a quarter of their width and height
    #[arg(long = "size", value_name = "WxH", default_values = ["1920x1080", "4096x2160"])]
    pub sizes: Vec<String>,
    /// Copies of each scene, side by side
    #[arg(long = "copies", value_name = "N", default_values = ["1", "3"])]
    pub copies: Vec<String>,
    /// Frames of each scene's cameras
    #[arg(long, value_name = "A..B", default_value = "0..200")]
    pub frames: String,
    /// Frames before the measured ones
    #[arg(long, value_name = "N", default_value = "30")]
    pub warm_up: String,
    /// A GPU by its number [default: the fastest]
    #[arg(long, value_name = "N")]
    pub adapter: Option<String>,
    /// Networks by products of matrices in hardware
    #[arg(long)]
    pub matrix_products: bool,
}

/// Measures all subjects at all sizes. The report is written after each, so that whatever happens the figures so far stay.
pub fn run(args: &MeasureArgs) -> Result<(), XtaskError> {
    let list = Path::new(SUBJECTS);
    let text = fs::read_to_string(list).map_err(XtaskError::io(list))?;
    let subjects: Vec<Subject> = serde_json::from_str(&text).map_err(XtaskError::json(list))?;
    let started = Instant::now();
    let devices = gs3(&["devices"])?;
    let mut report = json!({ "devices": String::from_utf8_lossy(&devices.stdout), "runs": [] });
    let mut runs = Vec::new();
    for subject in &subjects {
        for (size, copies) in args.sizes.iter().flat_map(|size| args.copies.iter().map(move |n| (size, n))) {
            eprintln!("{copies} × {} at {size}", subject.scene.display());
            runs.push(measured(subject, size, copies, args)?);
            report["runs"] = json!(runs);
            report["seconds"] = json!(started.elapsed().as_secs());
            write("report.json", &format!("{report:#}\n"))?;
            write("report.md", &table::markdown(&report))?;
        }
    }
    let failed = runs.iter().filter(|run| run["error"].is_string()).count();
    match failed {
        0 => Ok(()),
        _ => Err(XtaskError::Incomplete { failed, all: runs.len() }),
    }
}

/// The figures of `gs3 bench`, or what it said when it failed.
fn measured(subject: &Subject, size: &str, copies: &str, args: &MeasureArgs) -> Result<Value, XtaskError> {
    const FIGURES: &str = "figures.json";
    let scene = subject.scene.to_string_lossy();
    let cameras = subject.cameras.as_ref().map(|cameras| cameras.to_string_lossy());
    let mut arguments = vec!["bench", &scene, "--backend", "gpu", "--size", size, "--json", FIGURES];
    arguments.extend(["--copies", copies]);
    arguments.extend(["--frames", &args.frames, "--warm-up", &args.warm_up]);
    arguments.extend(cameras.iter().flat_map(|cameras| ["--path", cameras]));
    arguments.extend(args.adapter.iter().flat_map(|adapter| ["--adapter", adapter]));
    arguments.extend(args.matrix_products.then_some("--matrix-products"));
    let output = gs3(&arguments)?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let error = said.lines().next_back().unwrap_or("no message").to_owned();
        return Ok(json!({ "scene": scene, "size": size, "copies": copies, "error": error }));
    }
    let file = Path::new(FIGURES);
    let text = fs::read_to_string(file).map_err(XtaskError::io(file))?;
    fs::remove_file(file).map_err(XtaskError::io(file))?;
    serde_json::from_str(&text).map_err(XtaskError::json(file))
}

fn gs3(arguments: &[&str]) -> Result<Output, XtaskError> {
    let program = Path::new("./gs3");
    Command::new(program).args(arguments).output().map_err(XtaskError::io(program))
}

fn write(file: &str, text: &str) -> Result<(), XtaskError> {
    fs::write(file, text).map_err(XtaskError::io(Path::new(file)))
}
