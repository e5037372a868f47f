//! Weights of published networks, by the names that their authors gave them.

use std::path::{Path, PathBuf};

use gs3::neural::arrays::{self, Array, Arrays};
use gs3::neural::{self, Graph, Header, Parameter, RunError, WeightError};

use super::runner::Runner;

/// Why published weights cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PublishedWeightError {
    /// The file cannot be read. The source names it.
    #[error(transparent)]
    Read(WeightError),
    /// It is no safetensors file, or not of this network.
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
pub struct PublishedWeights {
    path: PathBuf,
    arrays: Arrays,
}

impl PublishedWeights {
    /// Reads the file.
    ///
    /// # Errors
    /// [`PublishedWeightError`] if it cannot be read or is no safetensors file.
    pub fn load(path: &Path) -> Result<Self, PublishedWeightError> {
        let path = path.to_owned();
        match arrays::load(&path) {
            Ok((_, arrays)) => Ok(Self { path, arrays }),
            Err(error @ WeightError::File { .. }) => Err(PublishedWeightError::Read(error)),
            Err(error) => Err(PublishedWeightError::Unusable { path, source: Box::new(error.into()) }),
        }
    }

    /// The values of tensor `name`, which must have this shape.
    pub(super) fn tensor(&self, name: &str, expected: &[usize]) -> Result<Vec<f32>, PublishedWeightError> {
        let wrong = |error: WeightError| self.unusable(error.into());
        let (owned, shape) = (name.to_owned(), expected.to_vec());
        let Some(array) = self.arrays.get(name) else {
            return Err(wrong(WeightError::Missing { name: owned, expected: shape }));
        };
        if array.shape() != expected {
            let actual = format!("{:?}", array.shape());
            return Err(wrong(WeightError::Shape { name: owned, expected: shape, actual }));
        }
        Ok(array.values().to_vec())
    }

    /// `graph` with the tensors that are called as its parameters.
    pub(super) fn runner(&self, name: &'static str, graph: Graph) -> Result<Runner, PublishedWeightError> {
        self.runner_from(name, graph, |layer, kind, shape| self.tensor(&format!("{layer}.{kind}"), shape))
    }

    /// `graph` with what `values` gives for each of its parameters, by layer, kind (`weight` or `bias`) and shape.
    pub(super) fn runner_from(
        &self,
        name: &'static str,
        graph: Graph,
        values: impl Fn(&str, &str, &[usize]) -> Result<Vec<f32>, PublishedWeightError>,
    ) -> Result<Runner, PublishedWeightError> {
        let unusable = |e: WeightError| self.unusable(e.into());
        let mut arrays = Arrays::new();
        for Parameter { name, shape } in graph.parameters() {
            let (layer, kind) = name.rsplit_once('.').unwrap_or((&name, ""));
            let array = Array::new(&name, &shape, values(layer, kind, &shape)?).map_err(unusable)?;
            arrays.insert(name, array);
        }
        let header = Header { training_data: "as published".to_owned(), ..Header::of(&graph, 0) };
        let weights = neural::Weights { header, arrays };
        Runner::new(name, graph, weights).map_err(|e| self.unusable(e))
    }

    /// What the engine says of them.
    pub(super) fn unusable(&self, source: RunError) -> PublishedWeightError {
        PublishedWeightError::Unusable { path: self.path.clone(), source: Box::new(source) }
    }
}
