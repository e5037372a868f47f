//! Weights by name from safetensors files.

use std::path::{Path, PathBuf};

use gs3::neural::arrays::MAX_BYTES;
use gs3_files::{ReadError, read_within};
use safetensors::{Dtype, SafeTensors};

use super::conv::Conv;

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

    /// The convolution `name`: `name.weight` and `name.bias`.
    pub(super) fn conv(
        &self,
        name: &str,
        outputs: usize,
        inputs: usize,
        side: usize,
    ) -> Result<Conv, WeightError> {
        let weights = self.tensor(&format!("{name}.weight"), &[outputs, inputs, side, side])?;
        let bias = self.tensor(&format!("{name}.bias"), &[outputs])?;
        Ok(Conv::new(outputs, inputs, side, &weights, Some(&bias)))
    }

    /// The convolution `name` without a bias: `name.weight`.
    pub(super) fn conv_without_bias(
        &self,
        name: &str,
        outputs: usize,
        inputs: usize,
        side: usize,
    ) -> Result<Conv, WeightError> {
        let weights = self.tensor(&format!("{name}.weight"), &[outputs, inputs, side, side])?;
        Ok(Conv::new(outputs, inputs, side, &weights, None))
    }
}
