//! What is computed in which order, and where in memory.

use super::Arithmetic;
use super::bf16::Bf16Convolution;
use super::block::{LANES, Layout, Room};
use super::conv::Convolution;
use super::exchange::Exchange;
use super::learned::Learned;
use super::nodes::{Made, Node, nodes};
use super::passes::Passes;
use crate::graph::{Graph, Op};
use crate::reference::parameter;
use crate::shape::Shape;
use crate::weights::Weights;

/// Pixels of a row that a thread computes together: so many that weights are loaded for enough of them, so few that what
/// is made of them stays in the first cache, where 64 channels take 12 KiB. Empirical.
const STRIP: usize = 48;

/// Strips are multiples of this, if images are wide enough: of all numbers of pixels whose sums convolutions keep in
/// registers, but one.
const MULTIPLE: usize = 12;

/// All that is computed for one image size.
#[derive(Clone, Debug)]
pub struct Plan {
    pub passes: Vec<Pass>,
    /// Shapes of the outputs, in the order of the graph.
    pub outputs: Vec<Shape>,
    /// Blocks of the arena.
    pub arena: usize,
    /// Blocks of a thread's scratch memory.
    pub scratch: usize,
}

/// What is computed in one go over the rows of images of one size.
#[derive(Clone, Debug)]
pub struct Pass {
    pub steps: Vec<Step>,
    pub height: usize,
    pub width: usize,
    /// Pixels of a strip.
    pub strip: usize,
    /// Where what it stores is in the arena.
    pub start: usize,
    /// Blocks of a row of all that it stores: rows of its tensors are side by side, so that threads can share them out.
    pub row_len: usize,
    /// The outputs that it writes, and numbers of their images for each row.
    pub exports: Vec<(usize, usize)>,
}

/// One result.
#[derive(Clone, Debug)]
pub struct Step {
    pub kind: Kind,
    pub inputs: Vec<Layout>,
    /// Its strip; of an export, of what it reads.
    pub out: Layout,
    /// Where it is stored whole, if it is.
    pub stored: Option<Layout>,
}

/// How a result is made.
#[derive(Clone, Debug)]
pub enum Kind {
    /// From images of layers.
    Import(Vec<(usize, Exchange)>),
    Convolution(Convolution),
    Bf16(Bf16Convolution),
    Learned(Learned),
    Row(Op),
    /// To one of the images of [`Pass::exports`].
    Export {
        export: usize,
        exchange: Exchange,
    },
}

/// Everything that steps are planned from.
struct Planner<'a> {
    graph: &'a Graph,
    weights: &'a Weights,
    arithmetic: Arithmetic,
    nodes: Vec<Node>,
    passes: Passes,
    /// Where nodes are stored that are.
    stored: Vec<Option<Layout>>,
}

impl Plan {
    /// The plan of `graph` with `weights`, which fit, for results of `shapes`.
    pub fn new(graph: &Graph, weights: &Weights, shapes: &[Shape], arithmetic: Arithmetic) -> Self {
        let nodes = nodes(graph, shapes);
        let passes = Passes::new(graph, &nodes);
        let stored = vec![None; nodes.len()];
        let mut planner = Planner { graph, weights, arithmetic, nodes, passes, stored };
        let (mut arena, mut scratch) = (Arena::default(), 0);
        let mut planned = Vec::new();
        for pass in 0..planner.passes.count {
            let (start, row_len) = planner.store(pass, &mut arena);
            planned.push(planner.pass(pass, start, row_len, &mut scratch));
        }
        let outputs = graph.outputs().iter().map(|output| shapes[output.tensor.index()]).collect();
        Self { passes: planned, outputs, arena: arena.len, scratch }
    }
}

impl Planner<'_> {
    fn members(&self, pass: usize) -> impl Iterator<Item = usize> {
        (0..self.nodes.len()).filter(move |n| self.passes.pass_of[*n] == Some(pass))
    }

    /// Gives what `pass` stores a place: its start, and the blocks of a row.
    fn store(&mut self, pass: usize, arena: &mut Arena) -> (usize, usize) {
        let members: Vec<usize> = self.members(pass).filter(|n| self.passes.is_stored(*n)).collect();
        let (mut len, mut row_len, mut last_use) = (0, 0, pass);
        for n in &members {
            let mut halo = 0;
            for reader in &self.passes.readers[*n] {
                halo = halo.max(self.nodes[reader.node].reach(self.graph));
                last_use = last_use.max(self.passes.pass_of[reader.node].unwrap_or(pass));
            }
            let layout = Layout::whole(self.nodes[*n].shape, halo, row_len);
            row_len += layout.row_len();
            len += layout.len();
            self.stored[*n] = Some(layout);
        }
        let start = arena.place(pass, last_use, len);
        for n in members {
            if let Some(layout) = &mut self.stored[n] {
                layout.start += start;
                layout.room = Room::Whole { beside: row_len - layout.row_len() };
            }
        }
        (start, row_len)
    }

    /// The images that node `n` only puts side by side, if that is what it does.
    fn joined(&self, n: usize) -> Option<Vec<(usize, Exchange)>> {
        let node = &self.nodes[n];
        let mut first = 0;
        let image = |input: &usize| {
            let Node { made, shape, .. } = &self.nodes[*input];
            match made {
                Made::Import { layer, factor: 1 } if self.passes.pass_of[*input].is_none() => {
                    let exchange = Exchange { first, ..Exchange::new(&Layout::whole(*shape, 0, 0), 1) };
                    first += shape.channels;
                    Some((*layer, exchange))
                }
                _ => None,
            }
        };
        (node.made == Made::Concat).then(|| node.inputs.iter().map(image).collect()).flatten()
    }

    /// The first block of the strip of node `n`'s input that `n` is a view of: a slice that needs no place of its own.
    fn view(&self, n: usize) -> Option<usize> {
        let (Made::Layer(layer), [input]) = (self.nodes[n].made, &self.nodes[n].inputs[..]) else {
            return None;
        };
        let Op::Slice { first, .. } = self.graph.layers()[layer].op else { return None };
        let is_strip = [self.passes.pass_of[n], None].contains(&self.passes.pass_of[*input]);
        let is_view = first.is_multiple_of(LANES) && is_strip && !self.passes.is_stored(n);
        is_view.then_some(first / LANES)
    }

    /// The last of `order` that reads the strip of node `n` or a view of it.
    fn last_use(&self, order: &[usize], n: usize) -> usize {
        let readers = order.iter().enumerate().filter(|(_, other)| self.nodes[**other].inputs.contains(&n));
        let last = readers.map(|(k, other)| match self.view(*other).is_some() {
            true => self.last_use(order, *other).max(k),
            false => k,
        });
        last.max().unwrap_or(0)
    }

    /// The steps of `pass`, whose strips lie in `scratch` blocks or more.
    fn pass(&self, pass: usize, start: usize, row_len: usize, scratch: &mut usize) -> Pass {
        let mut order = Vec::new();
        for n in self.members(pass) {
            if self.joined(n).is_none() {
                // Images that are imported wherever they are read.
                let is_new = |input: &usize| self.passes.pass_of[*input].is_none() && !order.contains(input);
                let images: Vec<usize> = self.nodes[n].inputs.iter().copied().filter(is_new).collect();
                order.extend(images);
            }
            order.push(n);
        }
        let size = order.first().map_or(Shape { height: 0, width: 0, channels: 0 }, |n| self.nodes[*n].shape);
        let count = size.width.div_ceil(STRIP).max(1);
        let strip = size.width.div_ceil(count).next_multiple_of(MULTIPLE).min(size.width);
        let mut planned = Pass {
            steps: Vec::new(),
            height: size.height,
            width: size.width,
            strip,
            start,
            row_len,
            exports: Vec::new(),
        };
        let mut arena = Arena::default();
        let mut strips: Vec<Option<Layout>> = vec![None; self.nodes.len()];
        for (now, n) in order.iter().enumerate() {
            let node = &self.nodes[*n];
            let last_use = self.last_use(&order, *n).max(now);
            let shape = Shape { width: strip, ..node.shape };
            let of = node.inputs.first().and_then(|input| strips[*input]);
            if let (Some(block), Some(of)) = (self.view(*n), of) {
                strips[*n] = Some(Layout { shape, start: of.start + block * strip, ..of });
                continue;
            }
            let is_export = matches!(node.made, Made::Export { .. });
            let len = if is_export { 0 } else { node.blocks() * strip };
            let place = arena.place(now, last_use, len);
            let out = Layout { shape, halo: 0, start: place, room: Room::Strip };
            strips[*n] = Some(out);
            let inputs: Vec<Layout> = node
                .inputs
                .iter()
                .enumerate()
                .filter_map(|(i, input)| match node.is_far(self.graph, i) {
                    true => self.stored[*input],
                    false => strips[*input].or(self.stored[*input]),
                })
                .collect();
            let kind = self.kind(*n, &inputs, strip, &mut planned.exports);
            planned.steps.push(Step { kind, inputs, out, stored: self.stored[*n] });
        }
        *scratch = arena.len.max(*scratch);
        planned
    }

    fn kind(&self, n: usize, inputs: &[Layout], strip: usize, exports: &mut Vec<(usize, usize)>) -> Kind {
        let node = &self.nodes[n];
        let whole = Layout::whole(node.shape, 0, 0);
        let layer = match node.made {
            Made::Import { layer, factor } => {
                return Kind::Import(vec![(layer, Exchange::new(&whole, factor))]);
            }
            Made::Export { output, factor } => {
                let exchange = Exchange::new(&whole, factor);
                exports.push((output, exchange.row_len()));
                return Kind::Export { export: exports.len() - 1, exchange };
            }
            Made::Concat => return self.joined(n).map_or(Kind::Row(Op::Concat), Kind::Import),
            Made::Layer(layer) => &self.graph.layers()[layer],
        };
        let Op::Conv2d(conv) = &layer.op else {
            return match Learned::new(&layer.op, &layer.name, self.weights) {
                Some(learned) => Kind::Learned(learned),
                None => Kind::Row(layer.op),
            };
        };
        let [weight, bias] = ["weight", "bias"].map(|kind| parameter(self.weights, &layer.name, kind));
        let border = self.graph.border();
        let bf16 = match self.arithmetic {
            Arithmetic::F32 => None,
            Arithmetic::Bf16 => Bf16Convolution::new(*conv, border, inputs, strip, weight, bias),
        };
        match bf16 {
            Some(convolution) => Kind::Bf16(convolution),
            None => Kind::Convolution(Convolution::new(*conv, border, inputs, weight, bias)),
        }
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
