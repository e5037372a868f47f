//! Which nodes are computed together, row by row.
//!
//! A pass goes over the rows of images of one size once. What its nodes make of a pixel, its other nodes read from the
//! first cache; only what a later pass reads, or a node that sees other pixels, is stored whole. So a node belongs to
//! the first pass after those that make what it sees of other pixels, or to a later one where it saves memory. Images
//! are read in each pass anew, unless other pixels of them are seen.

use std::cmp::Reverse;
use std::ops::Range;

use super::nodes::{Made, Node};
use crate::graph::Graph;

/// Most images that a group writes.
pub const EXPORTS: usize = 4;

/// The part of a thread's rows that a pass may compute above them, and below, again: another thread computes them
/// too, which takes less time than waiting for each other.
const SHARE: usize = 8;

/// What reads a node's result.
#[derive(Clone, Copy, Debug)]
pub struct Reader {
    pub node: usize,
    /// Whether it sees other pixels than its own.
    pub is_far: bool,
}

/// The passes of a network.
#[derive(Clone, Debug)]
pub struct Passes {
    /// Of each node those that are computed.
    pub readers: Vec<Vec<Reader>>,
    /// In which pass each is computed; none if nothing needs it or it is imported wherever it is read.
    pub pass_of: Vec<Option<usize>>,
    /// Passes that go over the rows of images of one size together, in order, each some rows behind the one before,
    /// so that what they store for each other is still in a cache when it is read, and only its last rows are kept.
    pub groups: Vec<Range<usize>>,
    /// When and where each goes.
    pub waves: Vec<Wave>,
}

/// How a pass goes over its rows, relative to the group's rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wave {
    /// Rows that it is behind the first of them.
    pub lag: usize,
    /// Rows above and below those wanted that it has to compute for those behind it.
    pub extra: usize,
    /// Rows that these need at a time of what it stores for them.
    pub kept: usize,
}

impl Passes {
    /// The passes of `nodes` of `graph`, with rows divided among `slabs` threads.
    pub fn new(graph: &Graph, nodes: &[Node], slabs: usize) -> Self {
        let readers = readers(graph, nodes);
        let is_placed = |n: usize| match nodes[n].made {
            Made::Export { .. } => true,
            Made::Import { .. } => readers[n].iter().any(|reader| reader.is_far),
            _ => !readers[n].is_empty(),
        };
        let mut levels = earliest(graph, nodes, &is_placed);
        move_late(nodes, &readers, &is_placed, &mut levels);
        // Large images first: they follow the images of the level before, if nothing smaller comes between.
        let key = |n: usize| (levels[n], Reverse(nodes[n].shape.height), nodes[n].shape.width);
        let mut keys: Vec<_> = (0..nodes.len()).filter(|n| is_placed(*n)).map(key).collect();
        keys.sort_unstable();
        keys.dedup();
        let pass_of = |n: usize| keys.binary_search(&key(n)).ok().filter(|_| is_placed(n));
        let pass_of: Vec<_> = (0..nodes.len()).map(pass_of).collect();
        let mut groups: Vec<Range<usize>> = Vec::new();
        let mut waves: Vec<Wave> = Vec::new();
        for (pass, (_, Reverse(height), width)) in keys.iter().enumerate() {
            let joined = groups.last().and_then(|group| {
                let is_alike = (keys[group.start].1.0, keys[group.start].2) == (*height, *width);
                let group = group.start..pass + 1;
                let most = (height / slabs / SHARE).max(2);
                is_alike.then(|| together(graph, nodes, &pass_of, &group, most)).flatten()
            });
            match (joined, groups.last_mut()) {
                (Some(joined), Some(group)) => {
                    group.end = pass + 1;
                    waves.splice(group.start.., joined);
                }
                _ => {
                    groups.push(pass..pass + 1);
                    waves.push(Wave::default());
                }
            }
        }
        Self { readers, pass_of, groups, waves }
    }

    /// The group of a pass.
    pub fn group_of(&self, pass: usize) -> usize {
        self.groups.partition_point(|group| group.end <= pass)
    }

    /// Whether some rows of the result of node `n` are kept for passes of its group.
    pub fn is_kept(&self, n: usize) -> bool {
        self.is_read(n, |group, of_reader| of_reader == group)
    }

    /// Whether the result of node `n` is stored whole, for other groups.
    pub fn is_stored(&self, n: usize) -> bool {
        self.is_read(n, |group, of_reader| of_reader != group)
    }

    /// Whether a node of another pass, of such a group, reads the result of node `n`.
    fn is_read(&self, n: usize, is_such: impl Fn(usize, usize) -> bool) -> bool {
        let Some(pass) = self.pass_of[n] else { return false };
        let is_other = |reader: &Reader| {
            let of_reader = self.pass_of[reader.node].filter(|of_reader| *of_reader != pass);
            of_reader.is_some_and(|of_reader| is_such(self.group_of(pass), self.group_of(of_reader)))
        };
        self.readers[n].iter().any(is_other)
    }
}

/// How the passes of `group` go together, row by row: none if one sees all rows of what another makes, or `most`
/// extra rows are not enough, or they write more images than [`EXPORTS`].
fn together(
    graph: &Graph,
    nodes: &[Node],
    pass_of: &[Option<usize>],
    group: &Range<usize>,
    most: usize,
) -> Option<Vec<Wave>> {
    let member = |n: usize| pass_of[n].filter(|pass| group.contains(pass)).map(|pass| pass - group.start);
    let exports = (0..nodes.len()).filter(|n| member(*n).is_some() && is_export(&nodes[*n]));
    if exports.count() > EXPORTS {
        return None;
    }
    // Who reads of whom how many rows above and below its own.
    let mut reads = Vec::new();
    for (n, node) in nodes.iter().enumerate() {
        let Some(reader) = member(n) else { continue };
        for (i, input) in node.inputs.iter().enumerate() {
            let Some(read) = member(*input).filter(|read| *read != reader) else { continue };
            let (is_far, reach) = (node.is_far(graph, nodes, i), node.reach(graph));
            if is_far && reach == 0 {
                return None;
            }
            reads.push((read, reader, if is_far { reach } else { 0 }));
        }
    }
    let mut waves = vec![Wave::default(); group.len()];
    // Passes read only earlier ones.
    for pass in 0..group.len() {
        let behind = reads.iter().filter(|(_, reader, _)| *reader == pass);
        waves[pass].lag = behind.map(|(read, _, reach)| waves[*read].lag + reach).max().unwrap_or(0);
    }
    for pass in (0..group.len()).rev() {
        let ahead = || reads.iter().filter(|(read, ..)| *read == pass);
        let extra = ahead().map(|(_, reader, reach)| waves[*reader].extra + reach).max();
        let lag = waves[pass].lag;
        let kept = ahead().map(|(_, reader, reach)| waves[*reader].lag - lag + reach + 1).max();
        (waves[pass].extra, waves[pass].kept) = (extra.unwrap_or(0), kept.unwrap_or(0));
    }
    waves.iter().all(|wave| wave.extra <= most).then_some(waves)
}

fn is_export(node: &Node) -> bool {
    matches!(node.made, Made::Export { .. })
}

/// The readers of each node that something needs: that lead to an export.
fn readers(graph: &Graph, nodes: &[Node]) -> Vec<Vec<Reader>> {
    let mut readers: Vec<Vec<Reader>> = vec![Vec::new(); nodes.len()];
    for (n, node) in nodes.iter().enumerate().rev() {
        if is_export(node) || !readers[n].is_empty() {
            for (i, input) in node.inputs.iter().enumerate() {
                readers[*input].push(Reader { node: n, is_far: node.is_far(graph, nodes, i) });
            }
        }
    }
    readers
}

/// For each node, the number of passes that must come before its pass.
fn earliest(graph: &Graph, nodes: &[Node], is_placed: &impl Fn(usize) -> bool) -> Vec<usize> {
    let mut levels: Vec<usize> = Vec::with_capacity(nodes.len());
    for (n, node) in nodes.iter().enumerate() {
        let inputs = node.inputs.iter().enumerate().filter(|(_, input)| is_placed(**input));
        let mut level = inputs
            .map(|(i, input)| levels[*input] + usize::from(node.is_far(graph, nodes, i)))
            .max()
            .unwrap_or(0);
        if is_export(node) {
            let is_beside = |level: usize, other: usize| {
                let (a, b) = (&nodes[other], node);
                let same = (a.shape.height, a.shape.width) == (b.shape.height, b.shape.width);
                is_export(a) && same && levels[other] == level
            };
            while (0..n).filter(|other| is_beside(level, *other)).count() == EXPORTS {
                level += 1;
            }
        }
        levels.push(level);
    }
    levels
}

/// Moves nodes to the pass before which nothing needs them, if storing what they read until then takes no more than
/// storing what they make. What is made of images only and read by nothing before moves along: it is not stored.
fn move_late(
    nodes: &[Node],
    readers: &[Vec<Reader>],
    is_placed: &impl Fn(usize) -> bool,
    levels: &mut [usize],
) {
    // The last level at which each is read, by the nodes that were looked at.
    let mut until = vec![0; nodes.len()];
    for (n, node) in nodes.iter().enumerate().rev().filter(|(n, _)| is_placed(*n)) {
        let late = readers[n].iter().map(|r| levels[r.node] - usize::from(r.is_far)).min();
        let inputs = |n: usize| nodes[n].inputs.iter().copied().filter(|input| is_placed(*input));
        if let Some(late) = late.filter(|_| !is_export(node)) {
            let moves_along = |input: usize| {
                let is_late = |r: &Reader| r.node == n || levels[r.node] >= late;
                inputs(input).next().is_none() && readers[input].iter().all(is_late)
            };
            let longer = inputs(n).filter(|input| until[*input] < late && !moves_along(*input));
            if longer.map(|input| nodes[input].blocks()).sum::<usize>() <= node.blocks() {
                levels[n] = late;
            }
        }
        inputs(n).for_each(|input| until[input] = until[input].max(levels[n]));
    }
}
