//! What is computed in which order, and where in memory.

use std::ops::Range;

use super::Arithmetic;
use super::bf16::{Bf16Convolution, Tiles, Unit};
use super::block::{LANES, Layout, Numbers, Storage};
use super::conv::{Convolution, Source};
use super::exchange::Exchange;
use super::learned::Learned;
use super::nodes::{Made, Node, nodes};
use super::ops::updates;
use super::passes::{Passes, Reader, Wave};
use super::thin::ThinConvolution;
use crate::graph::{Graph, Op, Shape};
use crate::weights::Weights;

/// Pixels of a row that a thread computes together: so many that weights are loaded for enough of them, so few that
/// what is made of them stays in the first cache, where 64 channels take 12 KiB. Empirical.
const STRIP: usize = 48;

/// Strips are multiples of this value, if images are wide enough: a multiple of all but one of the numbers of pixels
/// with sums in registers.
const MULTIPLE: usize = 12;

/// All that is computed for one image size.
#[derive(Clone, Debug)]
pub struct Plan {
    pub groups: Vec<Group>,
    /// Parts into which rows are divided, for threads to compute side by side.
    pub slabs: usize,
    /// Shapes of the outputs, in the order of the graph.
    pub outputs: Vec<Shape>,
    /// Blocks of the arena.
    pub arena: usize,
    /// Blocks of the rows that a slab keeps.
    pub ring: usize,
    /// Blocks of a thread's scratch memory.
    pub scratch: usize,
}

/// Passes that go over the rows of images of one size together.
#[derive(Clone, Debug)]
pub struct Group {
    pub passes: Vec<Pass>,
    pub height: usize,
    pub width: usize,
    /// Where what it stores for other groups is in the arena.
    pub start: usize,
    /// Blocks of a row of all of that: rows of its tensors are side by side, so that threads can share them out.
    pub row_len: usize,
    /// The outputs that it writes, and numbers of their images for each row.
    pub exports: Vec<(usize, usize)>,
}

/// What is computed in one go over the rows of images of one size.
#[derive(Clone, Debug)]
pub struct Pass {
    pub steps: Vec<Step>,
    /// Pixels of a strip.
    pub strip: usize,
    pub wave: Wave,
    /// Whether to prefetch the images of the next strip while one is computed.
    pub prefetches: bool,
    /// Place of the rows that it keeps for passes of the group, among the rows of a slab.
    pub start: usize,
    /// Blocks of such a row, of all of its tensors.
    pub row_len: usize,
    /// Bits of a row's number that tell its place.
    pub mask: usize,
}

/// One result.
#[derive(Clone, Debug)]
pub struct Step {
    pub kind: Kind,
    pub inputs: Vec<Layout>,
    /// Its strip; of an export, of what it reads.
    pub out: Layout,
    /// Where it is kept for passes of the group, if it is.
    pub kept: Option<Layout>,
    /// Where it is stored whole, if it is.
    pub stored: Option<Layout>,
}

impl Step {
    /// Blocks of its strip.
    pub fn len(&self) -> usize {
        if matches!(self.kind, Kind::Export { .. }) { 0 } else { self.out.row_len() }
    }
}

/// How a result is made.
#[derive(Clone, Debug)]
pub enum Kind {
    /// From images of layers.
    Import(Vec<(usize, Exchange)>),
    Convolution(Convolution),
    Bf16(Bf16Convolution),
    Thin(ThinConvolution),
    Learned(Learned),
    Row(Op),
    /// A warp of the image of a layer, where that lies.
    WarpImage {
        image: usize,
    },
    /// To one of the images of [`Group::exports`].
    Export {
        export: usize,
        exchange: Exchange,
    },
}

/// Everything that steps are planned from.
struct Planner<'a> {
    graph: &'a Graph,
    weights: &'a Weights,
    /// What multiplies bf16, if anything is to.
    unit: Option<Unit>,
    nodes: Vec<Node>,
    passes: Passes,
    /// Where nodes are kept that are.
    kept: Vec<Option<Layout>>,
    /// Where nodes are stored that are.
    stored: Vec<Option<Layout>>,
}

impl Plan {
    /// The plan of `graph` with `weights`, which fit, for results of `shapes`. It is made for a number of threads,
    /// but runs on any.
    pub fn new(
        graph: &Graph,
        weights: &Weights,
        shapes: &[Shape],
        arithmetic: Arithmetic,
        threads: usize,
    ) -> Self {
        let nodes = nodes(graph, shapes);
        let slabs = threads.max(1);
        let passes = Passes::new(graph, &nodes, slabs);
        let [kept, stored] = [0, 1].map(|_| vec![None; nodes.len()]);
        let unit = match arithmetic {
            Arithmetic::F32 => None,
            Arithmetic::Bf16 => Unit::best(),
        };
        let mut planner = Planner { graph, weights, unit, nodes, passes, kept, stored };
        let (mut arena, mut ring, mut scratch) = (Arena::default(), 0, 0);
        let mut groups = Vec::new();
        for (k, passes) in planner.passes.groups.clone().into_iter().enumerate() {
            let mut group = planner.store(k, &passes, &mut arena);
            let mut start = 0;
            for pass in passes {
                let place = planner.keep(pass, &mut start);
                let planned = planner.pass(pass, place, &mut group.exports, &mut scratch);
                group.passes.push(planned);
            }
            ring = start.max(ring);
            groups.push(group);
        }
        let outputs = graph.outputs().iter().map(|output| shapes[output.tensor.index()]).collect();
        Self { groups, slabs, outputs, arena: arena.len, ring, scratch }
    }
}

impl Planner<'_> {
    fn members(&self, pass: usize) -> impl Iterator<Item = usize> {
        (0..self.nodes.len()).filter(move |n| self.passes.pass_of[*n] == Some(pass))
    }

    /// Gives what passes of group `k` store for others a place.
    fn store(&mut self, k: usize, passes: &Range<usize>, arena: &mut Arena) -> Group {
        let members: Vec<usize> = passes.clone().flat_map(|pass| self.members(pass)).collect();
        let size =
            members.first().map_or(Shape { height: 0, width: 0, channels: 0 }, |n| self.nodes[*n].shape);
        let stored: Vec<usize> = members.into_iter().filter(|n| self.passes.is_stored(*n)).collect();
        let (mut row_len, mut last_group) = (0, k);
        for n in &stored {
            let of_reader = |reader: &Reader| self.passes.pass_of[reader.node];
            let readers = self.passes.readers[*n].iter().filter_map(of_reader);
            last_group = readers.map(|pass| self.passes.group_of(pass)).fold(last_group, usize::max);
            let layout = self.layout(*n, row_len);
            row_len += layout.row_len();
            self.stored[*n] = Some(layout);
        }
        let start = arena.place(k, last_group, size.height * row_len);
        for n in stored {
            if let Some(layout) = &mut self.stored[n] {
                layout.start += start;
                layout.room = Storage::Whole { beside: row_len - layout.row_len() };
            }
        }
        let Shape { height, width, .. } = size;
        Group { passes: Vec::new(), height, width, start, row_len, exports: Vec::new() }
    }

    /// Gives the rows that `pass` keeps for passes of its group a place from `start` on, and moves `start` behind it.
    /// Returns the start, the blocks of a row, and the bits of a row's number that determine its place.
    fn keep(&mut self, pass: usize, start: &mut usize) -> [usize; 3] {
        let members: Vec<usize> = self.members(pass).filter(|n| self.passes.is_kept(*n)).collect();
        let rows = self.passes.waves[pass].kept.next_power_of_two();
        let mut row_len = 0;
        for n in &members {
            let layout = self.layout(*n, *start + row_len);
            row_len += layout.row_len();
            self.kept[*n] = Some(layout);
        }
        for n in members {
            if let Some(layout) = &mut self.kept[n] {
                layout.room = Storage::Ring { beside: row_len - layout.row_len(), mask: rows - 1 };
            }
        }
        let place = [*start, row_len, rows - 1];
        *start += rows * row_len;
        place
    }

    /// Rows of node `n` with as much beside them as its readers see.
    fn layout(&self, n: usize, start: usize) -> Layout {
        let readers = self.passes.readers[n].iter();
        let halo = readers.map(|reader| self.nodes[reader.node].reach(self.graph)).max().unwrap_or(0);
        Layout { numbers: self.numbers(n), ..Layout::whole(self.nodes[n].shape, halo, start) }
    }

    /// How node `n` is stored: rounded, if all that read it from where it is stored would round it.
    fn numbers(&self, n: usize) -> Numbers {
        let mut readers = self.passes.readers[n]
            .iter()
            .filter(|reader| reader.is_far || self.passes.pass_of[reader.node] != self.passes.pass_of[n]);
        match readers.all(|reader| self.is_on_tiles(reader.node)) {
            true => Numbers::Bf16,
            false => Numbers::F32,
        }
    }

    /// Whether node `n` is a convolution that runs on tiles.
    fn is_on_tiles(&self, n: usize) -> bool {
        let node = &self.nodes[n];
        let Made::Layer(layer) = node.made else { return false };
        let Op::Conv2d(conv) = &self.graph.layers()[layer].op else { return false };
        let (strip, unit) = (strip(node.shape.width), self.unit.filter(|unit| *unit == Unit::Amx));
        let channels = node.inputs.iter().map(|input| self.nodes[*input].shape.channels);
        unit.is_some() && !ThinConvolution::takes(conv, strip) && Tiles::takes(conv, channels, strip)
    }

    /// The inputs of node `n` that it does not read from images where these lie.
    fn strips(&self, n: usize) -> &[usize] {
        let inputs = &self.nodes[n].inputs[..];
        match self.joined(n).is_some() {
            true => &[],
            false if self.nodes[n].warped_image(self.graph, &self.nodes).is_some() => &inputs[1..],
            false => inputs,
        }
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
        let is_whole = self.passes.is_kept(n) || self.passes.is_stored(n);
        let is_view = first.is_multiple_of(LANES) && is_strip && !is_whole;
        is_view.then_some(first / LANES)
    }

    /// Where a node of `pass` reads the result of node `input`, if not from a strip.
    fn elsewhere(&self, pass: usize, input: usize) -> Option<Layout> {
        let group = |pass: usize| self.passes.group_of(pass);
        match self.passes.pass_of[input].is_some_and(|of_input| group(of_input) == group(pass)) {
            true => self.kept[input],
            false => self.stored[input],
        }
    }

    /// The node with the strip that node `n` writes to, as a whole or in part.
    fn owner(&self, n: usize) -> usize {
        match self.view(n) {
            Some(_) => self.owner(self.nodes[n].inputs[0]),
            None => n,
        }
    }

    /// The last of `order` that reads the strip of node `n` or a view of it.
    fn last_use(&self, order: &[usize], n: usize) -> usize {
        let readers = order.iter().enumerate().filter(|(_, other)| self.strips(**other).contains(&n));
        let last = readers.map(|(k, other)| match self.view(*other).is_some() {
            true => self.last_use(order, *other).max(k),
            false => k,
        });
        last.max().unwrap_or(0)
    }

    /// The input of node `order[now]` with a strip that can become the result's: as large, and not read by any other
    /// node from then on.
    fn updated(&self, order: &[usize], now: usize) -> Option<usize> {
        let n = order[now];
        let node = &self.nodes[n];
        let Made::Layer(layer) = node.made else { return None };
        (0..updates(&self.graph.layers()[layer].op)).find(|i| {
            let input = node.inputs[*i];
            order.contains(&input)
                && self.view(input).is_none()
                && self.nodes[input].blocks() == node.blocks()
                && node.inputs.iter().filter(|other| self.owner(**other) == input).count() == 1
                && self.last_use(order, input) == now
        })
    }

    /// The steps of `pass`; its strips lie in `scratch` blocks or more.
    fn pass(
        &self,
        pass: usize,
        [start, row_len, mask]: [usize; 3],
        exports: &mut Vec<(usize, usize)>,
        scratch: &mut usize,
    ) -> Pass {
        let mut order = Vec::new();
        for n in self.members(pass) {
            // Images that are imported wherever they are read.
            for input in self.strips(n) {
                if self.passes.pass_of[*input].is_none() && !order.contains(input) {
                    order.push(*input);
                }
            }
            order.push(n);
        }
        let size = order.first().map_or(Shape { height: 0, width: 0, channels: 0 }, |n| self.nodes[*n].shape);
        let strip = strip(size.width);
        let wave = self.passes.waves[pass];
        // Gains 3 to 6 % of a network on Zen 4 (`docs/performance.md`). On Granite Rapids, which runs tiles, it cost
        // up to a tenth.
        let prefetches = self.unit == Some(Unit::Avx512Bf16);
        let mut planned = Pass { steps: Vec::new(), strip, wave, prefetches, start, row_len, mask };
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
            let updated = self.updated(&order, now);
            let is_export = matches!(node.made, Made::Export { .. });
            let len = if is_export { 0 } else { node.blocks() * strip };
            let place = match updated.and_then(|input| strips[node.inputs[input]]) {
                Some(strip) => arena.keep(strip.start, last_use),
                None => arena.place(now, last_use, len),
            };
            let out = Layout { shape, halo: 0, start: place, room: Storage::Strip, numbers: Numbers::F32 };
            strips[*n] = Some(out);
            let is_far = |i: usize| node.is_far(self.graph, &self.nodes, i);
            let layout = |(i, input): (usize, &usize)| match is_far(i) {
                true => self.elsewhere(pass, *input),
                false => strips[*input].or(self.elsewhere(pass, *input)),
            };
            let first = node.inputs.len() - self.strips(*n).len();
            let mut inputs: Vec<Layout> =
                node.inputs.iter().enumerate().skip(first).filter_map(layout).collect();
            if let Some(input) = updated {
                inputs.swap(0, input);
            }
            let kind = self.kind(*n, &inputs, strip, exports);
            planned.steps.push(Step { kind, inputs, out, kept: self.kept[*n], stored: self.stored[*n] });
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
            if let Some(image) = node.warped_image(self.graph, &self.nodes) {
                return Kind::WarpImage { image };
            }
            return match Learned::new(&layer.op, &layer.name, self.weights) {
                Some(learned) => Kind::Learned(learned),
                None => Kind::Row(layer.op),
            };
        };
        let [weight, bias] = ["weight", "bias"].map(|kind| self.weights.parameter(&layer.name, kind));
        let border = self.graph.border();
        let source = Source { conv: *conv, border, inputs, width: strip, weights: weight, bias };
        if let Some(thin) = ThinConvolution::new(&source) {
            return Kind::Thin(thin);
        }
        match self.unit.and_then(|unit| Bf16Convolution::new(unit, &source)) {
            Some(convolution) => Kind::Bf16(convolution),
            None => {
                // Nothing else reads what is stored in bf16: `numbers` stores so only what `is_on_tiles` says is read
                // by tiles.
                debug_assert!(inputs.iter().all(|input| input.numbers == Numbers::F32), "{}", layer.name);
                Kind::Convolution(Convolution::new(*conv, border, inputs, weight, bias))
            }
        }
    }
}

/// Pixels of a strip of rows of `width`.
fn strip(width: usize) -> usize {
    let count = width.div_ceil(STRIP).max(1);
    width.div_ceil(count).next_multiple_of(MULTIPLE).min(width)
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

    /// The place `start`, which stays taken until `last_use`.
    pub fn keep(&mut self, start: usize, last_use: usize) -> usize {
        let of_place = self.taken.iter_mut().filter(|(taken, ..)| *taken == start);
        of_place.for_each(|(_, _, until)| *until = last_use);
        start
    }
}
