//! What is computed of a graph: its layers but those that only rearrange what convolutions read and images bring.

use super::block::LANES;
use crate::graph::{Graph, Layer, Op, Shape, Tensor};

/// Something to compute.
#[derive(Clone, Debug)]
pub struct Node {
    pub made: Made,
    /// The nodes that it reads the results of.
    pub inputs: Vec<usize>,
    /// Of its result; of an export, of what it reads.
    pub shape: Shape,
}

/// How a result is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Made {
    /// From the image of a layer, blocks of `factor`² pixels becoming channels.
    Import { layer: usize, factor: usize },
    /// As the layer says.
    Layer(usize),
    /// Narrow inputs of a convolution side by side.
    Concat,
    /// To the image of an output, blocks of `factor`² channels becoming pixels.
    Export { output: usize, factor: usize },
}

impl Node {
    /// Blocks of channels of its result.
    pub fn blocks(&self) -> usize {
        self.shape.channels.div_ceil(LANES)
    }

    /// Whether it reads other pixels of its input `i` than the one that it makes, an image from outside not counting
    /// if it is read where it lies.
    pub fn is_far(&self, graph: &Graph, nodes: &[Self], i: usize) -> bool {
        let Made::Layer(layer) = self.made else { return false };
        match &graph.layers()[layer].op {
            Op::Conv2d(conv) => conv.reach() > 0,
            Op::Warp => i == 0 && !nodes[self.inputs[0]].is_whole_image(),
            Op::PixelShuffle { .. }
            | Op::PixelUnshuffle { .. }
            | Op::Upsample { .. }
            | Op::MaxPool2
            | Op::AveragePool { .. } => true,
            _ => false,
        }
    }

    /// Whether it is an image of whole blocks of channels.
    pub fn is_whole_image(&self) -> bool {
        matches!(self.made, Made::Import { factor: 1, .. }) && self.shape.channels.is_multiple_of(LANES)
    }

    /// Whether it warps an image where that lies: the image's layer.
    pub fn warped_image(&self, graph: &Graph, nodes: &[Self]) -> Option<usize> {
        let (Made::Layer(layer), [image, _]) = (self.made, &self.inputs[..]) else { return None };
        match (graph.layers()[layer].op, nodes[*image].made) {
            (Op::Warp, Made::Import { layer, .. }) if nodes[*image].is_whole_image() => Some(layer),
            _ => None,
        }
    }

    /// Pixels that it sees beside the row of its inputs.
    pub fn reach(&self, graph: &Graph) -> usize {
        match self.made {
            Made::Layer(layer) => match &graph.layers()[layer].op {
                Op::Conv2d(conv) => conv.reach(),
                _ => 0,
            },
            _ => 0,
        }
    }
}

/// The nodes of `graph` for results of `shapes`, each after those that it reads.
pub fn nodes(graph: &Graph, shapes: &[Shape]) -> Vec<Node> {
    let readers = Readers::new(graph);
    let mut nodes: Vec<Node> = Vec::new();
    // Of layers that are fused, nothing reads this.
    let mut node_of = vec![0; shapes.len()];
    for (k, layer) in graph.layers().iter().enumerate().filter(|(k, _)| !readers.is_fused(*k)) {
        let inputs = match (&layer.op, &layer.inputs[..]) {
            (Op::Conv2d(_), [input]) if readers.is_fused(input.index()) => {
                let parts = &graph.layers()[input.index()].inputs;
                with_narrow_parts_joined(&mut nodes, parts.iter().map(|t| node_of[t.index()]).collect())
            }
            (op, all) => {
                let factor = factor(op).and_then(|input| Some((input, repeated(graph, shapes, all[input])?)));
                let input = |(k, t): (usize, &Tensor)| match factor {
                    Some((input, tensor)) if input == k => tensor,
                    _ => *t,
                };
                let inputs = read(layer).iter().enumerate().map(input);
                inputs.filter(|t| !readers.is_fused(t.index())).map(|t| node_of[t.index()]).collect()
            }
        };
        let made = match &layer.op {
            Op::Input { .. } => Made::Import { layer: k, factor: 1 },
            Op::PixelUnshuffle { factor } if inputs.is_empty() => {
                Made::Import { layer: layer.inputs[0].index(), factor: *factor }
            }
            _ => Made::Layer(k),
        };
        node_of[k] = nodes.len();
        nodes.push(Node { made, inputs, shape: shapes[k] });
    }
    for (output, tensor) in graph.outputs().iter().map(|output| output.tensor.index()).enumerate() {
        let (read, factor) = match &graph.layers()[tensor] {
            layer if readers.is_fused(tensor) => (layer.inputs[0].index(), layer.op.factor().unwrap_or(1)),
            _ => (tensor, 1),
        };
        let made = Made::Export { output, factor };
        // Whole blocks side by side are read where they lie.
        let inputs = match &graph.layers()[read] {
            Layer { op: Op::Concat, inputs, .. } if inputs.iter().all(|t| is_whole(&shapes[t.index()])) => {
                inputs.iter().map(|t| node_of[t.index()]).collect()
            }
            _ => vec![node_of[read]],
        };
        nodes.push(Node { made, inputs, shape: shapes[read] });
    }
    nodes
}

/// Whether an image is whole blocks of channels.
fn is_whole(shape: &Shape) -> bool {
    shape.channels.is_multiple_of(LANES)
}

/// Which input of an operation may have fewer blocks of channels than its result, that then count for the others too.
fn factor(op: &Op) -> Option<usize> {
    match op {
        Op::Multiply => Some(1),
        Op::Mix => Some(2),
        _ => None,
    }
}

/// The tensor of whole blocks that `tensor` is, again and again, if it is.
fn repeated(graph: &Graph, shapes: &[Shape], tensor: Tensor) -> Option<Tensor> {
    let Layer { op: Op::Concat, inputs, .. } = &graph.layers()[tensor.index()] else { return None };
    let first = *inputs.first()?;
    (is_whole(&shapes[first.index()]) && inputs.iter().all(|t| *t == first)).then_some(first)
}

/// The inputs that a layer reads numbers of, not only the size.
fn read(layer: &Layer) -> &[Tensor] {
    match layer.op {
        Op::PixelShuffle { .. } | Op::Upsample { .. } => &layer.inputs[..1],
        _ => &layer.inputs,
    }
}

/// A convolution's inputs. Consecutive inputs with less than a block of channels are joined: they then take less
/// memory, and the kernel has fewer and longer loops.
fn with_narrow_parts_joined(nodes: &mut Vec<Node>, parts: Vec<usize>) -> Vec<usize> {
    let mut inputs = Vec::new();
    let mut rest = &parts[..];
    while let [first, ..] = rest {
        let narrow = rest.iter().take_while(|part| nodes[**part].shape.channels < LANES).count();
        let (run, others) = rest.split_at(narrow.max(1));
        rest = others;
        let is_same = |node: &Node| node.made == Made::Concat && node.inputs == run;
        inputs.push(match nodes.iter().position(is_same) {
            _ if run.len() == 1 => *first,
            Some(same) => same,
            None => {
                let channels = run.iter().map(|part| nodes[*part].shape.channels).sum();
                let shape = Shape { channels, ..nodes[*first].shape };
                nodes.push(Node { made: Made::Concat, inputs: run.to_vec(), shape });
                nodes.len() - 1
            }
        });
    }
    inputs
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
}
