//! Which results are stored, and which are computed where they are read: a pure function of the graph.
//!
//! Networks on GPUs are mostly limited by memory and by the number of kernels. So a convolution's kernel also does
//! the pixel-by-pixel work on its result ([`Branch`]). Convolutions of the same inputs are one kernel. Every layer
//! that is no convolution may be computed by its readers, once per reader. The choice is found by descent: of all
//! changes that lower the bytes that a run reads and writes, the best is taken, until there is none.

use super::conv::TILE;
use super::source::{BLOCK, PARTS, blocks};
use crate::graph::{Conv2d, Graph, Op, Shape, Tensor};

/// Side of the LR grid that the choice is made for, at any size that is run: six poolings leave it whole.
const NOMINAL: usize = 64;

/// What one kernel more costs, bytes an LR pixel: it waits for those before it, about 2 µs, in which a card moves 2 to
/// 5 GB/ms, over the 0.5 M LR pixels of 4096×2160. From 1 to 16 the plans of our networks are the same.
const KERNEL_BYTES: f64 = 16.0;

/// What a byte costs that a kernel has read before: it comes from a cache, if not from a register.
const AGAIN: f64 = 0.25;

/// From how many ways to fuse a graph better ones are sought.
const STARTS: usize = 3;

/// How a layer's result comes about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// No layer reads it.
    Unused,
    /// It is given in the engine's own format.
    Given,
    /// A kernel of its own makes it, and it is stored.
    Stored,
    /// Each reader computes it, from its image if it is an input.
    Inlined,
    /// The kernel of the result that is made of it alone.
    Absorbed,
}

/// A convolution and the pixel-by-pixel work on its result: layers that each read the layer before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Branch {
    pub conv: usize,
    pub then: Vec<usize>,
}

impl Branch {
    /// The layer with the stored result.
    pub fn stored(&self) -> usize {
        self.then.last().copied().unwrap_or(self.conv)
    }

    /// What it reads besides the parts of its convolution.
    fn more<'a>(&'a self, graph: &'a Graph) -> impl Iterator<Item = usize> + 'a {
        let own = |k: usize| k == self.conv || self.then.contains(&k);
        self.then.iter().flat_map(|k| operands(graph, *k)).filter(move |k| !own(*k))
    }
}

/// A kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Work {
    /// Makes the result of a layer that is no convolution.
    Map(usize),
    /// Convolutions of the same parts, their results one after the other in one tensor.
    Convolve(Vec<Branch>),
    /// Makes an output, an image, by its number in what is wanted.
    Export(usize),
}

/// What is asked of a network.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// Layers that an output in the engine's own format is.
    pub as_blocks: &'a [usize],
    /// Layers that are given so.
    pub given: &'a [usize],
    /// Layers that outputs as images show.
    pub exports: &'a [usize],
    /// Bytes of a number of a tensor.
    pub bytes: u64,
}

/// What is made, in order, and what becomes of each layer.
#[derive(Clone, Debug)]
pub struct Fusion {
    pub roles: Vec<Role>,
    pub works: Vec<Work>,
}

/// What `layer` reads: the second input of some gives a size only.
pub fn operands(graph: &Graph, layer: usize) -> impl Iterator<Item = usize> + '_ {
    let layer = &graph.layers()[layer];
    let count = match layer.op {
        Op::PixelShuffle { .. } | Op::Upsample { .. } => 1,
        _ => layer.inputs.len(),
    };
    layer.inputs.iter().take(count).map(|tensor| tensor.index())
}

fn convolution(graph: &Graph, layer: usize) -> Option<Conv2d> {
    match graph.layers()[layer].op {
        Op::Conv2d(conv) => Some(conv),
        _ => None,
    }
}

/// The parts that convolution `conv` reads: the parts of a concatenation that is not stored.
pub fn parts(graph: &Graph, roles: &[Role], conv: usize) -> Vec<usize> {
    let flat = |k: usize| match (&graph.layers()[k].op, roles[k]) {
        (Op::Concat, Role::Inlined) => operands(graph, k).collect(),
        _ => vec![k],
    };
    operands(graph, conv).flat_map(flat).collect()
}

impl Fusion {
    /// The cheapest that is found for `graph`.
    pub fn new(graph: &Graph, wanted: &Wanted<'_>) -> Self {
        let mut search = Search::new(graph, wanted);
        search.merge();
        // A descent ends in the nearest minimum. So there are several starts, with more and more of the branches
        // moved into their convolutions.
        let mut best: Option<(f64, Search<'_>)> = None;
        for _ in 0..STARTS {
            let mut descent = search.clone();
            let cost = descent.descend();
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, descent));
            }
            let ends = search.branches().filter(|branch| search.next(branch).is_some());
            for conv in ends.map(|branch| branch.conv).collect::<Vec<_>>() {
                let mut longer = search.clone();
                longer.change(Change::Extend(conv));
                if longer.cost().is_finite() {
                    search = longer;
                }
            }
        }
        let search = best.map_or(search, |(_, best)| best);
        let works = search.ordered().unwrap_or_default();
        Self { roles: search.roles, works }
    }
}

/// A step from one way to fuse a graph to the next.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// A stored result is inlined, or the other way round.
    Flip(usize),
    /// The branch of that convolution goes on with the next layer.
    Extend(usize),
    /// It ends one layer earlier.
    Cut(usize),
}

/// A way to fuse a graph.
#[derive(Clone)]
struct Search<'a> {
    graph: &'a Graph,
    shapes: Vec<Shape>,
    wanted: &'a Wanted<'a>,
    roles: Vec<Role>,
    /// Convolutions of the same parts.
    groups: Vec<Vec<Branch>>,
}

impl<'a> Search<'a> {
    /// Every result stored, but for concatenations of more than a kernel can read.
    fn new(graph: &'a Graph, wanted: &'a Wanted<'a>) -> Self {
        let layers = graph.layers();
        let mut needed = vec![false; layers.len()];
        wanted.as_blocks.iter().chain(wanted.exports).for_each(|k| needed[*k] = true);
        for k in (0..layers.len()).rev() {
            if needed[k] && !wanted.given.contains(&k) {
                operands(graph, k).for_each(|operand| needed[operand] = true);
            }
        }
        let role = |k: usize| match layers[k].op {
            _ if !needed[k] => Role::Unused,
            _ if wanted.given.contains(&k) => Role::Given,
            Op::Concat if layers[k].inputs.len() > PARTS.len() => Role::Inlined,
            _ => Role::Stored,
        };
        let roles: Vec<Role> = (0..layers.len()).map(role).collect();
        let convs =
            (0..layers.len()).filter(|k| roles[*k] == Role::Stored && convolution(graph, *k).is_some());
        let groups = convs.map(|conv| vec![Branch { conv, then: Vec::new() }]).collect();
        // Sizes that the graph was built with.
        let shapes = graph.shapes([NOMINAL; 2]).unwrap_or_default();
        Self { graph, shapes, wanted, roles, groups }
    }

    /// Convolutions of the same inputs become one kernel.
    fn merge(&mut self) {
        let form = |branch: &Branch| {
            let conv = convolution(self.graph, branch.conv).map(|conv| Conv2d { outputs: 0, ..conv });
            let inputs = operands(self.graph, branch.conv);
            let parts = inputs.flat_map(|k| match self.graph.layers()[k].op {
                Op::Concat => operands(self.graph, k).collect(),
                _ => vec![k],
            });
            (conv, parts.collect::<Vec<_>>())
        };
        let forms: Vec<_> = self.groups.iter().map(|group| form(&group[0])).collect();
        let may = |group: &[Branch]| {
            let is_whole = |branch: &Branch| self.graph.channels(Tensor(branch.conv)).is_multiple_of(BLOCK);
            group.iter().all(|branch| is_whole(branch) && !self.wanted.as_blocks.contains(&branch.conv))
        };
        let may: Vec<bool> = self.groups.iter().map(|group| may(group)).collect();
        for last in (1..self.groups.len()).rev() {
            let same = |first: &usize| forms[*first] == forms[last] && may[*first] && may[last];
            let Some(first) = (0..last).rev().find(same) else { continue };
            let before = self.groups.clone();
            let later = std::mem::take(&mut self.groups[last]);
            self.groups[first].extend(later);
            if self.ordered().is_none() {
                self.groups = before;
            }
        }
        self.groups.retain(|group| !group.is_empty());
    }

    /// Makes the best change until none is any good; what it costs then.
    fn descend(&mut self) -> f64 {
        let mut cost = self.cost();
        loop {
            let mut best: Option<(f64, Self)> = None;
            for change in self.changes() {
                let mut changed = self.clone();
                changed.change(change);
                let cost = changed.cost();
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, changed));
                }
            }
            match best {
                Some((least, changed)) if least < cost => (cost, *self) = (least, changed),
                _ => return cost,
            }
        }
    }

    fn changes(&self) -> Vec<Change> {
        let is_free = |k: &usize| {
            matches!(self.roles[*k], Role::Stored | Role::Inlined)
                && convolution(self.graph, *k).is_none()
                && !self.wanted.as_blocks.contains(k)
                && self.branches().all(|branch| branch.then.last() != Some(k))
        };
        let flips = (0..self.roles.len()).filter(is_free).map(Change::Flip);
        let cuts = self.branches().filter(|branch| !branch.then.is_empty()).map(|b| Change::Cut(b.conv));
        let longer = self.branches().filter(|branch| self.next(branch).is_some());
        flips.chain(cuts).chain(longer.map(|branch| Change::Extend(branch.conv))).collect()
    }

    fn branches(&self) -> impl Iterator<Item = &Branch> {
        self.groups.iter().flatten()
    }

    fn change(&mut self, change: Change) {
        let (Change::Flip(k) | Change::Extend(k) | Change::Cut(k)) = change;
        if let Change::Flip(_) = change {
            self.roles[k] = if self.roles[k] == Role::Stored { Role::Inlined } else { Role::Stored };
            return;
        }
        let Some(mut branch) = self.branches().find(|branch| branch.conv == k).cloned() else { return };
        match change {
            Change::Extend(_) => {
                self.roles[branch.stored()] = Role::Absorbed;
                let next = self.next(&branch);
                branch.then.extend(next);
            }
            Change::Flip(_) | Change::Cut(_) => drop(branch.then.pop()),
        }
        self.roles[branch.stored()] = Role::Stored;
        let own = self.groups.iter_mut().flatten().find(|branch| branch.conv == k);
        own.into_iter().for_each(|own| own.clone_from(&branch));
    }

    /// What a branch may go on with: the only layer that reads its result, if it does so once, pixel by pixel and
    /// channel by channel, and is not the end of another branch.
    fn next(&self, branch: &Branch) -> Option<usize> {
        let stored = branch.stored();
        let is_output = self.wanted.as_blocks.contains(&stored) || self.wanted.exports.contains(&stored);
        let used = (0..self.roles.len()).filter(|r| !matches!(self.roles[*r], Role::Unused | Role::Given));
        let mut readers = used.flat_map(|r| operands(self.graph, r).filter(|o| *o == stored).map(move |_| r));
        let next = readers.next().filter(|_| !is_output && readers.next().is_none())?;
        let op = self.graph.layers()[next].op;
        let is_elementwise = matches!(op, Op::Activate(_) | Op::Add | Op::Multiply | Op::Mix);
        let is_free = self.branches().all(|branch| branch.stored() != next);
        // What several branches store lies in one tensor, which is no output's.
        let is_alone = self.groups.iter().any(|group| group.len() == 1 && group[0].conv == branch.conv);
        let may_store = is_alone || !self.wanted.as_blocks.contains(&next);
        let is_next = is_elementwise && is_free && may_store && self.shapes[next] == self.shapes[branch.conv];
        is_next.then_some(next)
    }

    /// What is to be done, each after what it reads, else in the order of the layers; none if there is no such order.
    fn ordered(&self) -> Option<Vec<Work>> {
        let mut works: Vec<(usize, Work)> = Vec::new();
        let is_branch = |k: usize| self.branches().any(|branch| branch.conv == k || branch.then.contains(&k));
        let maps = (0..self.roles.len()).filter(|k| self.roles[*k] == Role::Stored && !is_branch(*k));
        works.extend(maps.map(|k| (k, Work::Map(k))));
        let first = |group: &[Branch]| group.iter().map(Branch::stored).min().unwrap_or(0);
        let groups = self.groups.iter().filter(|group| !group.is_empty());
        works.extend(groups.map(|group| (first(group), Work::Convolve(group.clone()))));
        works.extend(self.wanted.exports.iter().enumerate().map(|(n, k)| (*k, Work::Export(n))));
        works.sort_by_key(|(layer, _)| *layer);
        let mut is_there: Vec<bool> = self.roles.iter().map(|role| *role == Role::Given).collect();
        let mut ordered = Vec::new();
        while !works.is_empty() {
            let ready = works.iter().position(|(_, work)| self.reads(work).all(|k| is_there[k]))?;
            let (_, work) = works.remove(ready);
            match &work {
                Work::Map(k) => is_there[*k] = true,
                Work::Convolve(group) => group.iter().for_each(|branch| is_there[branch.stored()] = true),
                Work::Export(_) => {}
            }
            ordered.push(work);
        }
        Some(ordered)
    }

    /// The stored results that `work` reads.
    fn reads(&self, work: &Work) -> impl Iterator<Item = usize> {
        let mut open: Vec<usize> = match work {
            Work::Map(k) => operands(self.graph, *k).collect(),
            Work::Convolve(group) => {
                let parts = parts(self.graph, &self.roles, group[0].conv).into_iter();
                parts.chain(group.iter().flat_map(|branch| branch.more(self.graph))).collect()
            }
            Work::Export(number) => vec![self.wanted.exports[*number]],
        };
        let mut stored = Vec::new();
        while let Some(k) = open.pop() {
            match self.roles[k] {
                Role::Inlined => open.extend(operands(self.graph, k)),
                _ => stored.push(k),
            }
        }
        stored.into_iter()
    }

    /// Bytes an LR pixel that a run reads and writes, and what its kernels cost; infinite where it cannot be run.
    fn cost(&self) -> f64 {
        let Some(works) = self.ordered() else { return f64::INFINITY };
        works.iter().map(|work| KERNEL_BYTES + self.cost_of(work)).sum()
    }

    fn cost_of(&self, work: &Work) -> f64 {
        let mut reads = Vec::new();
        let written = match work {
            Work::Map(k) if matches!(self.graph.layers()[*k].op, Op::Input { .. }) => {
                self.image(*k) + self.stored(*k)
            }
            Work::Map(k) => {
                self.add_made(*k, 1.0, &mut reads);
                self.stored(*k)
            }
            Work::Export(number) => {
                let k = self.wanted.exports[*number];
                self.add_read(k, 1.0, &mut reads);
                self.image(k)
            }
            Work::Convolve(group) => {
                let reach = convolution(self.graph, group[0].conv).map_or(0, |conv| conv.reach());
                // A tile is staged with its margin.
                let margin = 1.0 + 2.0 * reach as f64 / TILE as f64;
                let parts = parts(self.graph, &self.roles, group[0].conv);
                parts.iter().for_each(|k| self.add_read(*k, margin * margin, &mut reads));
                let more = group.iter().flat_map(|branch| branch.more(self.graph));
                more.for_each(|k| self.add_read(k, 1.0, &mut reads));
                group.iter().map(|branch| self.stored(branch.stored())).sum()
            }
        };
        let mut buffers: Vec<usize> = reads.iter().map(|(k, _)| self.buffer(*k)).collect();
        buffers.sort_unstable();
        buffers.dedup();
        let cost = |(k, times): &(usize, f64)| {
            let whole = if self.roles[*k] == Role::Inlined { self.image(*k) } else { self.stored(*k) };
            whole * (times.min(1.0) + (times - 1.0).max(0.0) * AGAIN)
        };
        match buffers.len() <= PARTS.len() {
            true => written + reads.iter().map(cost).sum::<f64>(),
            false => f64::INFINITY,
        }
    }

    /// The first layer of the tensor that stored layer `k` is in, or the input that it is.
    fn buffer(&self, k: usize) -> usize {
        let in_one = |group: &&Vec<Branch>| group.iter().any(|branch| branch.stored() == k);
        self.groups.iter().find(in_one).map_or(k, |group| group[0].stored())
    }

    fn per_pixel(&self, k: usize) -> f64 {
        self.shapes[k].pixels() as f64 / (NOMINAL * NOMINAL) as f64
    }

    fn stored(&self, k: usize) -> f64 {
        self.per_pixel(k) * (blocks(self.shapes[k]) * BLOCK) as f64 * self.wanted.bytes as f64
    }

    /// As if images were of the tensors' precision.
    fn image(&self, k: usize) -> f64 {
        self.per_pixel(k) * self.shapes[k].channels as f64 * self.wanted.bytes as f64
    }

    /// Adds what is read where all numbers of layer `k` are looked at `times` times: layers and how often.
    fn add_read(&self, k: usize, times: f64, reads: &mut Vec<(usize, f64)>) {
        let is_image = matches!(self.graph.layers()[k].op, Op::Input { .. });
        if self.roles[k] == Role::Inlined && !is_image {
            return self.add_made(k, times, reads);
        }
        match reads.iter_mut().find(|(read, _)| *read == k) {
            Some((_, all)) => *all += times,
            None => reads.push((k, times)),
        }
    }

    /// Adds what is read to compute all numbers of layer `k` `times` times.
    fn add_made(&self, k: usize, times: f64, reads: &mut Vec<(usize, f64)>) {
        let op = &self.graph.layers()[k].op;
        for (number, operand) in operands(self.graph, k).enumerate() {
            let each = match op {
                Op::Slice { count, .. } => *count as f64 / self.shapes[operand].channels as f64,
                Op::Warp if number == 0 => 4.0,
                Op::Upsample { factor } => (factor * factor) as f64,
                _ => 1.0,
            };
            self.add_read(operand, each * times, reads);
        }
    }
}
