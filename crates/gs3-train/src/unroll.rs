//! One item: a network run forward through consecutive frames, its loss, and the way back through time.

use gs3_neural::arrays::Arrays;
use gs3_neural::{Differentiator, Graph, Named, Op, Packed, Scratch, Tape};
use half::slice::HalfFloatSliceExt;

use crate::clip::{Clip, Frame, HIDDEN, from_unorm};
use crate::error::TrainError;
use crate::losses::{CHANNELS, Interior, Laplacian, Loss, Term, Terms, change, charbonnier};
use crate::settings::{MARGIN, Settings};

/// Differentiates a network through the frames of an item.
#[derive(Clone, Debug)]
pub struct Unroll {
    differentiator: Differentiator,
    interior: Interior,
    loss: Loss,
    window: usize,
}

/// What an item gives.
#[derive(Clone, Debug)]
pub struct ItemResult {
    /// Values of the terms, means over the item, without their weights.
    pub terms: Terms,
    /// The derivative of the loss by the weights.
    pub v_weights: Arrays,
}

/// Memory of an item, used again for the next one.
#[derive(Clone, Debug)]
pub struct Memory {
    tapes: Vec<Tape>,
    scratch: Scratch,
    laplacian: Laplacian,
    /// Inputs of a frame, in the clip's order.
    inputs: Vec<Vec<f32>>,
    hidden: Vec<f32>,
    v_hidden: Vec<f32>,
    /// The network's image, RGB and uncertainty.
    color: Vec<f32>,
    /// Error images of all frames, and the derivatives by them.
    errors: Vec<Vec<f32>>,
    v_errors: Vec<Vec<f32>>,
}

impl Unroll {
    /// Items of `graph` as `settings` say.
    ///
    /// # Errors
    /// [`TrainError`] if the graph cannot take them.
    pub fn new(graph: &Graph, settings: &Settings) -> Result<Self, TrainError> {
        settings.check()?;
        let (crop, scale) = (settings.crop, settings.scale as usize);
        let differentiator = Differentiator::new(graph, [crop; 2], &[HIDDEN])?;
        let Some(interior) = Interior::new(crop * scale, crop * scale, MARGIN * scale) else {
            let (expected, actual) = (format!("more than {}", 2 * MARGIN), crop.to_string());
            return Err(TrainError::Setting { name: "crop", expected, actual });
        };
        Ok(Self { differentiator, interior, loss: settings.loss, window: settings.window })
    }

    /// Weights for [`Unroll::run`].
    ///
    /// # Errors
    /// [`TrainError::Run`] if they are not the graph's.
    pub fn pack(&self, weights: &gs3_neural::Weights) -> Result<Packed, TrainError> {
        Ok(self.differentiator.pack(weights)?)
    }

    /// Zeros, to which derivatives are added.
    #[must_use]
    pub fn v_weights(&self) -> Arrays {
        self.differentiator.v_weights()
    }

    /// Memory for an item.
    #[must_use]
    pub fn memory(&self) -> Memory {
        let image = vec![0.0; self.interior.len()];
        let state = vec![0.0; self.differentiator.input_shape(HIDDEN).map_or(0, |shape| shape.len())];
        Memory {
            tapes: vec![self.differentiator.tape(); self.window],
            scratch: self.differentiator.scratch(),
            laplacian: Laplacian::default(),
            inputs: Vec::new(),
            hidden: state.clone(),
            v_hidden: state,
            errors: vec![image.clone(); self.window],
            v_errors: vec![image.clone(); self.window],
            color: image,
        }
    }

    /// Runs through `clip`, whose hidden state begins at zero.
    ///
    /// # Errors
    /// [`TrainError::Run`] if the clip is of another size.
    pub fn run(&self, packed: &Packed, clip: &Clip, memory: &mut Memory) -> Result<ItemResult, TrainError> {
        self.forward(packed, clip, memory)?;
        let terms = self.terms(memory);
        let v_weights = self.backward(packed, memory)?;
        Ok(ItemResult { terms, v_weights })
    }

    fn forward(&self, packed: &Packed, clip: &Clip, memory: &mut Memory) -> Result<(), TrainError> {
        memory.hidden.fill(0.0);
        let steps = clip.frames.iter().zip(&mut memory.tapes).zip(&mut memory.errors);
        for ((frame, tape), error) in steps {
            decode(frame, &mut memory.inputs);
            let named = frame.inputs.iter().zip(&memory.inputs);
            let mut images: Vec<Named<'_>> = named.map(|(plane, v)| (&*plane.name, &**v)).collect();
            images.push((HIDDEN, &memory.hidden));
            self.differentiator.forward(packed, &images, tape)?;
            self.differentiator.output(tape, "color", &mut memory.color)?;
            self.differentiator.output(tape, HIDDEN, &mut memory.hidden)?;
            subtract(&memory.color, &frame.target, error);
        }
        Ok(())
    }

    /// The values of all terms; their derivatives go to `memory.v_errors`.
    fn terms(&self, memory: &mut Memory) -> Terms {
        let (Loss { weights, epsilon }, interior) = (self.loss, &self.interior);
        let Memory { laplacian, errors, v_errors, .. } = memory;
        v_errors.iter_mut().for_each(|v| v.fill(0.0));
        let mut terms = Terms::default();
        let mut add = |term: Term, frames: usize, sum_of: &mut dyn FnMut(f32) -> f64| {
            let (weight, count) = (weights.get(term), (frames * interior.count()) as f64);
            if weight > 0.0 && frames > 0 {
                terms.set(term, sum_of((weight / count) as f32) / count);
            }
        };
        add(Term::Charbonnier, self.window, &mut |factor| {
            let frames = errors.iter().zip(v_errors.iter_mut());
            frames.map(|(e, v)| charbonnier(interior, e, epsilon, factor, v)).sum()
        });
        add(Term::Laplacian, self.window, &mut |factor| {
            let frames = errors.iter().zip(v_errors.iter_mut());
            frames.map(|(e, v)| laplacian.add(interior, e, factor, v)).sum()
        });
        add(Term::Temporal, self.window - 1, &mut |factor| {
            let mut sum = 0.0;
            for k in 1..self.window {
                let (before, after) = v_errors.split_at_mut(k);
                let v = [&mut before[k - 1][..], &mut after[0][..]];
                sum += change(interior, [&errors[k - 1], &errors[k]], epsilon, factor, v);
            }
            sum
        });
        terms
    }

    fn backward(&self, packed: &Packed, memory: &mut Memory) -> Result<Arrays, TrainError> {
        let mut v_weights = self.differentiator.v_weights();
        let Memory { tapes, scratch, hidden, v_hidden, v_errors, .. } = memory;
        // Nothing reads the state after the last frame.
        v_hidden.fill(0.0);
        for (tape, v_error) in tapes.iter().zip(v_errors.iter()).rev() {
            // The last state itself is not needed any more: its memory takes the derivative by the state before.
            let v_outputs = [("color", &v_error[..]), (HIDDEN, &v_hidden[..])];
            let mut v_inputs = [(HIDDEN, &mut hidden[..])];
            self.differentiator.backward(packed, tape, scratch, &v_outputs, &mut v_weights, &mut v_inputs)?;
            std::mem::swap(hidden, v_hidden);
        }
        Ok(v_weights)
    }
}

/// The inputs of a frame in single precision.
pub fn decode(frame: &Frame, inputs: &mut Vec<Vec<f32>>) {
    inputs.resize(frame.inputs.len(), Vec::new());
    for (plane, out) in frame.inputs.iter().zip(inputs) {
        out.resize(plane.values.len(), 0.0);
        plane.values.convert_to_f32_slice(out);
    }
}

/// The error image of `color`, RGB and uncertainty, against a target.
fn subtract(color: &[f32], target: &[u16], error: &mut [f32]) {
    let (color, target) = (color.as_chunks::<CHANNELS>().0, target.as_chunks::<3>().0);
    for ((error, color), target) in error.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(color).zip(target) {
        let [r, g, b] = [0, 1, 2].map(|c| color[c] - from_unorm(target[c]));
        *error = [r, g, b, 0.0];
    }
}

/// Floating-point operations of an item's convolutions per LR pixel and frame: a multiplication and an addition for
/// each weight forward, as many for the derivative by the weights, and as many for that by the input where anything
/// learned comes before it.
///
/// # Errors
/// [`TrainError::Graph`] if the graph cannot take the size.
pub fn operations_per_pixel(graph: &Graph, crop: usize) -> Result<f64, TrainError> {
    let shapes = graph.shapes([crop; 2])?;
    let mut is_learned = vec![false; shapes.len()];
    let mut total = 0.0;
    for (k, layer) in graph.layers().iter().enumerate() {
        let before = layer.inputs.iter().any(|t| is_learned[t.index()]);
        is_learned[k] = before || layer.name == HIDDEN || matches!(layer.op, Op::Conv2d(_));
        if let (Op::Conv2d(conv), [input]) = (&layer.op, &layer.inputs[..]) {
            let adds = (shapes[k].len() * graph.channels(*input) * conv.kernel * conv.kernel) as f64;
            total += 2.0 * adds * if before { 3.0 } else { 2.0 };
        }
    }
    Ok(total / (crop * crop) as f64)
}
