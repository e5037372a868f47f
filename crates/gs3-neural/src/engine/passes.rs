//! Which nodes are computed together, row by row.
//!
//! A pass goes over the rows of images of one size once. What its nodes make of a pixel, its other nodes read from the
//! first cache; only what a later pass reads, or a node that sees other pixels, is stored whole. So a node belongs to the
//! first pass after those that make what it sees of other pixels, or to a later one where it saves memory. Images are
//! read in each pass anew, unless other pixels of them are seen.

use std::cmp::Reverse;
use std::ops::Range;

use super::nodes::{Made, Node};
use crate::graph::Graph;

/// Most images that a pass writes.
pub const EXPORTS: usize = 4;

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
    /// Passes that go over the rows of images of one size together, in order: each a band of rows behind the one before, so
    /// that what they store for each other is still in a cache when it is read, and only its last rows are kept.
    pub groups: Vec<Range<usize>>,
}

impl Passes {
    /// Those of `nodes` of `graph`, for bands of `band` rows.
    pub fn new(graph: &Graph, nodes: &[Node], band: usize) -> Self {
        let readers = readers(graph, nodes);
        let is_placed = |n: usize| match nodes[n].made {
            Made::Export { .. } => true,
            Made::Import { .. } => readers[n].iter().any(|reader| reader.is_far),
            _ => !readers[n].is_empty(),
        };
        let mut levels = earliest(graph, nodes, &is_placed);
        move_late(nodes, &readers, &is_placed, &mut levels);
        // Large images first: they follow those of the level before, band by band, if nothing smaller comes between.
        let key = |n: usize| (levels[n], Reverse(nodes[n].shape.height), nodes[n].shape.width);
        let mut keys: Vec<_> = (0..nodes.len()).filter(|n| is_placed(*n)).map(key).collect();
        keys.sort_unstable();
        keys.dedup();
        let pass_of = |n: usize| keys.binary_search(&key(n)).ok().filter(|_| is_placed(n));
        let pass_of: Vec<_> = (0..nodes.len()).map(pass_of).collect();
        let mut groups: Vec<Range<usize>> = Vec::new();
        for (pass, (_, height, width)) in keys.iter().enumerate() {
            match groups.last_mut() {
                Some(group)
                    if (keys[group.start].1, keys[group.start].2) == (*height, *width)
                        && follows(graph, nodes, &pass_of, pass, group, band) =>
                {
                    group.end = pass + 1;
                }
                _ => groups.push(pass..pass + 1),
            }
        }
        Self { pass_of, groups, readers }
    }

    /// The group of a pass.
    pub fn group_of(&self, pass: usize) -> usize {
        self.groups.partition_point(|group| group.end <= pass)
    }

    /// Whether the result of node `n` is stored whole.
    pub fn is_stored(&self, n: usize) -> bool {
        let is_later = |reader: &Reader| reader.is_far || self.pass_of[reader.node] != self.pass_of[n];
        self.pass_of[n].is_some() && self.readers[n].iter().any(is_later)
    }
}

/// Whether `pass` sees so few rows of what passes of `group` make that it can follow them band by band.
fn follows(
    graph: &Graph,
    nodes: &[Node],
    pass_of: &[Option<usize>],
    pass: usize,
    group: &Range<usize>,
    band: usize,
) -> bool {
    (0..nodes.len()).filter(|n| pass_of[*n] == Some(pass)).all(|n| {
        let node = &nodes[n];
        let is_near = |i: usize| !node.is_far(graph, nodes, i) || (1..=band).contains(&node.reach(graph));
        let is_before = |input: usize| pass_of[input].is_some_and(|pass| group.contains(&pass));
        node.inputs.iter().enumerate().all(|(i, input)| !is_before(*input) || is_near(i))
    })
}

/// The readers of each node that something needs: that lead to an export.
fn readers(graph: &Graph, nodes: &[Node]) -> Vec<Vec<Reader>> {
    let mut readers: Vec<Vec<Reader>> = vec![Vec::new(); nodes.len()];
    for (n, node) in nodes.iter().enumerate().rev() {
        if matches!(node.made, Made::Export { .. }) || !readers[n].is_empty() {
            for (i, input) in node.inputs.iter().enumerate() {
                readers[*input].push(Reader { node: n, is_far: node.is_far(graph, nodes, i) });
            }
        }
    }
    readers
}

/// How many passes must be before that of each node.
fn earliest(graph: &Graph, nodes: &[Node], is_placed: &impl Fn(usize) -> bool) -> Vec<usize> {
    let mut levels: Vec<usize> = Vec::with_capacity(nodes.len());
    for (n, node) in nodes.iter().enumerate() {
        let inputs = node.inputs.iter().enumerate().filter(|(_, input)| is_placed(**input));
        let mut level = inputs
            .map(|(i, input)| levels[*input] + usize::from(node.is_far(graph, nodes, i)))
            .max()
            .unwrap_or(0);
        if matches!(node.made, Made::Export { .. }) {
            let is_beside = |level: usize, other: usize| {
                let (a, b) = (&nodes[other], node);
                let same = (a.shape.height, a.shape.width) == (b.shape.height, b.shape.width);
                matches!(a.made, Made::Export { .. }) && same && levels[other] == level
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
        if let Some(late) = late.filter(|_| !matches!(node.made, Made::Export { .. })) {
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
