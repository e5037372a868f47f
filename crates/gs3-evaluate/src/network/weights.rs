//! Weights by name from safetensors files.

use std::path::{Path, PathBuf};

use gs3::neural::arrays::{Array, Arrays, MAX_BYTES};
use gs3::neural::{self, Graph, Header, Parameter, RunError};
use gs3_files::{ReadError, read_within};
use safetensors::{Dtype, SafeTensors};

use super::runner::Runner;

/// Why weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightError {
    /// The file cannot be read.
    #[error("{}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: ReadError,
    },
    /// It is not a safetensors file.
    #[error("{}: expected safetensors, found {message}", .path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What the reader says.
        message: String,
    },
    /// A tensor is missing.
    #[error("{}: expected a tensor '{name}', found none", .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
    },
    /// A tensor has another shape or type.
    #[error("{}: {name}: expected f32 {expected:?}, found {actual}", .path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// The shape expected.
        expected: Vec<usize>,
        /// Type and shape found.
        actual: String,
    },
    /// The engine refuses them.
    #[error("{}: {source}", .path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<RunError>,
    },
}

/// A weight file in memory.
#[derive(Debug)]
pub struct Weights {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Weights {
    /// Reads the file.
    ///
    /// # Errors
    /// [`WeightError`] if it cannot be read or is no safetensors file.
    pub fn load(path: &Path) -> Result<Self, WeightError> {
        let path = path.to_owned();
        let bytes = read_within(&path, MAX_BYTES)
            .map_err(|source| WeightError::Read { path: path.clone(), source })?;
        let weights = Self { path, bytes };
        weights.parse()?;
        Ok(weights)
    }

    fn parse(&self) -> Result<SafeTensors<'_>, WeightError> {
        SafeTensors::deserialize(&self.bytes)
            .map_err(|e| WeightError::Format { path: self.path.clone(), message: e.to_string() })
    }

    /// The values of tensor `name`, which must have this shape.
    pub(super) fn tensor(&self, name: &str, expected: &[usize]) -> Result<Vec<f32>, WeightError> {
        let (path, name) = (self.path.clone(), name.to_owned());
        let tensors = self.parse()?;
        let Ok(view) = tensors.tensor(&name) else { return Err(WeightError::Missing { path, name }) };
        if view.dtype() != Dtype::F32 || view.shape() != expected {
            let actual = format!("{:?} {:?}", view.dtype(), view.shape());
            return Err(WeightError::Shape { path, name, expected: expected.to_vec(), actual });
        }
        Ok(view.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    }

    /// `graph` with the tensors that are called as its parameters.
    pub(super) fn runner(&self, name: &'static str, graph: Graph) -> Result<Runner, WeightError> {
        self.runner_from(name, graph, |layer, kind, shape| self.tensor(&format!("{layer}.{kind}"), shape))
    }

    /// `graph` with what `values` gives for each of its parameters, by layer, kind (`weight` or `bias`) and shape.
    pub(super) fn runner_from(
        &self,
        name: &'static str,
        graph: Graph,
        values: impl Fn(&str, &str, &[usize]) -> Result<Vec<f32>, WeightError>,
    ) -> Result<Runner, WeightError> {
        let unusable = |e: neural::WeightError| self.unusable(e.into());
        let mut arrays = Arrays::new();
        for Parameter { name, shape } in graph.parameters() {
            let (layer, kind) = name.rsplit_once('.').unwrap_or((&name, ""));
            let array = Array::new(&name, &shape, values(layer, kind, &shape)?).map_err(unusable)?;
            arrays.insert(name, array);
        }
        let [tier, licence] = ["", ""].map(str::to_owned);
        let (network, version) = (graph.name().to_owned(), graph.version());
        let training_data = "as published".to_owned();
        let header = Header { network, version, scale: 0, tier, training_data, licence };
        let weights = neural::Weights { header, arrays };
        Runner::new(name, graph, weights).map_err(|e| self.unusable(e))
    }

    /// What the engine says of them.
    pub(super) fn unusable(&self, source: RunError) -> WeightError {
        WeightError::Unusable { path: self.path.clone(), source: Box::new(source) }
    }
}
