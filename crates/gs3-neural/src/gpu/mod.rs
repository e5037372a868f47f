//! The GPU engine: a network for one image size, planned once; a frame's images stay on the device.
//!
//! Tensors are planes of four channels (`[ceil(C / 4)][height][width]`, each a vec4): neighbouring invocations read and
//! write neighbouring vectors. Few results are stored ([`fuse`]); the others are functions in the kernels that read
//! them ([`expression`]), with WGSL written for their sizes; the plan ([`plan`]) is a pure function. Convolutions
//! stage a tile of their input and the weights of four channels in workgroup memory, and keep four pixels × 16 channels
//! in registers, or products of matrices where hardware makes them ([`MatrixUnit`]); the parts of a concatenation are
//! read where they are; blocks of pixels become channels while images come in and pixels again while they go out.

mod conv;
mod conv_matrix;
mod error;
mod export;
mod expression;
mod fuse;
mod plan;
mod slots;
mod source;

pub use conv_matrix::MatrixUnit;
pub use error::GpuRunError;

use std::collections::HashMap;

use gs3_compute::{Bound, Buffer, Gpu, Kernel, Recorder, Slice, Use};

use crate::error::RunError;
use crate::graph::{Graph, Shape};
use crate::weights::Weights;
use plan::{Plan, Stored};

/// In which numbers a network is computed on a GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Precision {
    /// Single precision throughout.
    Single,
    /// Tensors, weights and products in half precision; sums over more than four input channels in single.
    Half,
}

impl Precision {
    /// The fastest that `gpu` can do.
    #[must_use]
    pub fn of(gpu: &Gpu) -> Self {
        match gpu.capabilities().shader_f16 {
            true => Self::Half,
            false => Self::Single,
        }
    }

    /// Bytes of a number.
    fn bytes(self) -> u64 {
        match self {
            Self::Single => 4,
            Self::Half => 2,
        }
    }
}

/// How an image lies in its buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ImageFormat {
    /// `[height, width, channels]` of f32, as the CPU engine's.
    #[default]
    Pixels,
    /// The same of f16, two to a word: any device reads and writes them.
    HalfPixels,
    /// As the engine's own tensors, `[ceil(channels / 4), height, width, 4]` of the engine's precision; numbers
    /// beyond the channels are finite. Nothing is copied: for states that a network hands to its next run.
    Blocks,
}

/// How a network is run.
#[derive(Clone, Copy, Debug)]
pub struct GpuEngineSettings<'a> {
    /// In which numbers.
    pub precision: Precision,
    /// What makes the products of convolutions, where they are wide enough and in half precision; invocations if
    /// nothing.
    pub matrices: Option<MatrixUnit>,
    /// Formats of inputs by name, [`ImageFormat::Pixels`] where none is given.
    pub inputs: &'a [(&'a str, ImageFormat)],
    /// The outputs that are wanted, in their formats; all as [`ImageFormat::Pixels`] if none. What only other outputs
    /// need is not computed.
    pub outputs: Option<&'a [(&'a str, ImageFormat)]>,
}

impl GpuEngineSettings<'_> {
    /// All outputs, all images as f32 pixels, plain products.
    #[must_use]
    pub fn new(precision: Precision) -> Self {
        Self { precision, matrices: None, inputs: &[], outputs: None }
    }
}

/// An input or output of a network on a GPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuTensorImage {
    /// Its name in the graph.
    pub name: String,
    /// Its size.
    pub shape: Shape,
    /// How it lies in its buffer.
    pub format: ImageFormat,
    /// Bytes of its buffer.
    pub bytes: u64,
}

/// A network compiled for images of one size.
#[derive(Clone, Debug)]
pub struct GpuEngine {
    plan: Plan,
    kernels: Vec<Kernel>,
    weights: Buffer,
    slots: Vec<Buffer>,
}

/// A network with its images.
#[derive(Clone, Debug)]
pub struct BoundEngine {
    steps: Vec<(Bound, [u32; 3])>,
}

impl GpuEngine {
    /// `graph` with `weights` for an LR grid of `[height, width]`.
    ///
    /// # Errors
    /// [`GpuRunError`] if the graph cannot take that size or has no such images, the weights are not its own, or the
    /// device has no room, no half precision or no such products of matrices.
    pub fn new(
        gpu: &Gpu,
        graph: &Graph,
        weights: &Weights,
        lr: [usize; 2],
        settings: &GpuEngineSettings<'_>,
    ) -> Result<Self, GpuRunError> {
        let plan = Plan::new(graph, weights, lr, settings)?;
        let mut compiled: HashMap<&str, Kernel> = HashMap::new();
        let mut kernels = Vec::with_capacity(plan.steps.len());
        for step in &plan.steps {
            let kernel = match compiled.get(step.source.as_str()) {
                Some(kernel) => kernel.clone(),
                None => gpu.module(&step.label, &[&step.source])?.kernel(gpu, "main", &[])?,
            };
            compiled.insert(&step.source, kernel.clone());
            kernels.push(kernel);
        }
        let buffer = gpu.buffer_with("network weights", Use::Storage, &plan.weights)?;
        let slots = plan.slots.iter().map(|bytes| gpu.buffer("network tensor", Use::Storage, *bytes));
        let slots = slots.collect::<Result<_, _>>()?;
        Ok(Self { plan, kernels, weights: buffer, slots })
    }

    /// Bytes of all results in flight.
    #[must_use]
    pub fn arena_bytes(&self) -> u64 {
        self.slots.iter().map(Buffer::bytes).sum()
    }

    /// Bytes that a run reads and writes: each tensor and image once per kernel, without weights. Divided by the
    /// bytes that a device copies per second, this is the least time of a run with tensors larger than any cache.
    #[must_use]
    pub fn bytes_moved(&self) -> u64 {
        self.plan.steps.iter().map(|step| step.bytes).sum()
    }

    /// Kernels of a run.
    #[must_use]
    pub fn kernels(&self) -> usize {
        self.kernels.len()
    }

    /// The images that it needs.
    #[must_use]
    pub fn inputs(&self) -> &[GpuTensorImage] {
        &self.plan.inputs
    }

    /// The images that it makes.
    #[must_use]
    pub fn outputs(&self) -> &[GpuTensorImage] {
        &self.plan.outputs
    }

    /// Binds the network to the buffers of all its inputs and outputs, by name. An output must not be in the buffer
    /// of an input.
    ///
    /// # Errors
    /// [`GpuRunError`] if an image is missing, unknown or too short.
    pub fn bind(
        &self,
        gpu: &Gpu,
        inputs: &[(&str, Slice<'_>)],
        outputs: &[(&str, Slice<'_>)],
    ) -> Result<BoundEngine, GpuRunError> {
        let (inputs, outputs) = (slices(&self.plan.inputs, inputs)?, slices(&self.plan.outputs, outputs)?);
        let slice = |stored: &Stored| match stored {
            Stored::Slot(slot) => self.slots[*slot].slice(),
            Stored::Input(image) => inputs[*image],
            Stored::Output(image) => outputs[*image],
        };
        let mut steps = Vec::with_capacity(self.kernels.len());
        for (step, kernel) in self.plan.steps.iter().zip(&self.kernels) {
            let mut buffers = vec![("result", slice(&step.writes))];
            buffers.extend(source::PARTS.into_iter().zip(step.reads.iter().map(slice)));
            buffers.push((
                "weights",
                self.weights.part(step.weights.start, step.weights.end - step.weights.start),
            ));
            steps.push((kernel.bind(gpu, &buffers)?, step.groups));
        }
        Ok(BoundEngine { steps })
    }
}

impl BoundEngine {
    /// Records a run.
    pub fn record(&self, recorder: &mut Recorder<'_>) {
        for (kernel, groups) in &self.steps {
            recorder.dispatch(kernel, *groups);
        }
    }
}

/// The buffer of each of `images`, from those given by name.
fn slices<'a>(images: &[GpuTensorImage], given: &[(&str, Slice<'a>)]) -> Result<Vec<Slice<'a>>, GpuRunError> {
    if let Some((name, _)) = given.iter().find(|(name, _)| images.iter().all(|image| image.name != *name)) {
        return Err(plan::unknown(name, images.iter().map(|image| image.name.as_str())).into());
    }
    let mut slices = Vec::with_capacity(images.len());
    for GpuTensorImage { name, shape, bytes, .. } in images {
        let Some((_, slice)) = given.iter().find(|(given, _)| given == name) else {
            return Err(RunError::Missing { name: name.clone(), expected: *shape }.into());
        };
        if slice.bytes() < *bytes {
            let (name, expected, actual) = (name.clone(), *bytes, slice.bytes());
            return Err(GpuRunError::Bytes { name, expected, actual });
        }
        slices.push(*slice);
    }
    Ok(slices)
}
