//! `gs3 export`.

use std::io::Write;
use std::path::PathBuf;

use gs3::neural::model::graph_of;
use gs3::neural::{Weights, onnx};
use gs3::scene::format::write_atomically;

use crate::Outcome;
use crate::error::CliError;

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
    // Weights come as FILE.safetensors; without this, a slip of the pen replaces them.
    if args.out.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("onnx")) {
        return Err(CliError::Option {
            option: "--out",
            expected: "FILE.onnx".to_owned(),
            actual: args.out.display().to_string(),
        });
    }
    let error = |source| CliError::Weights { path: args.weights.clone(), source };
    let weights = Weights::load(&args.weights).map_err(|e| error(e.into()))?;
    let graph = graph_of(&weights.header).map_err(|e| error(e.into()))?;
    let bytes = onnx::export(&graph, &weights).map_err(|e| error(e.into()))?;
    write_atomically(&args.out, |writer| writer.write_all(&bytes)).map_err(CliError::write(&args.out))?;
    Ok(Outcome::Done)
}
