//! The commands: the arguments of each, and what each does. A command uses `cli` and `io`; neither of them knows a command.

mod bench;
mod convert;
mod devices;
mod evaluate;
mod export;
mod gbuffer;
mod info;
mod join;
mod render;
mod simplify;
mod train;
pub mod unused;
#[cfg(feature = "view")]
mod view;

use bench::BenchArgs;
use clap::{Parser, Subcommand};
use convert::ConvertArgs;
use devices::DevicesArgs;
use evaluate::EvaluateArgs;
use export::ExportArgs;
use gbuffer::GbufferArgs;
use gs3_train::Network;
use info::InfoArgs;
use join::JoinArgs;
use render::RenderArgs;
use simplify::SimplifyArgs;
use train::clips::ClipsArgs;
use train::{BaselineArgs, TrainArgs};

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;

/// What the command reads from its environment.
const ENVIRONMENT: &str = "Environment:
  GS3_SIMD  SIMD level of all CPU kernels: scalar, sse2, sse4.2, avx2, avx512 or neon [default: the best that the processor has]";

/// Shows trained 3D Gaussian Splatting scenes sharp and fluid.
#[derive(Debug, Parser)]
#[command(name = "gs3", version, about, after_help = ENVIRONMENT)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render frames or a video along a camera path
    Render(RenderArgs),
    /// Make a video of the frames that renders of parts of a path wrote
    Join(JoinArgs),
    /// Show a scene in a window
    #[cfg(feature = "view")]
    View(view::ViewArgs),
    /// Write one frame's G-buffer as NumPy arrays
    Gbuffer(GbufferArgs),
    /// Say what is in a scene
    Info(InfoArgs),
    /// Convert a scene to another format (.ply, .compressed.ply, .spz, .sog, .glb, .splat, streamed SOG)
    Convert(ConvertArgs),
    /// Measure displayed frames per second against native rendering
    Bench(BenchArgs),
    /// Judge quality and speed against native rendering and against other methods
    Evaluate(EvaluateArgs),
    /// Keep the Gaussians that matter most to given cameras
    Simplify(SimplifyArgs),
    /// List GPU adapters, what they can do, and which one is taken
    Devices(DevicesArgs),
    /// Train networks
    #[command(subcommand)]
    Train(Train),
    /// Write a network with its weights as an ONNX file
    Export(ExportArgs),
}

#[derive(Debug, Subcommand)]
pub enum Train {
    /// Render clips from scenes, to train and validate on
    Clips(ClipsArgs),
    /// Train the network from low to high resolution on clips
    SuperSample(TrainArgs),
    /// Train the network for in-between frames on clips
    Interpolate(TrainArgs),
    /// Train a published single-image network on the clips of super sampling, to compare with
    Baseline(BaselineArgs),
}

/// Runs `command`.
pub fn run(command: &Command) -> Result<Outcome, CliError> {
    match command {
        Command::Render(args) => render::run(args),
        Command::Join(args) => join::run(args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(args),
        Command::Gbuffer(args) => gbuffer::run(args),
        Command::Info(args) => info::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Simplify(args) => simplify::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Train(Train::Clips(args)) => train::clips::run(args),
        Command::Train(Train::SuperSample(args)) => train::run(Network::SuperSample, args),
        Command::Train(Train::Interpolate(args)) => train::run(Network::Interpolate, args),
        Command::Train(Train::Baseline(args)) => train::run_baseline(args),
        Command::Export(args) => export::run(args),
    }
}
