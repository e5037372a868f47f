//! One run of `gs3 bench --backend gpu`, or why there are no figures of it.

use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use crate::XtaskError;
use crate::child;
use crate::folder::Subject;
use crate::machine::{Machine, told};

/// Where `gs3 bench` leaves its figures, in the carried folder.
const FIGURES: &str = "figures.json";

/// The networks that improve the frames of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Networks {
    /// None, the default of `gs3`.
    None,
    /// Those of tier balanced.
    Balanced,
    /// The same, by products of matrices in hardware.
    BalancedByMatrixProducts,
}

impl Networks {
    /// For people, in the report.
    pub const fn label(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Balanced => ", tier balanced",
            Self::BalancedByMatrixProducts => ", tier balanced by matrix products",
        }
    }

    /// Options of `gs3 bench`.
    const fn options(self) -> &'static [&'static str] {
        match self {
            Self::None => &["--tier", "analytic"],
            Self::Balanced => &["--tier", "balanced"],
            Self::BalancedByMatrixProducts => &["--tier", "balanced", "--matrix-products"],
        }
    }
}

/// What is measured at once.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// The scene with its cameras.
    pub subject: &'a Subject,
    /// Of native frames, as `WxH`.
    pub size: &'a str,
    /// Of the scene, side by side.
    pub copies: &'a str,
    /// Which networks frames go through.
    pub networks: Networks,
    /// Of the scene's cameras, as `A..B`.
    pub frames: &'a str,
    /// How many frames come before the measured ones.
    pub warm_up: &'a str,
}

impl Run<'_> {
    /// What is measured, for people.
    pub fn title(&self) -> String {
        let Self { subject, size, copies, networks, .. } = self;
        format!("{copies} × {} at {size}{}", subject.scene.display(), networks.label())
    }

    /// The figures that `gs3 bench` gives within `limit`, or how it ended and what it said.
    pub fn figures(&self, machine: &Machine, limit: Duration) -> Result<Value, XtaskError> {
        if limit.is_zero() {
            let error = "not begun: no time is left (--limit SECONDS gives each run its own)";
            return Ok(self.failure(error, "not begun", ""));
        }
        let said = machine.gs3.run(&self.arguments(&machine.adapter.number.to_string()), limit)?;
        let status = told(said.status, limit);
        match said.status {
            Some(it) if it.success() => {
                let file = machine.gs3.folder.join(FIGURES);
                let text = fs::read_to_string(&file).map_err(XtaskError::io(&file))?;
                fs::remove_file(&file).map_err(XtaskError::io(&file))?;
                let mut figures: Value = serde_json::from_str(&text).map_err(XtaskError::json(&file))?;
                figures["networks"] = self.networks.label().into();
                Ok(figures)
            }
            Some(it) => {
                let reason = child::reason(&said.stderr);
                // A program that a signal ends had no chance to say why.
                let error = if it.code().is_none() { format!("{status}: {reason}") } else { reason };
                Ok(self.failure(&error, &status, &said.stderr))
            }
            None => Ok(self.failure(&format!("{status} (--limit SECONDS)"), &status, &said.stderr)),
        }
    }

    fn arguments(&self, adapter: &str) -> Vec<String> {
        let Self { subject, size, copies, networks, frames, warm_up } = *self;
        let scene = subject.scene.to_string_lossy();
        let mut arguments =
            vec!["bench", &scene, "--backend", "gpu", "--adapter", adapter, "--json", FIGURES];
        arguments.extend(["--size", size, "--copies", copies, "--frames", frames, "--warm-up", warm_up]);
        let cameras = subject.cameras.as_ref().map(|cameras| cameras.to_string_lossy());
        arguments.extend(cameras.iter().flat_map(|cameras| ["--path", cameras]));
        arguments.extend(networks.options());
        arguments.into_iter().map(str::to_owned).collect()
    }

    fn failure(&self, error: &str, status: &str, stderr: &str) -> Value {
        let Self { subject, size, copies, networks, .. } = self;
        json!({
            "scene": subject.scene.to_string_lossy(), "size": size, "copies": copies, "networks": networks.label(),
            "error": error, "status": status, "stderr": stderr,
        })
    }
}
