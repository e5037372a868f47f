//! Named arrays of numbers, and the safetensors files that hold them.

use std::collections::{BTreeMap, HashMap};
#[cfg(feature = "fs")]
use std::{io::Write, path::Path};

#[cfg(feature = "fs")]
use gs3_files::{ReadError, read_within, write_atomically};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::error::WeightError;

/// Largest size of a file, in bytes: an optimiser's two numbers for each of a hundred million weights, a hundred
/// times as many as in the largest network compared with.
pub const MAX_BYTES: u64 = 1 << 30;

/// Numbers with a shape; the last axis is contiguous.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Array {
    shape: Vec<usize>,
    values: Vec<f32>,
}

impl Array {
    /// `values` in `shape`.
    ///
    /// # Errors
    /// [`WeightError::Shape`] with `name`, if `shape` does not hold as many numbers.
    pub fn new(name: &str, shape: &[usize], values: Vec<f32>) -> Result<Self, WeightError> {
        let count = shape.iter().try_fold(1_usize, |product, side| product.checked_mul(*side));
        if count != Some(values.len()) {
            let actual = format!("{} numbers", values.len());
            return Err(WeightError::Shape { name: name.to_owned(), expected: shape.to_vec(), actual });
        }
        Ok(Self { shape: shape.to_vec(), values })
    }

    /// Zeros in `shape`, the shape of a graph's parameter, which is small enough to exist.
    pub(crate) fn zeros(shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), values: vec![0.0; shape.iter().product()] }
    }

    /// Length along each axis.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The numbers.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The numbers, to change.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }
}

/// Arrays by name, in the order of names.
pub type Arrays = BTreeMap<String, Array>;

/// Texts by name: the header of a file.
pub type Texts = BTreeMap<String, String>;

/// Reads safetensors of f32.
///
/// # Errors
/// [`WeightError`] if `bytes` are something else.
pub fn from_bytes(bytes: &[u8]) -> Result<(Texts, Arrays), WeightError> {
    let format = |e: safetensors::SafeTensorError| WeightError::Format { message: e.to_string() };
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(format)?;
    let texts = metadata.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
    let file = SafeTensors::deserialize(bytes).map_err(format)?;
    let mut arrays = Arrays::new();
    for (name, view) in file.iter() {
        if view.dtype() != Dtype::F32 {
            let (expected, actual) = (view.shape().to_vec(), format!("{:?}", view.dtype()));
            return Err(WeightError::Shape { name: name.to_owned(), expected, actual });
        }
        let values = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        arrays.insert(name.to_owned(), Array::new(name, view.shape(), values)?);
    }
    Ok((texts, arrays))
}

/// Writes safetensors of f32.
///
/// # Errors
/// [`WeightError::Format`] if a name cannot be written.
pub fn to_bytes(texts: &Texts, arrays: &Arrays) -> Result<Vec<u8>, WeightError> {
    let data: Vec<Vec<u8>> =
        arrays.values().map(|a| a.values.iter().flat_map(|v| v.to_le_bytes()).collect()).collect();
    let format = |e: safetensors::SafeTensorError| WeightError::Format { message: e.to_string() };
    let mut views = Vec::with_capacity(arrays.len());
    for ((name, array), bytes) in arrays.iter().zip(&data) {
        views.push((name, TensorView::new(Dtype::F32, array.shape.clone(), bytes).map_err(format)?));
    }
    let texts: HashMap<String, String> = texts.clone().into_iter().collect();
    let mut bytes = safetensors::serialize(views, Some(texts)).map_err(format)?;
    sort_header(&mut bytes);
    Ok(bytes)
}

/// Sorts the fields of the header of a safetensors file by name. The writer takes texts from a hash map, so their
/// order would differ every time; sorted, the same content always has the same bytes. Bytes that are not safetensors
/// stay unchanged.
pub fn sort_header(bytes: &mut [u8]) {
    let Some((size, rest)) = bytes.split_first_chunk_mut() else { return };
    let size = usize::try_from(u64::from_le_bytes(*size)).ok();
    let Some(header) = size.and_then(|size| rest.get_mut(..size)) else { return };
    // Shorter by no byte: what is left at the end is the padding that the format allows.
    if let Some(sorted) = sorted(header).ok().filter(|sorted| sorted.len() <= header.len()) {
        header.fill(b' ');
        header[..sorted.len()].copy_from_slice(&sorted);
    }
}

/// The fields of a header by name, and its texts by name.
fn sorted(header: &[u8]) -> Result<Vec<u8>, serde_json::Error> {
    const TEXTS: &str = "__metadata__";
    let mut fields: BTreeMap<String, serde_json::Value> = serde_json::from_slice(header)?;
    let texts = fields.remove(TEXTS).map(serde_json::from_value::<Texts>).transpose()?;
    let mut out = b"{".to_vec();
    if let Some(texts) = texts {
        out.extend(serde_json::to_vec(TEXTS)?);
        out.push(b':');
        out.extend(serde_json::to_vec(&texts)?);
    }
    for (name, value) in fields {
        if out.len() > 1 {
            out.push(b',');
        }
        out.extend(serde_json::to_vec(&name)?);
        out.push(b':');
        out.extend(serde_json::to_vec(&value)?);
    }
    out.push(b'}');
    Ok(out)
}

/// Reads a file: [`from_bytes`].
///
/// # Errors
/// [`WeightError`] if it cannot be read, has more than [`MAX_BYTES`] or holds something else.
#[cfg(feature = "fs")]
pub fn load(path: &Path) -> Result<(Texts, Arrays), WeightError> {
    let read = |error: ReadError| WeightError::File { path: path.to_owned(), source: error.into() };
    from_bytes(&read_within(path, MAX_BYTES).map_err(read)?)
}

/// Writes a file whole or not at all: [`to_bytes`], [`write_atomically`].
///
/// # Errors
/// [`WeightError::File`] if it cannot be written.
#[cfg(feature = "fs")]
pub fn save(path: &Path, texts: &Texts, arrays: &Arrays) -> Result<(), WeightError> {
    let bytes = to_bytes(texts, arrays)?;
    write_atomically(path, |writer| writer.write_all(&bytes))
        .map_err(|source| WeightError::File { path: path.to_owned(), source })
}
