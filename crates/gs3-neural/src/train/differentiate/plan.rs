//! What is stored where: results of the forward pass for as long as a tape lives, derivatives by them for as long as
//! the backward pass needs them.

use crate::engine::block::Layout;
use crate::engine::conv::Segment;
use crate::engine::nodes::Readers;
use crate::engine::plan::Arena;
use crate::graph::{Activation, Border, Conv2d, Graph, Op, Shape};

use super::math::needs_argument;

/// The steps of both passes: forward in order, backward from the last to the first.
#[derive(Debug)]
pub struct Plan {
    pub graph: Graph,
    pub shapes: Vec<Shape>,
    pub steps: Vec<Step>,
    pub exports: Vec<Export>,
    /// Blocks of all results.
    pub values: usize,
    /// Blocks of the derivatives that are needed at once.
    pub v: usize,
}

/// One result that is stored.
#[derive(Debug)]
pub struct Step {
    /// Of the graph.
    pub layer: usize,
    pub kind: Kind,
    /// The steps that it reads the results of.
    pub inputs: Vec<usize>,
    /// Their results.
    pub layouts: Vec<Layout>,
    /// Its result, on the tape.
    pub out: Layout,
    /// The derivative by its result, if anything needs it.
    pub v: Option<Layout>,
}

/// How a result is made.
#[derive(Debug)]
pub enum Kind {
    /// From the image of its layer, blocks of `factor`² pixels becoming channels.
    Import {
        factor: usize,
    },
    Convolution(Conv2d),
    /// An operation with learned numbers for each channel.
    Learned(Op),
    Row(Op),
}

/// A named result.
#[derive(Debug)]
pub struct Export {
    pub name: String,
    pub step: usize,
    /// Blocks of `factor`² channels become pixels.
    pub factor: usize,
    /// Shape of the image.
    pub shape: Shape,
}

impl Plan {
    /// The plan of `graph` for results of `shapes`; derivatives by the input layers `wanted` are needed.
    pub fn new(graph: &Graph, shapes: Vec<Shape>, wanted: &[usize]) -> Self {
        let readers = Readers::new(graph);
        let is_fused = |k: usize| readers.is_fused(k) && !wanted.contains(&k);
        let mut steps: Vec<Step> = Vec::new();
        let mut step_of = vec![0; shapes.len()];
        for (k, layer) in graph.layers().iter().enumerate() {
            if is_fused(k) {
                continue;
            }
            let mut inputs = Vec::new();
            for tensor in &layer.inputs {
                let t = tensor.index();
                match &graph.layers()[t] {
                    part if !is_fused(t) || !matches!(part.op, Op::Concat | Op::Input { .. }) => {
                        inputs.push(step_of[t]);
                    }
                    part => inputs.extend(part.inputs.iter().map(|t| step_of[t.index()])),
                }
            }
            let mut push = |layer, kind, inputs: Vec<usize>| {
                let needed = match &kind {
                    Kind::Import { .. } => wanted.contains(&k),
                    Kind::Convolution(_) | Kind::Learned(_) => true,
                    Kind::Row(op) => read_inputs(op, &inputs).iter().any(|i| steps[*i].v.is_some()),
                };
                let out = Layout::whole(shapes[k], 0, 0);
                steps.push(Step { layer, kind, inputs, layouts: Vec::new(), out, v: needed.then_some(out) });
                steps.len() - 1
            };
            step_of[k] = match &layer.op {
                Op::Input { .. } => push(k, Kind::Import { factor: 1 }, inputs),
                Op::PixelUnshuffle { factor } if inputs.is_empty() => {
                    push(layer.inputs[0].index(), Kind::Import { factor: *factor }, inputs)
                }
                Op::Conv2d(conv) if needs_argument(conv.activation) => {
                    let sum = push(k, Kind::Convolution(conv.activation(Activation::Identity)), inputs);
                    push(k, Kind::Row(Op::Activate(conv.activation)), vec![sum])
                }
                Op::Conv2d(conv) => push(k, Kind::Convolution(*conv), inputs),
                op @ (Op::Prelu | Op::LayerNorm { .. }) => push(k, Kind::Learned(*op), inputs),
                op => push(k, Kind::Row(*op), inputs),
            };
        }
        let exports: Vec<Export> = graph
            .outputs()
            .iter()
            .map(|output| {
                let k = output.tensor.index();
                let (k_stored, factor) = match &graph.layers()[k] {
                    layer if is_fused(k) => (layer.inputs[0].index(), layer.op.factor().unwrap_or(1)),
                    _ => (k, 1),
                };
                Export { name: output.name.clone(), step: step_of[k_stored], factor, shape: shapes[k] }
            })
            .collect();
        let values = place_values(&mut steps);
        let v = place_derivatives(graph.border(), &mut steps, &exports);
        Self { graph: graph.clone(), shapes, steps, exports, values, v }
    }
}

/// Gives every result a place of its own, with the halo that its readers need; how many blocks all take.
fn place_values(steps: &mut [Step]) -> usize {
    for k in 0..steps.len() {
        if let Kind::Convolution(conv) = steps[k].kind {
            for i in steps[k].inputs.clone() {
                steps[i].out.halo = steps[i].out.halo.max(conv.reach());
            }
        }
    }
    let mut end = 0;
    for step in &mut *steps {
        step.out.start = end;
        end += step.out.len();
    }
    for k in 0..steps.len() {
        steps[k].layouts = steps[k].inputs.iter().map(|i| steps[*i].out).collect();
    }
    end
}

/// Gives derivatives places, which they share with others that are not needed at the same time: each is from the first
/// reader's step on the way back, or from the beginning if the loss reads the result, to its own step.
fn place_derivatives(border: Border, steps: &mut [Step], exports: &[Export]) -> usize {
    let mut arena = Arena::default();
    let mut placed = vec![false; steps.len()];
    // Backward, step k is the (count − k)th, after the derivatives by outputs have come in.
    let count = steps.len();
    let mut place = |steps: &mut [Step], now: usize, k: usize| {
        if let Some(v) = &mut steps[k].v
            && !placed[k]
        {
            if let Kind::Convolution(conv) = steps[k].kind {
                // What the turned convolution sees beside the image, zeros.
                v.halo = conv.reach() + extension(border, &conv);
            }
            v.start = arena.place(now, count - k, v.len());
            placed[k] = true;
        }
    };
    exports.iter().for_each(|export| place(steps, 0, export.step));
    for k in (0..count).rev() {
        if steps[k].v.is_some() {
            // A result that nothing reads has a place too: its step need not know.
            place(steps, count - k, k);
            steps[k].inputs.clone().into_iter().for_each(|i| place(steps, count - k, i));
        }
    }
    arena.len
}

/// The inputs with numbers that `op` reads: without the inputs that only give a size.
pub fn read_inputs<'a>(op: &Op, inputs: &'a [usize]) -> &'a [usize] {
    match op {
        Op::PixelShuffle { .. } | Op::Upsample { .. } => &inputs[..1],
        _ => inputs,
    }
}

/// Width in pixels of the border copies around a convolution's input. Derivatives by the copies are derivatives by
/// the border.
pub fn extension(border: Border, conv: &Conv2d) -> usize {
    match border {
        Border::Zero => 0,
        Border::Replicate => conv.reach(),
    }
}

/// The blocks of channels of a convolution's inputs by which derivatives are needed.
pub fn targets(step: &Step, steps: &[Step]) -> Vec<Target> {
    let mut targets = Vec::new();
    let mut first = 0;
    for (input, layout) in step.inputs.iter().zip(&step.layouts) {
        for segment in Segment::all(&[*layout]) {
            if let Some(v) = steps[*input].v {
                targets.push(Target {
                    step: *input,
                    v,
                    block: segment.block,
                    first,
                    channels: segment.channels,
                });
            }
            first += segment.channels;
        }
    }
    targets
}

/// A block of channels of a convolution's input.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// The step that the result belongs to.
    pub step: usize,
    /// The derivative by that result.
    pub v: Layout,
    /// Which block of its channels.
    pub block: usize,
    /// The first of its channels among all inputs'.
    pub first: usize,
    /// How many.
    pub channels: usize,
}
