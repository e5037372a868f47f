//! Quality metrics.

use gs3_evaluate::metrics::{self, MetricError, Quantisation, SsimBorder};
use numpy::{PyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::arrays::{image, to_numpy};
use crate::error;

type Picture<'py> = PyReadonlyArray3<'py, f32>;

const fn quantisation(is_eight_bit: bool) -> Quantisation {
    if is_eight_bit { Quantisation::EightBit } else { Quantisation::None }
}

fn measure(py: Python<'_>, work: impl FnOnce() -> Result<f64, MetricError> + Send) -> PyResult<f64> {
    py.detach(work).map_err(error::input)
}

#[pyfunction]
fn psnr(py: Python<'_>, reference: Picture<'_>, test: Picture<'_>, is_eight_bit: bool) -> PyResult<f64> {
    let (reference, test) = (image("reference", &reference)?, image("test", &test)?);
    measure(py, || metrics::psnr(&reference, &test, quantisation(is_eight_bit)))
}

#[pyfunction]
fn ssim(py: Python<'_>, reference: Picture<'_>, test: Picture<'_>, is_padded: bool) -> PyResult<f64> {
    let (reference, test) = (image("reference", &reference)?, image("test", &test)?);
    let border = if is_padded { SsimBorder::ZeroPad } else { SsimBorder::Crop };
    measure(py, || metrics::ssim(&reference, &test, border))
}

#[pyfunction]
fn flip(py: Python<'_>, reference: Picture<'_>, test: Picture<'_>, pixels_per_degree: f32) -> PyResult<f64> {
    let (reference, test) = (image("reference", &reference)?, image("test", &test)?);
    measure(py, || metrics::flip(&reference, &test, pixels_per_degree))
}

#[pyfunction]
fn flip_map<'py>(
    py: Python<'py>,
    reference: Picture<'py>,
    test: Picture<'py>,
    pixels_per_degree: f32,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (reference, test) = (image("reference", &reference)?, image("test", &test)?);
    let map = py.detach(|| metrics::flip_map(&reference, &test, pixels_per_degree)).map_err(error::input)?;
    to_numpy(py, map.data().to_vec(), [map.height(), map.width()])
}

#[pyfunction]
fn tpsnr(
    py: Python<'_>,
    reference: [Picture<'_>; 2],
    test: [Picture<'_>; 2],
    is_eight_bit: bool,
) -> PyResult<f64> {
    let images = |name, [a, b]: [Picture<'_>; 2]| Ok::<_, PyErr>([image(name, &a)?, image(name, &b)?]);
    let (reference, test) = (images("reference", reference)?, images("test", test)?);
    measure(py, || metrics::tpsnr(reference.each_ref(), test.each_ref(), quantisation(is_eight_bit)))
}

#[pyfunction]
fn flicker(
    py: Python<'_>,
    reference: [Picture<'_>; 3],
    test: [Picture<'_>; 3],
    is_eight_bit: bool,
) -> PyResult<f64> {
    let images = |name, [a, b, c]: [Picture<'_>; 3]| {
        Ok::<_, PyErr>([image(name, &a)?, image(name, &b)?, image(name, &c)?])
    };
    let (reference, test) = (images("reference", reference)?, images("test", test)?);
    measure(py, || metrics::flicker(reference.each_ref(), test.each_ref(), quantisation(is_eight_bit)))
}

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(psnr, module)?)?;
    module.add_function(wrap_pyfunction!(ssim, module)?)?;
    module.add_function(wrap_pyfunction!(flip, module)?)?;
    module.add_function(wrap_pyfunction!(flip_map, module)?)?;
    module.add_function(wrap_pyfunction!(tpsnr, module)?)?;
    module.add_function(wrap_pyfunction!(flicker, module)?)
}
