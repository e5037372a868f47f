//! One item: a network run forward through consecutive frames, its loss, and the way back through time.

use gs3_neural::arrays::Arrays;
use gs3_neural::{Differentiator, Graph, Named, Op, Packed, Scratch, Tape, Weights};
use half::slice::HalfFloatSliceExt;

use crate::clip::{Clip, ClipFrame, HIDDEN, from_unorm};
use crate::error::TrainError;
use crate::losses::{
    CHANNELS, Interior, Laplacian, Loss, Moved, Perceptual, PerceptualMemory, Term, Terms, change,
    charbonnier, square, warp,
};
use crate::settings::{MARGIN, Settings};
use crate::trained_network::TrainedNetwork;

/// The image that networks give.
const COLOR: &str = "color";

/// The learned part of the blend of frames.
const ALPHA: &str = "alpha_correction";

/// Differentiates a network through the frames of an item.
#[derive(Clone, Debug)]
pub struct Unroll {
    differentiator: Differentiator,
    interior: Interior,
    loss: Loss,
    perceptual: Option<Perceptual>,
    subject: TrainedNetwork,
    /// Whether the network hands a state on.
    is_recurrent: bool,
    /// Numbers of a pixel of the network's image: RGB, and the uncertainty that ours hand on.
    channels: usize,
    scale: usize,
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
    frames: Vec<FrameMemory>,
    scratch: Scratch,
    laplacian: Laplacian,
    perceptual: Option<PerceptualMemory>,
    /// The image that the perceptual term looks at.
    seen: Vec<f32>,
    /// Inputs of a frame, in the clip's order.
    inputs: Vec<Vec<f32>>,
    /// The network's image, or the derivative by it: RGB, and uncertainty where it has one.
    color: Vec<f32>,
    hidden: Vec<f32>,
    v_hidden: Vec<f32>,
}

/// What the way back needs of a frame.
#[derive(Clone, Debug)]
struct FrameMemory {
    tape: Tape,
    /// The error image, and the derivative by it.
    error: Vec<f32>,
    v_error: Vec<f32>,
    /// The learned part of the blend and the derivative by it, where it costs.
    alpha: Vec<f32>,
    v_alpha: Vec<f32>,
    /// Inputs of those names, where losses along the motion read them.
    motion: Vec<f32>,
    validity: Vec<f32>,
}

impl Unroll {
    /// Items of `graph` as `settings` say.
    ///
    /// # Errors
    /// [`TrainError`] if the graph cannot take them, or has not what a term of the loss reads.
    pub fn new(graph: &Graph, settings: &Settings) -> Result<Self, TrainError> {
        settings.check()?;
        let (crop, scale) = (settings.crop, settings.scale as usize);
        let is_recurrent = graph.inputs().any(|(_, layer)| layer.name == HIDDEN);
        let differentiator =
            Differentiator::new(graph, [crop; 2], if is_recurrent { &[HIDDEN] } else { &[] })?;
        let subject = settings.subject;
        let has = |term: Term| match term {
            Term::Alpha => differentiator.output_shape(ALPHA).is_some(),
            // Frames of single-image networks lie beside each other: see `TrainedNetwork::displacement`.
            Term::Temporal | Term::Warp => matches!(subject, TrainedNetwork::Own { .. }),
            Term::Charbonnier | Term::Laplacian | Term::Perceptual => true,
        };
        for term in Term::ALL {
            let weight = settings.loss.weights.get(term);
            if weight > 0.0 && !has(term) {
                let (expected, actual) = (format!("0 for {}", graph.name()), weight.to_string());
                return Err(TrainError::Setting { name: term.name(), expected, actual });
            }
        }
        let channels = differentiator.output_shape(COLOR).map_or(CHANNELS, |shape| shape.channels);
        let Some(interior) = Interior::new(crop * scale, crop * scale, MARGIN * scale) else {
            let (expected, actual) = (format!("more than {}", 2 * MARGIN), crop.to_string());
            return Err(TrainError::Setting { name: "crop", expected, actual });
        };
        let weight = settings.loss.weights.get(Term::Perceptual);
        let file = settings.perceptual.as_ref().filter(|_| weight > 0.0);
        let perceptual = file.map(|file| Perceptual::load(file, interior)).transpose()?;
        let (loss, window) = (settings.loss, settings.window);
        Ok(Self {
            differentiator,
            interior,
            loss,
            perceptual,
            subject,
            is_recurrent,
            channels,
            scale,
            window,
        })
    }

    /// Weights for [`Unroll::run`].
    ///
    /// # Errors
    /// [`TrainError::Run`] if they are not the graph's.
    pub fn pack(&self, weights: &Weights) -> Result<Packed, TrainError> {
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
        let alpha = if self.has(Term::Alpha) { vec![0.0; image.len() / CHANNELS] } else { Vec::new() };
        let frame = FrameMemory {
            tape: self.differentiator.tape(),
            error: image.clone(),
            v_error: image.clone(),
            v_alpha: alpha.clone(),
            alpha,
            motion: Vec::new(),
            validity: Vec::new(),
        };
        Memory {
            frames: vec![frame; self.window],
            scratch: self.differentiator.scratch(),
            laplacian: Laplacian::default(),
            perceptual: self.perceptual.as_ref().map(Perceptual::memory),
            seen: Vec::new(),
            inputs: Vec::new(),
            color: vec![0.0; image.len() / CHANNELS * self.channels],
            hidden: state.clone(),
            v_hidden: state,
        }
    }

    /// Runs through `clip`; the hidden state begins at zero. The perceptual term costs more than the network, so it
    /// is computed for one frame. Items with consecutive `turn`s compute it for different frames.
    ///
    /// # Errors
    /// [`TrainError::Run`] if the clip is of another size.
    pub fn run(
        &self,
        packed: &Packed,
        clip: &Clip,
        turn: usize,
        memory: &mut Memory,
    ) -> Result<ItemResult, TrainError> {
        let seen = turn % self.window;
        self.forward(packed, clip, seen, memory)?;
        let mut terms = self.terms(memory);
        if let (Some(perceptual), Some(features)) = (&self.perceptual, &mut memory.perceptual) {
            let weight = self.loss.weights.get(Term::Perceptual) as f32;
            let FrameMemory { error, v_error, .. } = &mut memory.frames[seen];
            terms.set(Term::Perceptual, perceptual.add(&memory.seen, error, weight, features, v_error)?);
        }
        let v_weights = self.backward(packed, memory)?;
        Ok(ItemResult { terms, v_weights })
    }

    /// Whether a term counts.
    fn has(&self, term: Term) -> bool {
        self.loss.weights.get(term) > 0.0
    }

    fn forward(
        &self,
        packed: &Packed,
        clip: &Clip,
        seen: usize,
        memory: &mut Memory,
    ) -> Result<(), TrainError> {
        let Memory { frames, inputs, color, hidden, .. } = memory;
        hidden.fill(0.0);
        for (k, (frame, made)) in clip.frames.iter().zip(frames).enumerate() {
            decode(frame, inputs);
            let named = frame.inputs.iter().zip(inputs.iter());
            // Clips hold more than single-image networks read.
            let named = named.filter(|(plane, _)| self.differentiator.input_shape(&plane.name).is_some());
            let mut images: Vec<Named<'_>> = named.map(|(plane, v)| (&*plane.name, &**v)).collect();
            if self.is_recurrent {
                images.push((HIDDEN, hidden));
            }
            self.differentiator.forward(packed, &images, &mut made.tape)?;
            self.differentiator.output(&made.tape, COLOR, color)?;
            if self.is_recurrent {
                self.differentiator.output(&made.tape, HIDDEN, hidden)?;
            }
            let by = self.subject.displacement(frame, self.scale);
            let width = clip.lr[1] * self.scale;
            let moved = (by != [0; 2]).then(|| displaced(&frame.target, width, by.map(|by| -by)));
            subtract(color, self.channels, moved.as_ref().unwrap_or(&frame.target), &mut made.error);
            if self.perceptual.is_some() && k == seen {
                let pixels = color.chunks_exact(self.channels);
                memory.seen.clear();
                memory.seen.extend(pixels.flat_map(|p| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(0.0)]));
            }
            if self.has(Term::Alpha) {
                self.differentiator.output(&made.tape, ALPHA, &mut made.alpha)?;
            }
            if self.has(Term::Warp) {
                for (plane, input) in frame.inputs.iter().zip(inputs.iter()) {
                    match plane.name.as_str() {
                        "motion" => made.motion.clone_from(input),
                        "validity" => made.validity.clone_from(input),
                        _ => {}
                    }
                }
            }
        }
        Ok(())
    }

    /// The values of all terms; their derivatives go to the frames.
    fn terms(&self, Memory { frames, laplacian, .. }: &mut Memory) -> Terms {
        let (Loss { weights, epsilon }, interior) = (self.loss, &self.interior);
        for frame in frames.iter_mut() {
            frame.v_error.fill(0.0);
            frame.v_alpha.fill(0.0);
        }
        // Means over all RGB values of the frames, or of the pairs of frames.
        let mut terms = Terms::default();
        let mut add = |term: Term, frames: usize, sum: &mut dyn FnMut(f32) -> f64| {
            let count = (frames * interior.count()) as f64;
            if self.has(term) && frames > 0 {
                terms.set(term, sum((weights.get(term) / count) as f32) / count);
            }
        };
        let pairs = frames.len().saturating_sub(1);
        add(Term::Charbonnier, frames.len(), &mut |factor| {
            let one = |f: &mut FrameMemory| charbonnier(interior, &f.error, epsilon, factor, &mut f.v_error);
            frames.iter_mut().map(one).sum()
        });
        add(Term::Laplacian, frames.len(), &mut |factor| {
            frames.iter_mut().map(|f| laplacian.add(interior, &f.error, factor, &mut f.v_error)).sum()
        });
        add(Term::Temporal, pairs, &mut |factor| {
            let pair = |a: &mut FrameMemory, b: &mut FrameMemory| {
                let v = [&mut a.v_error[..], &mut b.v_error[..]];
                change(interior, [&a.error, &b.error], epsilon, factor, v)
            };
            sum_of_pairs(frames, pair)
        });
        add(Term::Warp, pairs, &mut |factor| {
            let pair = |a: &mut FrameMemory, b: &mut FrameMemory| {
                let moved = Moved { scale: self.scale, motion: &b.motion, validity: &b.validity };
                let v = [&mut a.v_error[..], &mut b.v_error[..]];
                warp(interior, moved, [&a.error, &b.error], epsilon, factor, v)
            };
            sum_of_pairs(frames, pair)
        });
        add(Term::Alpha, frames.len(), &mut |factor| {
            // One number a pixel where others have three.
            let one = |f: &mut FrameMemory| 3.0 * square(interior, &f.alpha, 3.0 * factor, &mut f.v_alpha);
            frames.iter_mut().map(one).sum()
        });
        terms
    }

    fn backward(&self, packed: &Packed, memory: &mut Memory) -> Result<Arrays, TrainError> {
        let mut v_weights = self.differentiator.v_weights();
        let Memory { frames, scratch, color, hidden, v_hidden, .. } = memory;
        // Nothing reads the state after the last frame.
        v_hidden.fill(0.0);
        for frame in frames.iter().rev() {
            for (v, v_error) in
                color.chunks_exact_mut(self.channels).zip(frame.v_error.chunks_exact(CHANNELS))
            {
                v.copy_from_slice(&v_error[..self.channels]);
            }
            let v_outputs = [(COLOR, &color[..]), (HIDDEN, &v_hidden[..]), (ALPHA, &frame.v_alpha[..])];
            let v_outputs = match (self.is_recurrent, self.has(Term::Alpha)) {
                (false, _) => &v_outputs[..1],
                (true, false) => &v_outputs[..2],
                (true, true) => &v_outputs[..],
            };
            // The last state itself is not needed any more: its memory takes the derivative by the state before.
            let mut v_inputs = [(HIDDEN, &mut hidden[..])];
            let v_inputs = if self.is_recurrent { &mut v_inputs[..] } else { &mut [] };
            self.differentiator.backward(
                packed,
                &frame.tape,
                scratch,
                v_outputs,
                &mut v_weights,
                v_inputs,
            )?;
            std::mem::swap(hidden, v_hidden);
        }
        Ok(v_weights)
    }
}

/// The sum of `value` over all frames with the frame before them.
fn sum_of_pairs(
    frames: &mut [FrameMemory],
    value: impl Fn(&mut FrameMemory, &mut FrameMemory) -> f64,
) -> f64 {
    let mut sum = 0.0;
    for k in 1..frames.len() {
        let (before, after) = frames.split_at_mut(k);
        sum += value(&mut before[k - 1], &mut after[0]);
    }
    sum
}

/// The inputs of a frame in single precision.
pub fn decode(frame: &ClipFrame, inputs: &mut Vec<Vec<f32>>) {
    inputs.resize(frame.inputs.len(), Vec::new());
    for (plane, out) in frame.inputs.iter().zip(inputs) {
        out.resize(plane.values.len(), 0.0);
        plane.values.convert_to_f32_slice(out);
    }
}

/// An RGB image of rows of `width` pixels moved right by x and down by y pixels; its border is repeated.
pub fn displaced<T: Copy>(image: &[T], width: usize, [x, y]: [isize; 2]) -> Vec<T> {
    let pixels = image.as_chunks::<3>().0;
    let height = pixels.len() / width.max(1);
    let place = |at: usize, by: isize, side: usize| (at as isize - by).clamp(0, side as isize - 1) as usize;
    let mut out = Vec::with_capacity(image.len());
    for row in 0..height {
        let line = &pixels[place(row, y, height) * width..][..width];
        out.extend((0..width).flat_map(|column| line[place(column, x, width)]));
    }
    out
}

/// The error image of `color` against a target. `color` has `channels` channels; the first three are RGB.
fn subtract(color: &[f32], channels: usize, target: &[u16], error: &mut [f32]) {
    let (color, target) = (color.chunks_exact(channels), target.as_chunks::<3>().0);
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
