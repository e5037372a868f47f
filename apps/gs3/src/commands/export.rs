//! `gs3 export`.

use std::io::Write;
use std::path::PathBuf;

use gs3::neural::model::graph_of;
use gs3::neural::onnx;

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::io::destination::{self, Destination};
use crate::io::inputs;
use crate::io::output::write_file;

#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// Weights of super sampling or of interpolation
    #[arg(value_name = "WEIGHTS.safetensors")]
    pub weights: PathBuf,
    /// Network with its weights, for ONNX Runtime, TensorRT and others
    #[arg(long, value_name = "FILE.onnx")]
    pub out: PathBuf,
}

pub fn run(args: &ExportArgs) -> Result<Outcome, CliError> {
    destination::check(&[Destination::file("--out", &args.out, "onnx")], [args.weights.as_path()])?;
    let error = |source| CliError::Weights { path: args.weights.clone(), source };
    let weights = inputs::weights_in(&args.weights)?;
    let graph = graph_of(&weights.header).map_err(|e| error(e.into()))?;
    let bytes = onnx::export(&graph, &weights).map_err(|e| error(e.into()))?;
    write_file(&args.out, |writer| writer.write_all(&bytes))?;
    Ok(Outcome::Done)
}
