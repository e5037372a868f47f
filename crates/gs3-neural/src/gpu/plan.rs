//! What is computed in which order and where, with all sizes and all WGSL: one pure function.

use std::ops::Range;

use gs3_compute::{GpuError, grid};

use super::conv::Convolution;
use super::conv_matrix::MatrixConvolution;
use super::export::{export, value_of};
use super::expression::{Expressions, Layout, Located, Place, Width};
use super::fuse::{Branch, Fusion, Role, Wanted, Work, parts};
use super::slots::Slots;
use super::source::{self, PARTS, THREADS, blocks, image_words, tensor_bytes};
use super::{GpuEngineSettings, GpuRunError, GpuTensorImage, ImageFormat, MatrixUnit, Precision};
use crate::error::RunError;
use crate::graph::{Conv2d, Graph, Op, Shape};
use crate::weights::Weights;

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
    pub inputs: Vec<GpuTensorImage>,
    pub outputs: Vec<GpuTensorImage>,
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
    /// Bytes that it reads and writes, each once.
    pub bytes: u64,
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

/// A step before buffers are given out.
struct Draft {
    label: String,
    source: String,
    reads: Vec<Place>,
    writes: Place,
    weights: Range<u64>,
    groups: [u32; 3],
    bytes: u64,
}

struct Planner<'a> {
    layout: Layout<'a>,
    roles: Vec<Role>,
    matrices: Option<MatrixUnit>,
    outputs: Vec<GpuTensorImage>,
    /// Bytes of each tensor, by the layer that it begins with.
    tensors: Vec<u64>,
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
        let image = |name: &str, layer: usize, format: ImageFormat| {
            let shape = shapes[layer];
            let bytes = match format {
                ImageFormat::Pixels | ImageFormat::HalfPixels => image_words(shape, format) as u64 * 4,
                ImageFormat::Blocks => tensor_bytes(shape, precision),
            };
            GpuTensorImage { name: name.to_owned(), shape, format, bytes }
        };
        // Inputs are all there, needed or not: what is given does not depend on what is asked for.
        let (mut inputs, mut input_of) = (Vec::new(), vec![None; shapes.len()]);
        for (tensor, layer) in graph.inputs() {
            let given = settings.inputs.iter().find(|(name, _)| *name == layer.name);
            let format = given.map_or(ImageFormat::default(), |(_, format)| *format);
            input_of[tensor.index()] = Some((inputs.len(), format));
            inputs.push(image(&layer.name, tensor.index(), format));
        }
        let outputs: Vec<GpuTensorImage> = wanted
            .iter()
            .map(|(output, format)| image(&output.name, output.tensor.index(), *format))
            .collect();
        // A layer is stored in one output at most: as blocks it is copied to others, and what is given is, too.
        let mut located = vec![None; shapes.len()];
        for (k, input) in input_of.iter().enumerate() {
            if let Some((input, ImageFormat::Blocks)) = input {
                located[k] = Some(Located { place: Place::Input(*input), first_block: 0 });
            }
        }
        let mut exports = Vec::new();
        for (number, (output, format)) in wanted.iter().enumerate() {
            let layer = output.tensor.index();
            match (format, located[layer]) {
                (ImageFormat::Blocks, None) => {
                    located[layer] = Some(Located { place: Place::Output(number), first_block: 0 });
                }
                _ => exports.push((number, layer)),
            }
        }
        let layers = |is: &dyn Fn(&Place) -> bool| -> Vec<usize> {
            let located = located.iter().enumerate();
            located.filter(|(_, l)| l.is_some_and(|l| is(&l.place))).map(|(k, _)| k).collect()
        };
        let fusion = Fusion::new(
            graph,
            &Wanted {
                as_blocks: &layers(&|place| matches!(place, Place::Output(_))),
                given: &layers(&|place| matches!(place, Place::Input(_))),
                exports: &exports.iter().map(|(_, layer)| *layer).collect::<Vec<_>>(),
                bytes: precision.bytes(),
            },
        );
        let mut planner = Planner {
            tensors: vec![0; shapes.len()],
            layout: Layout { graph, shapes, located, inputs: input_of, precision },
            roles: fusion.roles,
            matrices: settings.matrices,
            outputs,
            drafts: Vec::new(),
            weights: Vec::new(),
        };
        planner.locate(&fusion.works);
        for work in &fusion.works {
            match work {
                Work::Map(layer) => planner.map(*layer)?,
                Work::Convolve(branches) => planner.convolve(weights, branches)?,
                Work::Export(export) => planner.export(exports[*export])?,
            }
        }
        planner.finish(inputs)
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
    /// Decides where results are.
    fn locate(&mut self, works: &[Work]) {
        for work in works {
            let stored: Vec<usize> = match work {
                Work::Map(layer) => vec![*layer],
                Work::Convolve(branches) => branches.iter().map(Branch::stored).collect(),
                Work::Export(_) => continue,
            };
            let mut first_block = 0;
            for layer in &stored {
                let place = Place::Tensor(stored[0]);
                let (shape, precision) = (self.layout.shapes[*layer], self.layout.precision);
                self.layout.located[*layer].get_or_insert(Located { place, first_block });
                self.tensors[stored[0]] += tensor_bytes(shape, precision);
                first_block += blocks(shape);
            }
        }
    }

    /// Where the result of `layer`, which is stored, begins.
    fn place(&self, layer: usize) -> Place {
        self.layout.located[layer].map_or(Place::Tensor(layer), |located| located.place)
    }

    /// A step that makes the result of `layer`, which is no convolution, one block per invocation.
    fn map(&mut self, layer: usize) -> Result<(), GpuRunError> {
        let mut expressions = Expressions::new(&self.layout);
        let name = expressions.made(layer);
        let (shape, precision) = (self.layout.shapes[layer], self.layout.precision);
        let label = self.layout.graph.layers()[layer].name.clone();
        let draft = Draft {
            source: blocks_of(&source::header(precision), &expressions, &name, shape),
            reads: checked(&label, expressions.buffers)?,
            writes: self.place(layer),
            weights: 0..0,
            groups: groups(&label, shape.pixels() * blocks(shape))?,
            bytes: expressions.bytes + tensor_bytes(shape, precision),
            label,
        };
        self.drafts.push(draft);
        Ok(())
    }

    /// A step that makes the results of `branches`, convolutions of the same parts and what follows them.
    fn convolve(&mut self, weights: &Weights, branches: &[Branch]) -> Result<(), GpuRunError> {
        let Layout { graph, precision, .. } = self.layout;
        let first = branches[0].conv;
        let Op::Conv2d(conv) = graph.layers()[first].op else { return Ok(()) };
        let parts = parts(graph, &self.roles, first);
        let shapes: Vec<Shape> = parts.iter().map(|part| self.layout.shapes[*part]).collect();
        // Weights of an output channel.
        let taps = conv.kernel * conv.kernel * shapes.iter().map(|shape| shape.channels).sum::<usize>();
        let (mut weight, mut bias, mut labels) = (Vec::new(), Vec::new(), Vec::new());
        for branch in branches {
            let layer = &graph.layers()[branch.conv];
            weight.extend(weights.parameter(&layer.name, "weight"));
            bias.extend(weights.parameter(&layer.name, "bias"));
            bias.resize(weight.len() / taps, 0.0);
            labels.push(layer.name.as_str());
        }
        let label = labels.join(", ");
        let channels = branches.iter().map(|branch| self.layout.shapes[branch.conv].channels).sum();
        let conv = Conv2d { outputs: channels, ..conv };
        let out = Shape { channels, ..self.layout.shapes[first] };
        let mut expressions = Expressions::new(&self.layout);
        expressions.load(&parts);
        expressions.finish(conv.activation, branches);
        let border = graph.border();
        let unit = self.matrices.filter(|_| precision == Precision::Half);
        let in_matrices = unit.and_then(|unit| MatrixConvolution::new(conv, &shapes, out, unit));
        let (source, values, groups) = match in_matrices {
            Some(conv) => {
                (conv.source(border, &expressions.text), conv.weights(&weight, &bias), conv.groups())
            }
            None => {
                let is_computed = parts.iter().any(|part| self.layout.located[*part].is_none());
                let conv = Convolution::new(conv, &shapes, out, is_computed, precision);
                let source = conv.source(precision, border, &expressions.text);
                (source, conv.weights(&weight, &bias), conv.groups()?)
            }
        };
        let (reads, bytes) = (checked(&label, expressions.buffers)?, expressions.bytes);
        let draft = Draft {
            label,
            source,
            reads,
            writes: self.place(branches[0].stored()),
            weights: self.add_weights(&values),
            groups,
            bytes: bytes + tensor_bytes(out, precision),
        };
        self.drafts.push(draft);
        Ok(())
    }

    /// A step that brings the result of `layer` to an output.
    fn export(&mut self, (output, layer): (usize, usize)) -> Result<(), GpuRunError> {
        let mut expressions = Expressions::new(&self.layout);
        let name = expressions.layer(layer);
        let (shape, precision) = (self.layout.shapes[layer], self.layout.precision);
        let label = format!("{}.export", self.layout.graph.layers()[layer].name);
        let to = &self.outputs[output];
        let header = source::header(precision);
        let (text, count) = match to.format {
            ImageFormat::Blocks => {
                (blocks_of(&header, &expressions, &name, shape), shape.pixels() * blocks(shape))
            }
            ImageFormat::Pixels | ImageFormat::HalfPixels => {
                export(&header, &expressions, &name, shape, to.format)
            }
        };
        let draft = Draft {
            source: text,
            reads: checked(&label, expressions.buffers)?,
            writes: Place::Output(output),
            weights: 0..0,
            groups: groups(&label, count)?,
            bytes: expressions.bytes + to.bytes,
            label,
        };
        self.drafts.push(draft);
        Ok(())
    }

    fn add_weights(&mut self, values: &[f32]) -> Range<u64> {
        self.weights.resize(self.weights.len().next_multiple_of(WEIGHT_ALIGNMENT), 0);
        let start = self.weights.len();
        for value in values {
            match self.layout.precision {
                Precision::Single => self.weights.extend(value.to_le_bytes()),
                Precision::Half => self.weights.extend(half::f16::from_f32(*value).to_le_bytes()),
            }
        }
        start as u64..self.weights.len() as u64
    }

    /// Gives out buffers.
    fn finish(self, inputs: Vec<GpuTensorImage>) -> Result<Plan, GpuRunError> {
        let mut last_use = vec![0; self.tensors.len()];
        for (now, draft) in self.drafts.iter().enumerate() {
            for source in draft.reads.iter().chain([&draft.writes]) {
                if let Place::Tensor(k) = source {
                    last_use[*k] = now;
                }
            }
        }
        let mut slots = Slots::default();
        let mut slot_of = vec![None; self.tensors.len()];
        let mut steps = Vec::with_capacity(self.drafts.len());
        for (now, draft) in self.drafts.into_iter().enumerate() {
            if let Place::Tensor(k) = draft.writes {
                slot_of[k] = Some(slots.take(self.tensors[k]));
            }
            let stored = |place: &Place| match place {
                Place::Input(image) => Some(Stored::Input(*image)),
                Place::Output(image) => Some(Stored::Output(*image)),
                Place::Tensor(k) => slot_of[*k].map(Stored::Slot),
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
            let Draft { label, source, weights, groups, bytes, .. } = draft;
            steps.push(Step { label, source, reads, writes, weights, groups, bytes });
        }
        let Self { weights, outputs, .. } = self;
        Ok(Plan { steps, slots: slots.bytes, weights, inputs, outputs })
    }
}

/// The kernel of a tensor of `shape` from what `expressions` have as `name`, one block per invocation.
fn blocks_of(header: &str, expressions: &Expressions<'_>, name: &str, shape: Shape) -> String {
    let value = value_of(name, Width::Block);
    let (result, threads) = (source::result(shape), source::threads());
    [header, &result, &threads, &expressions.text, &value, include_str!("map.wgsl")].concat()
}

/// `buffers`, if a kernel can bind as many.
fn checked(layer: &str, buffers: Vec<Place>) -> Result<Vec<Place>, GpuError> {
    let max = PARTS.len();
    match buffers.len() <= max {
        true => Ok(buffers),
        false => Err(GpuError::TooLarge {
            what: format!("inputs of layer {layer}"),
            max: max as u64,
            actual: buffers.len() as u64,
        }),
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
