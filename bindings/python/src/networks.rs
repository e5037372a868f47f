//! The networks that come with the library: their weights, and ONNX files of them.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use gs3::neural::model::{Network, graph_of};
use gs3::neural::{Weights, onnx};
use gs3::{Networks, Tier};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error;
use crate::renderer::{TIERS, named};

fn shipped(network: &str, tier: &str, scale: u32) -> PyResult<Arc<Weights>> {
    let tier = named("tier", tier, &TIERS, Tier::name)?;
    let networks = Networks::shipped(scale, tier).map_err(|e| error::of_network(&e))?;
    let found = match Network::from_name(network) {
        Some(Network::SuperSample) => networks.super_sample,
        Some(Network::Interpolate) => networks.interpolate,
        None => {
            return Err(error::input(format_args!(
                "network: expected super_sample or interpolate, found {network:?}"
            )));
        }
    };
    found.ok_or_else(|| {
        error::input(format_args!(
            "network: expected one that comes with gs3, found {network} ×{scale} of tier {}",
            tier.name()
        ))
    })
}

/// Arrays by the names of their layers' parameters.
#[pyfunction]
fn weights<'py>(py: Python<'py>, network: &str, tier: &str, scale: u32) -> PyResult<Bound<'py, PyDict>> {
    let weights = shipped(network, tier, scale)?;
    let dict = PyDict::new(py);
    for (name, array) in &weights.arrays {
        let values = PyArray1::from_slice(py, array.values());
        dict.set_item(name, values.reshape(array.shape().to_vec())?)?;
    }
    Ok(dict)
}

#[pyfunction]
fn weights_info<'py>(py: Python<'py>, network: &str, tier: &str, scale: u32) -> PyResult<Bound<'py, PyDict>> {
    let header = &shipped(network, tier, scale)?.header;
    let dict = PyDict::new(py);
    dict.set_item("network", &header.network)?;
    dict.set_item("version", header.version)?;
    dict.set_item("scale", header.scale)?;
    dict.set_item("tier", &header.tier)?;
    dict.set_item("training_data", &header.training_data)?;
    dict.set_item("licence", &header.licence)?;
    Ok(dict)
}

/// Writes the network with its weights; the file appears whole or not at all.
#[pyfunction]
fn export_onnx(py: Python<'_>, path: PathBuf, network: &str, tier: &str, scale: u32) -> PyResult<()> {
    let weights = shipped(network, tier, scale)?;
    let bytes = py.detach(|| {
        let graph = graph_of(&weights.header).map_err(error::input)?;
        onnx::export(&graph, &weights).map_err(error::input)
    })?;
    let written = py.detach(|| gs3_files::write_atomically(&path, |writer| writer.write_all(&bytes)));
    written.map_err(|e| error::file(format_args!("{}: {e}", path.display())))
}

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(weights, module)?)?;
    module.add_function(wrap_pyfunction!(weights_info, module)?)?;
    module.add_function(wrap_pyfunction!(export_onnx, module)?)
}
