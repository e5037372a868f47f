//! The CPU engine: a network for one image size, planned once, run without allocation.
//!
//! `nodes` are the graph's layers, without layers that only rearrange inputs of convolutions or images. `passes`
//! groups them. A pass goes over the rows once, strip by strip. The values of a pixel stay in scratch memory of the
//! thread; only values that a later pass or a neighbouring pixel reads are kept. Passes of a group follow each other
//! row by row, so only the last rows are kept, and rows that are read again are still in a cache. `plan` gives every
//! buffer its place. `run` gives each thread a slab of rows. Threads do not wait for each other: a thread computes
//! the few rows of neighbouring slabs that it needs itself. Images are read at each use, and written where they are
//! made.
//!
//! `docs/performance.md` has the engine's time, its share of the peak, and the rest (`examples/engine_speed.rs`
//! measures them). The lower bound is memory: super sampling of tier fast at 480×270, ×4, moves 180 MB of images in
//! and out.

mod bf16;
pub(crate) mod block;
pub(crate) mod conv;
pub(crate) mod exchange;
pub(crate) mod learned;
pub(crate) mod math;
pub(crate) mod nodes;
pub(crate) mod ops;
mod passes;
pub(crate) mod plan;
mod run;
mod thin;

use fearless_simd::Level;

use crate::error::RunError;
use crate::graph::{Graph, Shape};
use crate::images::{self, Named};
use crate::weights::Weights;
use bf16::Unit;
use block::{Block, Remainder};
use plan::Plan;
use run::{Exports, Job, Slab};

/// What convolutions compute with; by default what should be faster on this machine ([`Arithmetic::fastest`]), so
/// that frames of different machines may differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arithmetic {
    /// f32: results within 1e-4 of exact ones.
    F32,
    /// Products of bf16 with sums of f32, where the machine has AMX or AVX-512 BF16 and a convolution gains; f32
    /// elsewhere. Results are within 2e-2. A refined frame (the 20th of `gs3 render --arithmetic` on a capture)
    /// differs from f32's frame by 72 dB, and is as far from the native frame, to 1e-4 dB.
    Bf16,
}

impl Arithmetic {
    /// Its name at the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }

    /// [`Self::Bf16`] on CPUs with AMX, if the operating system lets the process use it, and on AMD's CPUs with
    /// AVX-512 BF16; else [`Self::F32`]. Zen 4 issues its instruction for pairs of bf16 as often as the f32
    /// instruction, which does half as much. Granite Rapids, the only Intel CPU measured, issues it half as often,
    /// and rounding adds to the cost: balanced super sampling to 1920×1080 took 91 ms in this way, and 70 ms in f32.
    /// Its tiles take half as long as f32 (`examples/engine_speed.rs`).
    #[must_use]
    pub fn fastest() -> Self {
        match Unit::best() {
            Some(unit) if unit.gains() => Self::Bf16,
            _ => Self::F32,
        }
    }
}

impl Default for Arithmetic {
    fn default() -> Self {
        Self::fastest()
    }
}

/// A network ready to run on images of one size. Results are the same on any number of threads.
#[derive(Clone, Debug)]
pub struct Engine {
    graph: Graph,
    shapes: Vec<Shape>,
    plan: Plan,
    arena: Vec<Block>,
    /// For each slab the rows that its passes keep for each other.
    rings: Vec<Vec<Block>>,
    /// Which of the images of a run each layer is.
    image_of: Vec<usize>,
    level: Level,
}

impl Engine {
    /// `graph` with `weights` for an LR grid of `[height, width]`, in f32.
    ///
    /// # Errors
    /// [`RunError`] if the graph cannot take that size, or the weights are not its own.
    pub fn new(graph: &Graph, weights: &Weights, lr: [usize; 2]) -> Result<Self, RunError> {
        Self::with_arithmetic(graph, weights, lr, Arithmetic::F32)
    }

    /// The same in numbers of another kind.
    ///
    /// # Errors
    /// As [`Engine::new`].
    pub fn with_arithmetic(
        graph: &Graph,
        weights: &Weights,
        lr: [usize; 2],
        arithmetic: Arithmetic,
    ) -> Result<Self, RunError> {
        let shapes = graph.shapes(lr)?;
        weights.check(graph)?;
        let plan = Plan::new(graph, weights, &shapes, arithmetic, rayon::current_num_threads());
        let arena = vec![Block::default(); plan.arena];
        let rings = vec![vec![Block::default(); plan.ring]; plan.slabs];
        let image_of = vec![0; shapes.len()];
        Ok(Self { graph: graph.clone(), shapes, plan, arena, rings, image_of, level: gs3_simd::level() })
    }

    /// Bytes of all results in flight.
    #[must_use]
    pub fn arena_bytes(&self) -> usize {
        size_of_val(&self.arena[..]) + self.rings.iter().map(|ring| size_of_val(&ring[..])).sum::<usize>()
    }

    /// The shape of the image that the graph calls `name`: an input or an output.
    #[must_use]
    pub fn shape(&self, name: &str) -> Option<Shape> {
        let input =
            self.graph.inputs().find(|(_, layer)| layer.name == name).map(|(t, _)| self.shapes[t.index()]);
        input.or_else(|| self.output(name).map(|output| self.plan.outputs[output]))
    }

    /// Runs the network on `images`, all its inputs, and writes the outputs that are asked for. Images are channels
    /// last.
    ///
    /// # Errors
    /// [`RunError`] if an image is missing, unknown or of another size; nothing is computed then.
    pub fn run(&mut self, images: &[Named<'_>], outputs: &mut [(&str, &mut [f32])]) -> Result<(), RunError> {
        images::check(&self.graph, &self.shapes, images)?;
        for (name, image) in outputs.iter() {
            let Some(output) = self.output(name) else {
                let expected: Vec<&str> = self.graph.outputs().iter().map(|o| o.name.as_str()).collect();
                return Err(RunError::Unknown { name: (*name).to_owned(), expected: expected.join(", ") });
            };
            images::check_length(name, self.plan.outputs[output], image.len())?;
        }
        for (tensor, layer) in self.graph.inputs() {
            // All inputs are there: that was checked.
            let image = images.iter().position(|(name, _)| *name == layer.name);
            self.image_of[tensor.index()] = image.unwrap_or_default();
        }
        // One entry into the pool for the whole network, not one for every pass.
        rayon::scope(|_| self.compute(images, outputs));
        Ok(())
    }

    fn output(&self, name: &str) -> Option<usize> {
        self.graph.outputs().iter().position(|output| output.name == name)
    }

    fn compute(&mut self, images: &[Named<'_>], outputs: &mut [(&str, &mut [f32])]) {
        let scratch = self.plan.scratch;
        for group in &self.plan.groups {
            let (stored, arena) =
                Remainder::split(&mut self.arena, group.start, group.height * group.row_len);
            let mut exports = Exports::default();
            for (name, image) in outputs.iter_mut().rev() {
                let is_it = |(output, _): &(usize, usize)| self.graph.outputs()[*output].name == *name;
                if let Some(export) = group.exports.iter().position(is_it) {
                    exports[export] = &mut image[..];
                }
            }
            let (level, border, image_of) = (self.level, self.graph.border(), &self.image_of[..]);
            let job = Job { group, level, border, images, image_of, scratch, arena };
            job.slabs(Slab { rows: 0..group.height, stored, exports }, &mut self.rings);
        }
        // Outputs that are asked for twice.
        for k in 1..outputs.len() {
            let (before, [(name, image), ..]) = outputs.split_at_mut(k) else { break };
            if let Some((_, same)) = before.iter().find(|(n, _)| n == name) {
                image.copy_from_slice(same);
            }
        }
    }
}
