//! What is computed in which order, and where in the arena.

use super::Arithmetic;
use super::bf16::Bf16Convolution;
use super::block::Layout;
use super::conv::Convolution;
use super::learned::Learned;
use crate::graph::{Graph, Op, Tensor};
use crate::reference::parameter;
use crate::shape::Shape;
use crate::weights::Weights;

/// All steps of a network for one image size.
#[derive(Clone, Debug)]
pub struct Plan {
    pub steps: Vec<Step>,
    pub exports: Vec<Export>,
    /// Blocks of the arena.
    pub arena: usize,
}

/// One result that is stored.
#[derive(Clone, Debug)]
pub struct Step {
    pub kind: Kind,
    pub inputs: Vec<Layout>,
    pub out: Layout,
}

/// How a result is made.
#[derive(Clone, Debug)]
pub enum Kind {
    /// From the image of a layer, blocks of `factor`² pixels becoming channels.
    Import {
        layer: usize,
        factor: usize,
    },
    Convolution(Convolution),
    Bf16(Bf16Convolution),
    Learned(Learned),
    Row(Op),
}

/// A named result.
#[derive(Clone, Debug)]
pub struct Export {
    pub name: String,
    pub tensor: Layout,
    /// Blocks of `factor`² channels become pixels.
    pub factor: usize,
    /// Shape of the image.
    pub shape: Shape,
}

/// What reads each layer's result.
pub struct Readers<'a> {
    graph: &'a Graph,
    readers: Vec<Vec<usize>>,
    pub is_output: Vec<bool>,
}

impl<'a> Readers<'a> {
    pub fn new(graph: &'a Graph) -> Self {
        let count = graph.layers().len();
        let (mut readers, mut is_output) = (vec![Vec::new(); count], vec![false; count]);
        for (k, layer) in graph.layers().iter().enumerate() {
            layer.inputs.iter().for_each(|t| readers[t.index()].push(k));
        }
        graph.outputs().iter().for_each(|o| is_output[o.tensor.index()] = true);
        Self { graph, readers, is_output }
    }

    fn all_readers(&self, k: usize, f: impl Fn(&Op) -> bool) -> bool {
        self.readers[k].iter().all(|reader| f(&self.graph.layers()[*reader].op))
    }

    /// Whether the result of layer `k` need not be stored: convolutions read the parts of a concatenation, images are
    /// unshuffled while they come in and shuffled while they go out.
    pub fn is_fused(&self, k: usize) -> bool {
        let layer = &self.graph.layers()[k];
        match layer.op {
            Op::Concat => !self.is_output[k] && self.all_readers(k, |op| matches!(op, Op::Conv2d(_))),
            Op::Input { .. } => {
                let unshuffled = self.all_readers(k, |op| matches!(op, Op::PixelUnshuffle { .. }));
                !self.is_output[k] && unshuffled
            }
            Op::PixelShuffle { .. } => {
                self.is_output[k] && self.readers[k].is_empty() && layer.inputs.len() == 1
            }
            _ => false,
        }
    }

    /// The stored results that layer `k` reads.
    fn stored_inputs(&self, k: usize) -> Vec<Tensor> {
        let mut stored = Vec::new();
        for tensor in &self.graph.layers()[k].inputs {
            let layer = &self.graph.layers()[tensor.index()];
            match layer.op {
                Op::Concat if self.is_fused(tensor.index()) => stored.extend(&layer.inputs),
                Op::Input { .. } if self.is_fused(tensor.index()) => {}
                _ => stored.push(*tensor),
            }
        }
        stored
    }
}

impl Plan {
    /// The plan of `graph` with `weights`, which fit, for results of `shapes`.
    pub fn new(graph: &Graph, weights: &Weights, shapes: &[Shape], arithmetic: Arithmetic) -> Self {
        let readers = Readers::new(graph);
        let count = shapes.len();
        let (mut halos, mut last_use) = (vec![0; count], vec![0; count]);
        for (k, layer) in graph.layers().iter().enumerate() {
            for tensor in readers.stored_inputs(k) {
                let t = tensor.index();
                // What leaves the network stays to the end.
                last_use[t] =
                    last_use[t].max(if readers.is_fused(k) && readers.is_output[k] { count } else { k });
                if let Op::Conv2d(conv) = &layer.op {
                    halos[t] = conv.reach().max(halos[t]);
                }
            }
            if readers.is_output[k] {
                last_use[k] = count;
            }
        }
        let mut arena = Arena::default();
        let mut layouts: Vec<Layout> = shapes
            .iter()
            .zip(&halos)
            .map(|(shape, halo)| Layout { shape: *shape, halo: *halo, start: 0 })
            .collect();
        let mut steps = Vec::new();
        for (k, layer) in graph.layers().iter().enumerate() {
            if readers.is_fused(k) {
                continue;
            }
            layouts[k].start = arena.place(k, last_use[k], layouts[k].len());
            let inputs: Vec<Layout> = readers.stored_inputs(k).iter().map(|t| layouts[t.index()]).collect();
            let kind = match &layer.op {
                Op::Input { .. } => Kind::Import { layer: k, factor: 1 },
                Op::PixelUnshuffle { factor } if inputs.is_empty() => {
                    Kind::Import { layer: layer.inputs[0].index(), factor: *factor }
                }
                Op::Conv2d(conv) => {
                    let [weight, bias] = ["weight", "bias"].map(|kind| parameter(weights, &layer.name, kind));
                    let (border, inputs) = (graph.border(), &inputs[..]);
                    let bf16 = match arithmetic {
                        Arithmetic::F32 => None,
                        Arithmetic::Bf16 => Bf16Convolution::new(*conv, border, inputs, weight, bias),
                    };
                    match bf16 {
                        Some(convolution) => Kind::Bf16(convolution),
                        None => Kind::Convolution(Convolution::new(*conv, border, inputs, weight, bias)),
                    }
                }
                op => match Learned::new(op, &layer.name, weights) {
                    Some(learned) => Kind::Learned(learned),
                    None => Kind::Row(*op),
                },
            };
            steps.push(Step { kind, inputs, out: layouts[k] });
        }
        let exports = graph.outputs().iter().map(|output| {
            let k = output.tensor.index();
            let (stored, factor) = match &graph.layers()[k] {
                layer if readers.is_fused(k) => (layer.inputs[0].index(), layer.op.factor().unwrap_or(1)),
                _ => (k, 1),
            };
            Export { name: output.name.clone(), tensor: layouts[stored], factor, shape: shapes[k] }
        });
        Self { steps, exports: exports.collect(), arena: arena.len }
    }
}

/// Gives out places so that results that are needed at the same time do not overlap.
#[derive(Debug, Default)]
pub struct Arena {
    /// Start, length and last use of results, by start.
    taken: Vec<(usize, usize, usize)>,
    pub len: usize,
}

impl Arena {
    /// The first gap of `len` blocks, from step `now` to `last_use`.
    pub fn place(&mut self, now: usize, last_use: usize, len: usize) -> usize {
        self.taken.retain(|(_, _, last_use)| *last_use >= now);
        let mut start = 0;
        let mut position = 0;
        for (taken, length, _) in &self.taken {
            if start + len <= *taken {
                break;
            }
            start = taken + length;
            position += 1;
        }
        self.taken.insert(position, (start, len, last_use));
        self.len = self.len.max(start + len);
        start
    }
}
