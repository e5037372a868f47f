//! The CPU engine: a network for one image size, planned once, run without allocation.
//!
//! Measured (`examples/speed.rs`) with two threads of a Zen 4 machine whose multiply-adds peak at 235 GFLOP/s, 480×270:
//! 3×3 convolutions 16→16, 32→32 and 48→48 at 92, 92 and 96 % of the peak. Whole networks at ×4, images in and out
//! included: super sampling 57, 159, 315 ms (55, 77, 86 %), interpolation 96, 234, 432 ms (46, 67, 76 %), fast, balanced,
//! high. What convolutions leave is bringing images in and out, which is scalar, and the first layers, whose inputs have
//! few channels.

mod bf16;
pub(crate) mod block;
pub(crate) mod conv;
pub(crate) mod learned;
pub(crate) mod math;
pub(crate) mod ops;
pub(crate) mod plan;

use fearless_simd::Level;

use crate::error::RunError;
use crate::graph::{Border, Graph};
use crate::images::{self, Named};
use crate::shape::Shape;
use crate::weights::Weights;
use block::{Block, Sources};
use plan::{Kind, Plan};

/// What convolutions compute with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arithmetic {
    /// f32: results within 1e-4 of exact ones.
    #[default]
    F32,
    /// Products of bf16, sums of f32, where the machine has AVX-512 BF16 and a convolution gains; f32 elsewhere. Results
    /// within 2e-2.
    Bf16,
}

/// A network ready to run on images of one size. Results are the same on any number of threads.
#[derive(Clone, Debug)]
pub struct Engine {
    graph: Graph,
    shapes: Vec<Shape>,
    plan: Plan,
    arena: Vec<Block>,
    level: Level,
}

impl Engine {
    /// `graph` with `weights` for an LR grid of `[height, width]`.
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
        let plan = Plan::new(graph, weights, &shapes, arithmetic);
        let arena = vec![Block::default(); plan.arena];
        Ok(Self { graph: graph.clone(), shapes, plan, arena, level: Level::new() })
    }

    /// Bytes of all results in flight.
    #[must_use]
    pub fn arena_bytes(&self) -> usize {
        size_of_val(&self.arena[..])
    }

    /// The shape of the image that the graph calls `name`: an input or an output.
    #[must_use]
    pub fn shape(&self, name: &str) -> Option<Shape> {
        let input =
            self.graph.inputs().find(|(_, layer)| layer.name == name).map(|(t, _)| self.shapes[t.index()]);
        input.or_else(|| self.plan.exports.iter().find(|e| e.name == name).map(|e| e.shape))
    }

    /// Runs the network on `images`, all its inputs, and writes those of its outputs that are asked for. Images are
    /// channels last.
    ///
    /// # Errors
    /// [`RunError`] if an image is missing, unknown or of another size; nothing is computed then.
    pub fn run(&mut self, images: &[Named<'_>], outputs: &mut [(&str, &mut [f32])]) -> Result<(), RunError> {
        images::check(&self.graph, &self.shapes, images)?;
        for (name, image) in outputs.iter() {
            let Some(export) = self.plan.exports.iter().find(|e| e.name == *name) else {
                let expected: Vec<&str> = self.plan.exports.iter().map(|e| e.name.as_str()).collect();
                return Err(RunError::Unknown { name: (*name).to_owned(), expected: expected.join(", ") });
            };
            images::check_length(name, export.shape, image.len())?;
        }
        // One entry into the pool for the whole network, not one for every step.
        rayon::scope(|_| self.compute(images, outputs));
        Ok(())
    }

    fn compute(&mut self, images: &[Named<'_>], outputs: &mut [(&str, &mut [f32])]) {
        let border: Border = self.graph.border();
        for step in &self.plan.steps {
            let (out, sources) = Sources::split(&mut self.arena, &step.out);
            match &step.kind {
                Kind::Import { layer, factor } => {
                    // All inputs are there: that was checked.
                    let image = images::find(images, &self.graph.layers()[*layer].name).unwrap_or_default();
                    ops::import(image, *factor, border, &step.out, out);
                }
                Kind::Convolution(convolution) => convolution.run(self.level, sources, &step.out, out),
                Kind::Bf16(convolution) => convolution.run(self.level, sources, &step.out, out),
                Kind::Learned(learned) => {
                    learned.run(self.level, border, sources, &step.inputs[0], &step.out, out);
                }
                Kind::Row(op) => ops::run(self.level, op, border, sources, &step.inputs, &step.out, out),
            }
        }
        for (name, image) in outputs {
            if let Some(export) = self.plan.exports.iter().find(|e| e.name == *name) {
                let tensor = &self.arena[export.tensor.start..][..export.tensor.len()];
                ops::export(tensor, &export.tensor, export.factor, image);
            }
        }
    }
}
