//! The machine that is measured: `gs3` as it runs there, and the adapter.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::time::Duration;

use serde_json::Value;

use crate::XtaskError;
use crate::child::{self, Ended};
use crate::devices::{Adapter, Devices};
use crate::environment::{self, Environment};

/// What tells the adapters.
const COMMAND: &str = "gs3 devices --json";

/// What is measured, and with what.
#[derive(Debug)]
pub struct Machine {
    /// The program.
    pub gs3: Gs3,
    /// What it finds.
    pub devices: Value,
    /// The one to measure.
    pub adapter: Adapter,
}

impl Machine {
    /// Finds the adapter to measure, the one `asked` for or the fastest. Where there is none, NVIDIA's driver may want
    /// of X11 what the machine does not have: it is tried once more by its library for EGL.
    pub fn find(folder: &Path, asked: Option<usize>, limit: Duration) -> Result<Self, XtaskError> {
        let environment = environment::of(Path::new("/"), folder, |name| std::env::var_os(name));
        let egl = environment::with_egl(&environment, folder);
        let with = |environment| {
            let gs3 = Gs3 { folder: folder.to_path_buf(), environment };
            let (devices, complaints) = gs3.devices(limit)?;
            let adapters: Devices =
                serde_json::from_value(devices.clone()).map_err(XtaskError::json(Path::new(COMMAND)))?;
            match adapters.chosen(asked).cloned() {
                Ok(adapter) => Ok(Self { gs3, devices, adapter }),
                Err(error) => {
                    eprint!("{complaints}");
                    Err(error)
                }
            }
        };
        with(environment).or_else(|error| with(egl).map_err(|_| error))
    }
}

/// The program in the carried folder.
#[derive(Debug)]
pub struct Gs3 {
    /// An absolute path.
    pub folder: PathBuf,
    /// The environment variables that describe the machine.
    pub environment: Environment,
}

impl Gs3 {
    /// Runs it in its folder.
    pub fn run(&self, arguments: &[impl AsRef<OsStr>], limit: Duration) -> Result<Ended, XtaskError> {
        let program = self.folder.join("gs3");
        let mut command = Command::new(&program);
        command.args(arguments).current_dir(&self.folder).envs(&self.environment);
        child::run(&mut command, limit).map_err(XtaskError::io(&program))
    }

    /// The adapters, and what Vulkan's loader says of drivers that it leaves out.
    fn devices(&self, limit: Duration) -> Result<(Value, String), XtaskError> {
        let said = self.run(&["devices", "--json"], limit)?;
        match said.status {
            Some(status) if status.success() => {
                // It says the same for every instance.
                let mut seen = HashSet::new();
                let complaints =
                    said.stderr.lines().filter(|line| seen.insert(*line)).map(|line| format!("{line}\n"));
                let devices = serde_json::from_str(&said.stdout);
                Ok((devices.map_err(XtaskError::json(Path::new(COMMAND)))?, complaints.collect()))
            }
            status => Err(XtaskError::Failed {
                command: COMMAND.to_owned(),
                status: format!("{}: {}", told(status, limit), child::reason(&said.stderr)),
            }),
        }
    }
}

/// How a program ended that was given `limit`.
pub fn told(status: Option<ExitStatus>, limit: Duration) -> String {
    status.map_or_else(|| format!("killed after {} s", limit.as_secs()), |status| status.to_string())
}
