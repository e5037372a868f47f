//! `xtask measure`: what run.sh does on the machine that is measured.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::XtaskError;
use crate::folder::{SUBJECTS, Subject};
use crate::machine::Machine;
use crate::run::{Networks, Run};
use crate::table;

/// All together by default: what somebody waits for, and less than most machines are lent for.
const ALL: Duration = Duration::from_secs(600);

/// One by default: a run takes seconds on a GPU, so that one of a fifth of [`ALL`] hangs, and the others still have
/// their time.
const ONE: Duration = Duration::from_secs(120);

/// Arguments of `measure`. The defaults take a few minutes on a GPU.
#[derive(Debug, clap::Args)]
pub struct MeasureArgs {
    /// Sizes of native frames; low-resolution G-buffers are 4 times smaller up to 2560x1440 pixels and with networks, 6 times above
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
    /// An adapter by its number, software too [default: the fastest in hardware]
    #[arg(long, value_name = "N")]
    pub adapter: Option<usize>,
    /// Time for each run, after which it is killed [default: 120, and ten minutes for all]
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    pub limit: Option<u64>,
}

/// Measures all subjects in this folder.
pub fn run(args: &MeasureArgs) -> Result<(), XtaskError> {
    let here = std::path::absolute(".").map_err(XtaskError::io(Path::new(".")))?;
    measure(&here, args)
}

/// Measures all subjects in `folder` at all sizes. The report is written after each subject, so that a failure keeps
/// the figures so far.
fn measure(folder: &Path, args: &MeasureArgs) -> Result<(), XtaskError> {
    let started = Instant::now();
    let list = folder.join(SUBJECTS);
    let text = fs::read_to_string(&list).map_err(XtaskError::io(&list))?;
    let subjects: Vec<Subject> = serde_json::from_str(&text).map_err(XtaskError::json(&list))?;
    let machine = Machine::find(folder, args.adapter, limit(args.limit, started.elapsed()))?;
    eprintln!("adapter {} of\n{:#}", machine.adapter.number, machine.devices);
    let environment = machine.gs3.environment.iter().map(|(name, value)| (*name, value.to_string_lossy()));
    let environment: BTreeMap<_, _> = environment.collect();
    let mut report = json!({
        "devices": machine.devices,
        "adapter": machine.adapter,
        "environment": environment,
        "runs": [],
    });
    let mut figures = Vec::new();
    for run in runs(&subjects, args, machine.adapter.matrix_products) {
        eprintln!("{}", run.title());
        figures.push(run.figures(&machine, limit(args.limit, started.elapsed()))?);
        report["runs"] = json!(figures);
        report["seconds"] = json!(started.elapsed().as_secs());
        write(&folder.join("report.json"), &format!("{report:#}\n"))?;
        write(&folder.join("report.md"), &table::markdown(&report))?;
    }
    let failed = figures.iter().filter(|run| run["error"].is_string()).count();
    match failed {
        0 => Ok(()),
        _ => Err(XtaskError::Incomplete { failed, all: figures.len() }),
    }
}

/// All that is measured, in the order of the report: each size without networks, then with them.
fn runs<'a>(subjects: &'a [Subject], args: &'a MeasureArgs, matrix_products: bool) -> Vec<Run<'a>> {
    let networks: &[Networks] = match matrix_products {
        true => &[Networks::None, Networks::Balanced, Networks::BalancedByMatrixProducts],
        false => &[Networks::None, Networks::Balanced],
    };
    let mut runs = Vec::new();
    for subject in subjects {
        for (size, copies) in args.sizes.iter().flat_map(|size| args.copies.iter().map(move |n| (size, n))) {
            let run = |networks: &Networks| Run {
                subject,
                size,
                copies,
                networks: *networks,
                frames: &args.frames,
                warm_up: &args.warm_up,
            };
            runs.extend(networks.iter().map(run));
        }
    }
    runs
}

/// The time of a run that begins after all before it have `spent` theirs; none, if there is no time left.
fn limit(asked: Option<u64>, spent: Duration) -> Duration {
    asked.map_or_else(|| ONE.min(ALL.saturating_sub(spent)), Duration::from_secs)
}

fn write(file: &Path, text: &str) -> Result<(), XtaskError> {
    fs::write(file, text).map_err(XtaskError::io(file))
}

#[cfg(test)]
mod tests;
