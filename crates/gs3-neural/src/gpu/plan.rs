//! What is computed in which order and where, with all sizes and all WGSL: one pure function.

use std::ops::Range;

use gs3_compute::{GpuError, grid};

use super::conv::Convolution;
use super::conv_matrix::MatrixConvolution;
use super::slots::Slots;
use super::source::{BLOCK, PARTS, blocks};
use super::{GpuEngineSettings, GpuImage, GpuRunError, ImageFormat, MatrixUnit, Precision, ops};
use crate::error::RunError;
use crate::graph::{Activation, Graph, Op, Tensor};
use crate::reference::parameter;
use crate::shape::Shape;
use crate::weights::Weights;

/// Invocations of a workgroup of all kernels but convolutions.
const THREADS: usize = 256;

/// Multiple at which the weights of a layer start, bytes: what every device can bind.
const WEIGHT_ALIGNMENT: usize = 256;

/// A network for one image size.
#[derive(Clone, Debug)]
pub struct Plan {
    pub steps: Vec<Step>,
    /// Bytes of the buffers that tensors share.
    pub slots: Vec<u64>,
    /// All weights.
    pub weights: Vec<u8>,
    pub inputs: Vec<GpuImage>,
    pub outputs: Vec<GpuImage>,
}

/// A dispatch.
#[derive(Clone, Debug)]
pub struct Step {
    /// The layer, for messages.
    pub label: String,
    pub source: String,
    pub reads: Vec<Stored>,
    pub writes: Stored,
    /// Its weights, bytes.
    pub weights: Range<u64>,
    pub groups: [u32; 3],
}

/// Where a tensor or image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    /// In a buffer of the engine.
    Slot(usize),
    /// In the buffer of an input.
    Input(usize),
    /// In the buffer of an output.
    Output(usize),
}

/// Bytes of a tensor.
fn tensor_bytes(shape: Shape, precision: Precision) -> u64 {
    (shape.pixels() * blocks(shape) * BLOCK) as u64 * precision.bytes()
}

/// Where a tensor or image is, before buffers are given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// In a tensor of its own: the result of that layer.
    Tensor(usize),
    /// In the buffer of an input.
    Input(usize),
    /// In the buffer of an output.
    Output(usize),
    /// Nowhere: readers read what it is made of.
    Fused,
}

/// A step before buffers are given out.
struct Draft {
    label: String,
    source: String,
    reads: Vec<Place>,
    writes: Place,
    weights: Range<u64>,
    groups: [u32; 3],
}

struct Planner<'a> {
    graph: &'a Graph,
    shapes: Vec<Shape>,
    precision: Precision,
    matrices: Option<MatrixUnit>,
    /// Of each layer's result.
    places: Vec<Place>,
    inputs: Vec<GpuImage>,
    outputs: Vec<GpuImage>,
    /// Which of the inputs a layer is.
    input_of: Vec<Option<usize>>,
    drafts: Vec<Draft>,
    weights: Vec<u8>,
}

impl Plan {
    /// The plan of `graph` with `weights` for an LR grid of `[height, width]`.
    pub fn new(
        graph: &Graph,
        weights: &Weights,
        lr: [usize; 2],
        settings: &GpuEngineSettings<'_>,
    ) -> Result<Self, GpuRunError> {
        let shapes = graph.shapes(lr)?;
        weights.check(graph)?;
        if let Some(layer) = graph.layers().iter().find(|layer| !is_known(&layer.op)) {
            let (layer, actual) = (layer.name.clone(), format!("{:?}", layer.op));
            return Err(GpuRunError::Operation { layer, actual });
        }
        let precision = settings.precision;
        let input_names: Vec<&str> = graph.inputs().map(|(_, layer)| layer.name.as_str()).collect();
        let output_names: Vec<&str> = graph.outputs().iter().map(|o| o.name.as_str()).collect();
        for (name, _) in settings.inputs {
            check(name, &input_names)?;
        }
        let all: Vec<_> = output_names.iter().map(|name| (*name, ImageFormat::default())).collect();
        // The wanted outputs with their formats.
        let mut wanted = Vec::new();
        for (name, format) in settings.outputs.unwrap_or(&all) {
            check(name, &output_names)?;
            wanted.extend(graph.outputs().iter().filter(|o| o.name == *name).map(|o| (o, *format)));
        }
        let mut needed = vec![false; shapes.len()];
        wanted.iter().for_each(|(output, _)| needed[output.tensor.index()] = true);
        for k in (0..shapes.len()).rev() {
            if needed[k] {
                graph.layers()[k].inputs.iter().for_each(|t| needed[t.index()] = true);
            }
        }
        let mut planner = Planner {
            graph,
            places: vec![Place::Fused; shapes.len()],
            input_of: vec![None; shapes.len()],
            precision,
            matrices: settings.matrices,
            inputs: Vec::new(),
            outputs: Vec::new(),
            drafts: Vec::new(),
            weights: Vec::new(),
            shapes,
        };
        // Inputs are all there, needed or not: what is given does not depend on what is asked for.
        for (tensor, layer) in graph.inputs() {
            let given = settings.inputs.iter().find(|(name, _)| *name == layer.name);
            let format = given.map_or(ImageFormat::default(), |(_, format)| *format);
            planner.input_of[tensor.index()] = Some(planner.inputs.len());
            planner.inputs.push(planner.image(&layer.name, tensor.index(), format));
        }
        let mut exports = Vec::new();
        for (output, format) in wanted {
            exports.push((planner.outputs.len(), output.tensor.index()));
            planner.outputs.push(planner.image(&output.name, output.tensor.index(), format));
        }
        planner.place(&needed, &exports);
        for k in (0..needed.len()).filter(|k| needed[*k]) {
            planner.compute(weights, k)?;
            for (image, _) in exports.iter().filter(|(_, layer)| *layer == k) {
                planner.export(*image, k)?;
            }
        }
        planner.finish()
    }
}

/// An error unless `name` is one of `names`.
fn check(name: &str, names: &[&str]) -> Result<(), RunError> {
    match names.contains(&name) {
        true => Ok(()),
        false => Err(unknown(name, names.iter().copied())),
    }
}

/// `name` is not one of `names`.
pub fn unknown<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> RunError {
    RunError::Unknown { name: name.to_owned(), expected: names.collect::<Vec<_>>().join(", ") }
}

impl Planner<'_> {
    /// The image that is the result of `layer`.
    fn image(&self, name: &str, layer: usize, format: ImageFormat) -> GpuImage {
        let shape = self.shapes[layer];
        let bytes = match format {
            ImageFormat::Pixels | ImageFormat::HalfPixels => ops::words(shape, format) as u64 * 4,
            ImageFormat::Blocks => tensor_bytes(shape, self.precision),
        };
        GpuImage { name: name.to_owned(), shape, format, bytes }
    }

    /// Decides where results are.
    fn place(&mut self, needed: &[bool], exports: &[(usize, usize)]) {
        let layers = self.graph.layers();
        let readers = |k: usize| {
            let reads = move |layer: usize| layers[layer].inputs.iter().any(|t| t.index() == k);
            (0..layers.len())
                .filter(move |layer| needed[*layer] && reads(*layer))
                .map(|layer| &layers[layer].op)
        };
        for (k, layer) in layers.iter().enumerate() {
            let outputs: Vec<usize> =
                exports.iter().filter(|(_, of)| *of == k).map(|(image, _)| *image).collect();
            let is_blocks = |image: &GpuImage| image.format == ImageFormat::Blocks;
            let as_blocks = outputs.iter().copied().find(|image| is_blocks(&self.outputs[*image]));
            let input = self.input_of[k].filter(|image| is_blocks(&self.inputs[*image]));
            let fused = match layer.op {
                Op::Concat => outputs.is_empty() && readers(k).all(|op| matches!(op, Op::Conv2d(_))),
                Op::Input { .. } => {
                    outputs.is_empty() && readers(k).all(|op| matches!(op, Op::PixelUnshuffle { .. }))
                }
                Op::PixelShuffle { .. } => {
                    as_blocks.is_none() && layer.inputs.len() == 1 && readers(k).next().is_none()
                }
                _ => false,
            };
            self.places[k] = match (input, as_blocks) {
                (Some(image), _) => Place::Input(image),
                _ if fused => Place::Fused,
                (None, Some(image)) => Place::Output(image),
                (None, None) => Place::Tensor(k),
            };
        }
    }

    /// Adds the step that makes the result of layer `k`, if there is any.
    fn compute(&mut self, weights: &Weights, k: usize) -> Result<(), GpuRunError> {
        let layer = &self.graph.layers()[k];
        let (shape, precision) = (self.shapes[k], self.precision);
        if matches!(self.places[k], Place::Fused | Place::Input(_)) {
            return Ok(());
        }
        // Pixels, which become channels on the way.
        let pixels = |t: &Tensor| self.input_of[t.index()].filter(|_| self.places[t.index()] == Place::Fused);
        let imported = match (&layer.op, &layer.inputs[..]) {
            (Op::Input { .. }, _) => self.input_of[k].map(|image| (image, 1)),
            (Op::PixelUnshuffle { factor }, [t]) => pixels(t).map(|image| (image, *factor)),
            _ => None,
        };
        if let Some((image, factor)) = imported {
            let from = &self.inputs[image];
            let source = ops::import(from.shape, from.format, factor, shape, precision);
            return self.map(k, source, vec![Place::Input(image)]);
        }
        let inputs = layer.inputs.iter().map(|t| t.index());
        if let Op::Conv2d(conv) = &layer.op {
            // The parts of a concatenation are read where they are.
            let fused = |k: usize| self.places[k] == Place::Fused;
            let parts: Vec<usize> = inputs
                .flat_map(|k| match &self.graph.layers()[k] {
                    concat if fused(k) => concat.inputs.iter().map(|t| t.index()).collect(),
                    _ => vec![k],
                })
                .collect();
            self.check_parts(&layer.name, parts.len())?;
            let shapes: Vec<Shape> = parts.iter().map(|part| self.shapes[*part]).collect();
            let [weight, bias] = ["weight", "bias"].map(|kind| parameter(weights, &layer.name, kind));
            let border = self.graph.border();
            let unit = self.matrices.filter(|_| precision == Precision::Half);
            let in_matrices = unit.and_then(|unit| MatrixConvolution::new(*conv, &shapes, shape, unit));
            let (source, values, groups) = match in_matrices {
                Some(conv) => (conv.source(border), conv.weights(weight, bias), conv.groups()),
                None => {
                    let conv = Convolution::new(*conv, &shapes, shape, precision);
                    (conv.source(precision, border), conv.weights(weight, bias), conv.groups()?)
                }
            };
            let draft = Draft {
                label: layer.name.clone(),
                source,
                reads: parts.iter().map(|part| self.places[*part]).collect(),
                writes: self.places[k],
                weights: self.add_weights(&values),
                groups,
            };
            self.drafts.push(draft);
            return Ok(());
        }
        // What comes twice is bound once.
        let mut reads: Vec<usize> = Vec::new();
        let mut concat = Vec::new();
        // A second input of these gives a size only.
        let is_sized = matches!(layer.op, Op::PixelShuffle { .. } | Op::Upsample { .. });
        for input in inputs.take(if is_sized { 1 } else { usize::MAX }) {
            let found = reads.iter().position(|read| *read == input);
            let is_first = found.is_none() || !matches!(layer.op, Op::Concat);
            if is_first {
                reads.push(input);
            }
            concat.push(found.filter(|_| !is_first).unwrap_or(reads.len() - 1));
        }
        self.check_parts(&layer.name, reads.len())?;
        let shapes: Vec<Shape> = reads.iter().map(|read| self.shapes[*read]).collect();
        let source = ops::map(&layer.op, &shapes, &concat, shape, precision);
        let reads = reads.iter().map(|read| self.places[*read]).collect();
        self.map(k, source, reads)
    }

    fn check_parts(&self, layer: &str, actual: usize) -> Result<(), GpuError> {
        let max = PARTS.len();
        match actual <= max {
            true => Ok(()),
            false => Err(GpuError::TooLarge {
                what: format!("inputs of layer {layer}"),
                max: max as u64,
                actual: actual as u64,
            }),
        }
    }

    /// A step that makes the result of layer `k`, one block per invocation.
    fn map(&mut self, k: usize, source: String, reads: Vec<Place>) -> Result<(), GpuRunError> {
        let (label, shape) = (self.graph.layers()[k].name.clone(), self.shapes[k]);
        let groups = groups(&label, shape.pixels() * blocks(shape))?;
        self.drafts.push(Draft { label, source, reads, writes: self.places[k], weights: 0..0, groups });
        Ok(())
    }

    /// Adds the step that brings the result of layer `k` to output `image`, if it is not there.
    fn export(&mut self, image: usize, k: usize) -> Result<(), GpuRunError> {
        let (to, layer) = (&self.outputs[image], &self.graph.layers()[k]);
        let (stored, factor) = match (self.places[k], &layer.op) {
            (Place::Fused, op) => (layer.inputs[0].index(), op.factor().unwrap_or(1)),
            _ => (k, 1),
        };
        let from = self.places[stored];
        if from == Place::Output(image) {
            return Ok(());
        }
        let (label, precision) = (format!("{}.export", layer.name), self.precision);
        let (source, count) = match to.format {
            ImageFormat::Blocks => {
                let identity = Op::Activate(Activation::Identity);
                let source = ops::map(&identity, &[to.shape], &[], to.shape, precision);
                (source, to.shape.pixels() * blocks(to.shape))
            }
            ImageFormat::Pixels | ImageFormat::HalfPixels => {
                let read = self.shapes[stored];
                (ops::export(read, factor, to.shape, to.format, precision), ops::words(to.shape, to.format))
            }
        };
        let groups = groups(&label, count)?;
        let writes = Place::Output(image);
        self.drafts.push(Draft { label, source, reads: vec![from], writes, weights: 0..0, groups });
        Ok(())
    }

    fn add_weights(&mut self, values: &[f32]) -> Range<u64> {
        self.weights.resize(self.weights.len().next_multiple_of(WEIGHT_ALIGNMENT), 0);
        let start = self.weights.len();
        for value in values {
            match self.precision {
                Precision::Single => self.weights.extend(value.to_le_bytes()),
                Precision::Half => self.weights.extend(half::f16::from_f32(*value).to_le_bytes()),
            }
        }
        start as u64..self.weights.len() as u64
    }

    /// Gives out buffers.
    fn finish(self) -> Result<Plan, GpuRunError> {
        let mut last_use = vec![0; self.shapes.len()];
        for (now, draft) in self.drafts.iter().enumerate() {
            for source in draft.reads.iter().chain([&draft.writes]) {
                if let Place::Tensor(k) = source {
                    last_use[*k] = now;
                }
            }
        }
        let mut slots = Slots::default();
        let mut slot_of = vec![None; self.shapes.len()];
        let mut steps = Vec::with_capacity(self.drafts.len());
        for (now, draft) in self.drafts.into_iter().enumerate() {
            if let Place::Tensor(k) = draft.writes {
                slot_of[k] = Some(slots.take(tensor_bytes(self.shapes[k], self.precision)));
            }
            let stored = |place: &Place| match place {
                Place::Input(image) => Some(Stored::Input(*image)),
                Place::Output(image) => Some(Stored::Output(*image)),
                Place::Tensor(k) => slot_of[*k].map(Stored::Slot),
                Place::Fused => None,
            };
            let missing = || GpuError::Refused {
                what: format!("planning layer {}", draft.label),
                message: "it reads what no step before it made".to_owned(),
            };
            let reads = draft.reads.iter().map(stored).collect::<Option<Vec<_>>>().ok_or_else(missing)?;
            let writes = stored(&draft.writes).ok_or_else(missing)?;
            // Only after its result has a buffer of its own may those that it reads be used again.
            for source in draft.reads.iter().chain([&draft.writes]) {
                if let Place::Tensor(k) = source
                    && last_use[*k] == now
                    && let Some(slot) = slot_of[*k].take()
                {
                    slots.give_back(slot);
                }
            }
            let Draft { label, source, weights, groups, .. } = draft;
            steps.push(Step { label, source, reads, writes, weights, groups });
        }
        let Self { weights, inputs, outputs, .. } = self;
        Ok(Plan { steps, slots: slots.bytes, weights, inputs, outputs })
    }
}

/// Workgroups for `count` invocations, which kernels count in u32 with a row of workgroups to spare.
fn groups(label: &str, count: usize) -> Result<[u32; 3], GpuError> {
    const MAX: u32 = u32::MAX - THREADS as u32 * gs3_compute::GRID_ROW;
    match u32::try_from(count) {
        Ok(count @ ..=MAX) => grid(count.div_ceil(THREADS as u32)),
        _ => Err(GpuError::TooLarge {
            what: format!("numbers of layer {label}"),
            max: MAX.into(),
            actual: count as u64,
        }),
    }
}

/// Whether there is a kernel for `op`. What only published single-image networks use runs on the CPU.
const fn is_known(op: &Op) -> bool {
    !matches!(
        op,
        Op::Prelu | Op::LayerNorm { .. } | Op::Scale { .. } | Op::Shift { .. } | Op::AveragePool { .. }
    )
}

#[cfg(test)]
mod tests;
