//! The machine that figures belong to.

use serde::{Deserialize, Serialize};

/// Processor, threads and system.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MachineReport {
    /// Model name of the processor, where the system tells.
    pub processor: String,
    /// Vector instructions used.
    pub simd: String,
    /// Processors available.
    pub cores: usize,
    /// Threads used.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
}

impl MachineReport {
    /// This machine.
    #[must_use]
    pub fn this() -> Self {
        Self {
            processor: processor().unwrap_or_else(|| "unknown".into()),
            simd: gs3_simd::name(gs3_simd::level()).to_owned(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads: rayon::current_num_threads(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

/// The model name that Linux reports.
fn processor() -> Option<String> {
    let info = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = info.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}
