//! Derivatives at the speed of the engine: a forward pass that keeps its results on a tape, and the way back.
//!
//! One image runs on one thread: a trainer gives each thread images of its batch, and adds up their derivatives in a
//! fixed order, so that results do not depend on the number of threads. Recurrent networks are differentiated through
//! time by a tape for each frame: forward frame by frame, then backward from the last, the derivative by an input state
//! of one frame being that by the output state of the frame before.
//!
//! The same operations in double precision are [`adjoint`](crate::train::adjoint).

mod learned;
mod math;
mod ops;
mod plan;
mod turned;
mod weights;

use std::sync::Arc;

use fearless_simd::Level;

use crate::arrays::{Array, Arrays};
use crate::engine::block::{Block, Layout, Sources};
use crate::engine::conv::{Convolution, fill_halo};
use crate::engine::exchange::Exchange;
use crate::engine::learned::Learned;
use crate::engine::ops::run_row;
use crate::error::{RunError, WeightError};
use crate::graph::{Conv2d, Graph, Op, Shape};
use crate::images::{self, Named};
use crate::weights::Weights;
use ops::{Adjoint, Write};
use plan::{Export, Kind, Plan, Step};
use turned::Turned;
use weights::{ROWS, WeightSums, through_activation};

/// Number of pixels with sums over products in registers before the sums go to memory. It is so large that loading
/// and storing the sums costs little beside the multiply-adds, and so small that the rows stay in the first-level
/// cache. Empirical.
const PIXELS: usize = 128;

/// Derivatives of one network on images of one size. Cheap to clone and to share.
#[derive(Clone, Debug)]
pub struct Differentiator {
    plan: Arc<Plan>,
    level: Level,
}

/// Weights as the kernels of both passes read them.
#[derive(Clone, Debug)]
pub struct Packed {
    plan: Arc<Plan>,
    /// Of each step that learns.
    kernels: Vec<Option<Kernels>>,
}

#[derive(Clone, Debug)]
enum Kernels {
    Convolution(Box<Turnable>),
    Learned(Learned),
}

/// A convolution and the way back to its inputs, if anything learns there.
#[derive(Clone, Debug)]
struct Turnable {
    forward: Convolution,
    turned: Option<Turned>,
}

/// Memory of all results of a forward pass.
#[derive(Clone, Debug)]
pub struct Tape {
    plan: Arc<Plan>,
    values: Vec<Block>,
    is_run: bool,
}

/// Memory of a backward pass. It keeps nothing from one pass to the next: a thread needs one.
#[derive(Clone, Debug)]
pub struct Scratch {
    plan: Arc<Plan>,
    /// Derivatives by results.
    v: Vec<Block>,
    /// Which results have a derivative already.
    begun: Vec<bool>,
    /// A row of derivatives with the copies of the border.
    row: Vec<Block>,
    /// Derivatives by weights and biases in the kernels' layout.
    sums: Vec<Block>,
    v_bias: Vec<Block>,
}

impl Differentiator {
    /// Derivatives of `graph` on an LR grid of `[height, width]`: by its weights, and by the images `inputs`.
    ///
    /// # Errors
    /// [`RunError`] if the graph cannot take that size or has no such inputs.
    pub fn new(graph: &Graph, lr: [usize; 2], inputs: &[&str]) -> Result<Self, RunError> {
        let shapes = graph.shapes(lr)?;
        let mut wanted = Vec::new();
        for name in inputs {
            wanted.push(images::input(graph, name)?.index());
        }
        Ok(Self { plan: Arc::new(Plan::new(graph, shapes, &wanted)), level: gs3_simd::level() })
    }

    /// The shape of the input `name`.
    #[must_use]
    pub fn input_shape(&self, name: &str) -> Option<Shape> {
        let tensor = images::input(&self.plan.graph, name).ok()?;
        Some(self.plan.shapes[tensor.index()])
    }

    /// The shape of the output `name`.
    #[must_use]
    pub fn output_shape(&self, name: &str) -> Option<Shape> {
        self.export(name).ok().map(|export| export.shape)
    }

    /// `weights` for the kernels: to be done again whenever they change.
    ///
    /// # Errors
    /// [`RunError::Weights`] if they are not the graph's.
    pub fn pack(&self, weights: &Weights) -> Result<Packed, RunError> {
        let plan = &self.plan;
        weights.check(&plan.graph)?;
        let border = plan.graph.border();
        let kernels = |step: &Step| match &step.kind {
            Kind::Convolution(conv) => {
                let name = &plan.graph.layers()[step.layer].name;
                let [weight, bias] = ["weight", "bias"].map(|kind| weights.parameter(name, kind));
                let forward = Convolution::new(*conv, border, &step.layouts, weight, bias);
                let turned = Turned::new(border, conv, step, &plan.steps, weight);
                Some(Kernels::Convolution(Box::new(Turnable { forward, turned })))
            }
            Kind::Learned(op) => {
                Learned::new(op, &plan.graph.layers()[step.layer].name, weights).map(Kernels::Learned)
            }
            Kind::Import { .. } | Kind::Row(_) => None,
        };
        let kernels = plan.steps.iter().map(kernels).collect();
        Ok(Packed { plan: Arc::clone(plan), kernels })
    }

    /// Memory for a forward pass.
    #[must_use]
    pub fn tape(&self) -> Tape {
        let values = vec![Block::default(); self.plan.values];
        Tape { plan: Arc::clone(&self.plan), values, is_run: false }
    }

    /// Memory for a backward pass.
    #[must_use]
    pub fn scratch(&self) -> Scratch {
        let v = vec![Block::default(); self.plan.v];
        let plan = Arc::clone(&self.plan);
        Scratch { plan, v, begun: Vec::new(), row: Vec::new(), sums: Vec::new(), v_bias: Vec::new() }
    }

    /// Zeros, to which derivatives by weights are added.
    #[must_use]
    pub fn v_weights(&self) -> Arrays {
        self.plan.graph.parameters().into_iter().map(|p| (p.name, Array::zeros(&p.shape))).collect()
    }

    /// Runs the network on `images`, all its inputs, channels last, and keeps the results on `tape`.
    ///
    /// # Errors
    /// [`RunError`] if an image is missing, unknown or of another size, or weights or tape are another's; nothing is
    /// computed then.
    pub fn forward(&self, packed: &Packed, images: &[Named<'_>], tape: &mut Tape) -> Result<(), RunError> {
        let plan = &*self.plan;
        self.check_memory("weights", &packed.plan)?;
        self.check_memory("tape", &tape.plan)?;
        images::check(&plan.graph, &plan.shapes, images)?;
        tape.is_run = true;
        for (step, kernels) in plan.steps.iter().zip(&packed.kernels) {
            let (out, sources) = Sources::split(&mut tape.values, &step.out);
            // All inputs are there: that was checked.
            let image = images::find(images, &plan.graph.layers()[step.layer].name).unwrap_or_default();
            for (y, out) in out.chunks_exact_mut(step.out.row_len()).enumerate() {
                self.row(step, kernels.as_ref(), image, sources, y, out);
            }
        }
        Ok(())
    }

    /// Row `y` of the result of `step`.
    fn row(
        &self,
        step: &Step,
        kernels: Option<&Kernels>,
        image: &[f32],
        sources: Sources<'_>,
        y: usize,
        out: &mut [Block],
    ) {
        let border = self.plan.graph.border();
        match (&step.kind, kernels) {
            (Kind::Import { factor }, _) => {
                let exchange = Exchange::new(&step.out, *factor);
                exchange.import_row(self.level, image, [0, y], &step.out, out);
                fill_halo(border, &step.out, out);
            }
            (Kind::Row(op), _) => {
                run_row(self.level, op, border, sources, &step.layouts, &step.out, y, out);
            }
            (_, Some(Kernels::Convolution(kernel))) => {
                kernel.forward.run_row(self.level, sources, &step.out, y as isize, out);
                fill_halo(border, &step.out, out);
            }
            (_, Some(Kernels::Learned(learned))) => {
                learned.run_row(self.level, border, sources, &step.layouts[0], &step.out, y, out);
            }
            // Each step that learns was packed.
            (Kind::Convolution(_) | Kind::Learned(_), None) => {}
        }
    }

    /// Writes the result that the graph calls `name` to `image`, channels last.
    ///
    /// # Errors
    /// [`RunError`] if there is no such result or it has another size, or the tape is another's or empty.
    pub fn output(&self, tape: &Tape, name: &str, image: &mut [f32]) -> Result<(), RunError> {
        self.check_tape(tape)?;
        let export = self.export(name)?;
        images::check_length(name, export.shape, image.len())?;
        let layout = &self.plan.steps[export.step].out;
        write_image(self.level, &tape.values, layout, export, image);
        Ok(())
    }

    /// Walks back from `v_outputs`, the derivatives of a loss by results (0 for those that are not given), through the
    /// pass on `tape`. Derivatives by weights are added to `v_weights`, those by images are written to `v_inputs`:
    /// some or all of the inputs named at the beginning.
    ///
    /// # Errors
    /// [`RunError`] if an image is unknown or of another size, an array of `v_weights` is missing or has another
    /// shape, or memory is another's or empty; nothing is computed then.
    pub fn backward(
        &self,
        packed: &Packed,
        tape: &Tape,
        scratch: &mut Scratch,
        v_outputs: &[Named<'_>],
        v_weights: &mut Arrays,
        v_inputs: &mut [(&str, &mut [f32])],
    ) -> Result<(), RunError> {
        let plan = &*self.plan;
        self.check_memory("weights", &packed.plan)?;
        self.check_memory("scratch", &scratch.plan)?;
        self.check_tape(tape)?;
        for (name, image) in v_outputs {
            images::check_length(name, self.export(name)?.shape, image.len())?;
        }
        for (name, image) in &*v_inputs {
            images::check_length(name, self.wanted(name)?.1.shape, image.len())?;
        }
        for parameter in plan.graph.parameters() {
            check_array(&parameter.name, &parameter.shape, v_weights)?;
        }
        scratch.begun.clear();
        scratch.begun.resize(plan.steps.len(), false);
        for (name, image) in v_outputs {
            let export = self.export(name)?;
            if let Some(v) = &plan.steps[export.step].v {
                let write = scratch.write(export.step);
                read_image(self.level, image, v, export.factor, &mut scratch.v, write);
                scratch.begun[export.step] = true;
            }
        }
        for (k, step) in plan.steps.iter().enumerate().rev() {
            let Some(v) = step.v.as_ref().filter(|_| scratch.begun[k]) else { continue };
            match (&step.kind, &packed.kernels[k]) {
                (Kind::Convolution(conv), Some(Kernels::Convolution(kernel))) => {
                    self.convolution(step, conv, kernel.turned.as_ref(), tape, v, scratch, v_weights);
                }
                (_, Some(Kernels::Learned(learned))) => {
                    self.learned(step, learned, tape, v, scratch, v_weights);
                }
                (Kind::Row(op), _) => self.operation(step, op, tape, v, scratch),
                (Kind::Import { .. }, _) => {
                    let name = &plan.graph.layers()[step.layer].name;
                    for (_, image) in v_inputs.iter_mut().filter(|(n, _)| n == name) {
                        let export =
                            Export { name: name.clone(), step: k, factor: 1, shape: plan.shapes[step.layer] };
                        write_image(self.level, &scratch.v, v, &export, image);
                    }
                }
                // Each step that learns was packed.
                (Kind::Convolution(_) | Kind::Learned(_), _) => {}
            }
        }
        for (name, image) in v_inputs {
            if !scratch.begun[self.wanted(name)?.0] {
                image.fill(0.0);
            }
        }
        Ok(())
    }

    /// The way back through a convolution; `v` is the derivative by its result.
    fn convolution(
        &self,
        step: &Step,
        conv: &Conv2d,
        turned: Option<&Turned>,
        tape: &Tape,
        v: &Layout,
        scratch: &mut Scratch,
        v_weights: &mut Arrays,
    ) {
        let values = Sources::all(&tape.values);
        let sums = WeightSums { conv, border: self.plan.graph.border(), inputs: &step.layouts };
        reset(&mut scratch.v_bias, v.blocks());
        reset(&mut scratch.sums, sums.len());
        reset(&mut scratch.row, turned.map_or(0, Turned::row_len));
        let mut turned_rows = turned.map_or(0..0, Turned::rows);
        // All three parts of some rows before the next, so that rows are in the cache.
        let (height, count) = (v.shape.height, PIXELS.div_ceil(v.shape.width).min(ROWS));
        for first in (0..height).step_by(count) {
            let rows = first..(first + count).min(height);
            let v_rows = &mut scratch.v[v.start + first * v.row_len()..][..rows.len() * v.row_len()];
            let result = (values, &step.out);
            through_activation(self.level, conv.activation, result, v, first, v_rows, &mut scratch.v_bias);
            let v_all = (Sources::all(&scratch.v), v);
            sums.run(self.level, values, v_all, rows.clone(), &mut scratch.sums);
            if let Some(turned) = turned {
                // Those that see no row beyond these.
                let ready = (rows.end as isize).saturating_sub_unsigned(conv.reach());
                let end = if rows.end == height { turned_rows.end } else { ready };
                while turned_rows.start < end {
                    let y = turned_rows.start;
                    turned.run_row(self.level, y, &mut scratch.v, &mut scratch.row, &scratch.begun);
                    turned_rows.start += 1;
                }
            }
        }
        if let Some(turned) = turned {
            turned.finish(&mut scratch.begun);
        }
        let name = &self.plan.graph.layers()[step.layer].name;
        if let Some(v_weight) = v_weights.get_mut(&format!("{name}.weight")) {
            sums.unpack(&scratch.sums, v_weight.values_mut());
        }
        if let Some(v_bias) = v_weights.get_mut(&format!("{name}.bias")).filter(|_| conv.bias) {
            let lanes = scratch.v_bias.iter().flat_map(|block| block.0);
            v_bias.values_mut().iter_mut().zip(lanes).for_each(|(v, sum)| *v += sum);
        }
    }

    /// The way back through an operation with learned numbers for each channel.
    fn learned(
        &self,
        step: &Step,
        learned: &Learned,
        tape: &Tape,
        v: &Layout,
        scratch: &mut Scratch,
        v_weights: &mut Arrays,
    ) {
        let input = step.inputs[0];
        let adjoint = learned::Adjoint { learned, values: &tape.values, input: &step.layouts[0], v };
        reset(&mut scratch.sums, learned.weight.len());
        reset(&mut scratch.v_bias, learned.weight.len());
        // The derivative by the input goes over that by the result, and from there to its place.
        adjoint.run(self.level, &mut scratch.v, &mut scratch.sums, &mut scratch.v_bias);
        if let Some(v_input) = &self.plan.steps[input].v {
            let write = scratch.write(input);
            let (out, derivatives) = Sources::split(&mut scratch.v, v_input);
            adjoint.hand_on(self.level, derivatives, v_input, out, write);
            scratch.begun[input] = true;
        }
        let name = &self.plan.graph.layers()[step.layer].name;
        for (kind, sums) in [("weight", &scratch.sums), ("bias", &scratch.v_bias)] {
            if let Some(v) = v_weights.get_mut(&format!("{name}.{kind}")) {
                let lanes = sums.iter().flat_map(|block| block.0);
                v.values_mut().iter_mut().zip(lanes).for_each(|(v, sum)| *v += sum);
            }
        }
    }

    /// The way back through another operation.
    fn operation(&self, step: &Step, op: &Op, tape: &Tape, v: &Layout, scratch: &mut Scratch) {
        for (input, k) in plan::read_inputs(op, &step.inputs).iter().enumerate() {
            let Some(v_input) = &self.plan.steps[*k].v else { continue };
            let write = scratch.write(*k);
            let (out, derivatives) = Sources::split(&mut scratch.v, v_input);
            let values = Sources::all(&tape.values);
            let adjoint = Adjoint { op, step, input, values, v: derivatives, v_result: v, v_input };
            adjoint.run(self.level, out, write);
            scratch.begun[*k] = true;
        }
    }

    fn export(&self, name: &str) -> Result<&Export, RunError> {
        let exports = &self.plan.exports;
        exports.iter().find(|export| export.name == name).ok_or_else(|| {
            let expected: Vec<&str> = exports.iter().map(|export| export.name.as_str()).collect();
            RunError::Unknown { name: name.to_owned(), expected: expected.join(", ") }
        })
    }

    /// The step and derivative of an input by which derivatives are wanted.
    fn wanted(&self, name: &str) -> Result<(usize, &Layout), RunError> {
        let wanted = self.plan.steps.iter().enumerate().filter_map(|(k, step)| match (&step.kind, &step.v) {
            (Kind::Import { .. }, Some(v)) => Some((&self.plan.graph.layers()[step.layer].name, k, v)),
            _ => None,
        });
        match wanted.clone().find(|(n, ..)| *n == name) {
            Some((_, k, v)) => Ok((k, v)),
            None => {
                let expected: Vec<&str> = wanted.map(|(name, ..)| name.as_str()).collect();
                Err(RunError::Unknown { name: name.to_owned(), expected: expected.join(", ") })
            }
        }
    }

    fn check_tape(&self, tape: &Tape) -> Result<(), RunError> {
        self.check_memory("tape", &tape.plan)?;
        match tape.is_run {
            true => Ok(()),
            false => Err(RunError::Memory { name: "tape", expected: "a forward pass", actual: "none" }),
        }
    }

    fn check_memory(&self, name: &'static str, plan: &Arc<Plan>) -> Result<(), RunError> {
        match Arc::ptr_eq(plan, &self.plan) {
            true => Ok(()),
            false => {
                let (expected, actual) = ("that of this differentiator", "another's");
                Err(RunError::Memory { name, expected, actual })
            }
        }
    }
}

impl Scratch {
    /// How a part of the derivative by the result of step `k` is written.
    fn write(&self, k: usize) -> Write {
        if self.begun[k] { Write::Add } else { Write::Set }
    }
}

/// `len` zeros.
fn reset(blocks: &mut Vec<Block>, len: usize) {
    blocks.clear();
    blocks.resize(len, Block::default());
}

fn check_array(name: &str, expected: &[usize], arrays: &Arrays) -> Result<(), WeightError> {
    let (name, expected) = (name.to_owned(), expected.to_vec());
    match arrays.get(&name) {
        None => Err(WeightError::Missing { name, expected }),
        Some(array) if array.shape() != expected => {
            let actual = format!("{:?}", array.shape());
            Err(WeightError::Shape { name, expected, actual })
        }
        Some(_) => Ok(()),
    }
}

/// Writes the tensor at `layout` in `blocks` to an image.
fn write_image(level: Level, blocks: &[Block], layout: &Layout, export: &Export, image: &mut [f32]) {
    let exchange = Exchange::new(layout, export.factor);
    for (y, image) in image.chunks_exact_mut(exchange.row_len()).enumerate() {
        exchange.export_row(
            level,
            Sources::all(blocks),
            std::slice::from_ref(layout),
            y,
            layout.shape.width,
            image,
        );
    }
}

/// Reads an image to the tensor at `layout` in `blocks`.
fn read_image(
    level: Level,
    image: &[f32],
    layout: &Layout,
    factor: usize,
    blocks: &mut [Block],
    write: Write,
) {
    let exchange = Exchange::new(layout, factor);
    let rows = blocks[layout.start..][..layout.len()].chunks_exact_mut(layout.row_len());
    for (y, (row, line)) in rows.zip(image.chunks_exact(exchange.row_len())).enumerate() {
        match write {
            Write::Set => exchange.import_row(level, image, [0, y], layout, row),
            Write::Add => exchange.import_any(line, 0, layout, row, |out, v| *out += v),
        }
    }
}
