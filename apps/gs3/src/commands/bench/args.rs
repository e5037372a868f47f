//! Arguments of `gs3 bench`.

use std::path::PathBuf;

use clap::ValueEnum;
use gs3::Backend;

use crate::cli::options::{FrameOptions, SceneOptions, View};
use crate::cli::values::FrameRange;

#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Frames of the path, the last one excluded [default: the first 20]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    #[command(flatten)]
    pub frame_options: FrameOptions,
    /// What is measured: `cpu` displayed frames per second on the CPU, against native rendering, in rounds; `gpu` displayed
    /// frames per second on a GPU, also native ones, and all stages by the device's clock
    #[arg(long, default_value = "cpu", value_name = "cpu|gpu")]
    pub backend: BenchBackendArg,
    /// A GPU by its number [default: the fastest]
    #[arg(long, value_name = "N")]
    pub adapter: Option<usize>,
    /// Copies of the scene, side by side: what a larger scene would take
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub copies: u32,
    /// Frames rendered before the measured ones with `--backend gpu`
    #[arg(long, default_value_t = 30, value_name = "N")]
    pub warm_up: usize,
    /// Also measure the stages of the CPU rasterizer
    #[arg(long)]
    pub stages: bool,
    /// Write the figures
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BenchBackendArg {
    Cpu,
    Gpu,
}

impl From<BenchBackendArg> for Backend {
    fn from(backend: BenchBackendArg) -> Self {
        match backend {
            BenchBackendArg::Cpu => Self::Cpu,
            BenchBackendArg::Gpu => Self::Gpu,
        }
    }
}
