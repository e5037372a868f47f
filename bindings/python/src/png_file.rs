//! Frames as PNG files.

use std::path::PathBuf;

use gs3::scene::{PngChannels, Size, write_png};
use gs3_files::write_atomically;
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error;

/// Writes `frame`, u8 [H, W, 3] without gaps, as `gs3 render` does.
#[pyfunction]
fn save_png(py: Python<'_>, path: PathBuf, frame: PyReadonlyArray3<'_, u8>) -> PyResult<()> {
    let shape = frame.shape();
    let (&[height, width, 3], Ok(bytes)) = (shape, frame.as_slice()) else {
        return Err(error::input(format_args!(
            "frame: expected u8 [H, W, 3] without gaps, found shape {shape:?}"
        )));
    };
    let size = Size::of(width, height);
    py.detach(|| write_atomically(&path, |writer| write_png(writer, size, PngChannels::Rgb, bytes)))
        .map_err(|source| error::file(format_args!("{}: cannot be written: {source}", path.display())))
}

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(save_png, module)?)
}
