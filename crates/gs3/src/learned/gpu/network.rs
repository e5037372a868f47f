//! A network on a device, with the memory of its inputs.

use std::sync::Arc;

use gs3_compute::{Buffer, Gpu, GpuError, Slice, Use};
use gs3_neural::model::graph_of;
use gs3_neural::{GpuEngine, GpuEngineSettings, ImageFormat, MatrixUnit, Precision, Weights};
use gs3_scene::Size;

use crate::error::{NetworkError, PipelineError};

/// Bytes of a buffer for an input that a graph does not have: the smallest size possible.
const LEAST: u64 = 4;

/// An engine, and its inputs on the LR grid by the network's names.
pub struct GpuNetwork {
    pub engine: GpuEngine,
    inputs: Vec<(&'static str, Buffer)>,
}

impl GpuNetwork {
    /// The network of `weights` for an LR grid of `lr` samples, in half precision if the device has it. The
    /// network reads two `images` of halves, its hidden state, and `planes`; the memory of `planes` is made here.
    pub fn new(
        gpu: &Gpu,
        weights: &Arc<Weights>,
        lr: Size,
        images: [&'static str; 2],
        planes: &[&'static str],
    ) -> Result<Self, PipelineError> {
        let graph = graph_of(&weights.header).map_err(NetworkError::from)?;
        let settings = GpuEngineSettings {
            precision: Precision::of(gpu),
            matrices: MatrixUnit::of(gpu.capabilities()),
            inputs: &[
                (images[0], ImageFormat::HalfPixels),
                (images[1], ImageFormat::HalfPixels),
                ("hidden", ImageFormat::Blocks),
            ],
            outputs: Some(&[("color", ImageFormat::HalfPixels), ("hidden", ImageFormat::Blocks)]),
        };
        let engine =
            GpuEngine::new(gpu, &graph, weights, [lr.height as usize, lr.width as usize], &settings)?;
        let mut network = Self { engine, inputs: Vec::with_capacity(planes.len()) };
        for name in planes {
            let buffer = network.buffer(gpu, name)?;
            network.inputs.push((name, buffer));
        }
        Ok(network)
    }

    /// Memory as large as input `name`.
    pub fn buffer(&self, gpu: &Gpu, name: &'static str) -> Result<Buffer, GpuError> {
        let bytes = self.engine.inputs().iter().find(|input| input.name == name).map(|input| input.bytes);
        gpu.buffer(name, Use::Storage, bytes.unwrap_or(LEAST))
    }

    /// The memory of plane `name`.
    pub fn input(&self, name: &str) -> Result<&Buffer, GpuError> {
        let found = self.inputs.iter().find(|(n, _)| *n == name).map(|(_, buffer)| buffer);
        found.ok_or_else(|| missing(name))
    }

    /// All planes by their names.
    pub fn slices(&self) -> Vec<(&str, Slice<'_>)> {
        self.inputs.iter().map(|(name, buffer)| (*name, buffer.slice())).collect()
    }
}

/// The network needs an input that is missing.
pub fn missing(name: &str) -> GpuError {
    GpuError::Bindings {
        kernel: "the network".to_owned(),
        expected: name.to_owned(),
        actual: "no such input".to_owned(),
    }
}
