//! Perceptual loss: differences of the features of a network that has learned to tell things apart.

mod pool;
mod squeezenet;

use std::path::Path;

use gs3_neural::arrays::{self, Arrays};
use gs3_neural::{Differentiator, Packed, RunError, Scratch, Shape, Tape};

use super::{CHANNELS, Interior};
use crate::error::TrainError;
use pool::Pool;
use squeezenet::{AFTER_CONV1, CONV1_BEFORE, CONV1_MORE, FEATURES, INPUT, parts};

/// Mean and standard deviation of RGB in the images that the network has learned from (ImageNet).
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

/// A mean square of features below which a difference is not divided by it: the mean square of an empty image.
const LEAST_SQUARE: f64 = 1e-6;

/// Differences of features of SqueezeNet v1.0 (Iandola et al. 2016) after conv1, fire4 and fire5: the mean squared
/// difference relative to the mean square of the truth's features (Johnson et al. 2016, made free of the features'
/// size), and the mean of the three.
#[derive(Clone, Debug)]
pub struct Perceptual {
    interior: Interior,
    /// Rows and columns of the interior that the network sees: even numbers.
    size: [usize; 2],
    parts: Vec<Part>,
}

/// A part of the network; features are compared at its end.
#[derive(Clone, Debug)]
struct Part {
    /// From the features of the part before; the first part sees the image.
    pool: Option<Pool>,
    differentiator: Differentiator,
    packed: Packed,
}

/// Memory of the loss.
#[derive(Clone, Debug)]
pub struct PerceptualMemory {
    parts: Vec<PartMemory>,
}

#[derive(Clone, Debug)]
struct PartMemory {
    tape: Tape,
    scratch: Scratch,
    input: Vec<f32>,
    v_input: Vec<f32>,
    features: Vec<f32>,
    v_features: Vec<f32>,
    /// Features of the truth.
    truth: Vec<f32>,
    /// Derivatives by the weights, which are not used.
    v_weights: Arrays,
}

impl Perceptual {
    /// The loss within `interior` by the weights in `file`, safetensors with the names `conv1.weight`,
    /// `fire2.conv1x1_1.weight` and so on.
    ///
    /// # Errors
    /// [`TrainError`] if they cannot be read or are others, or the interior is too small for the network.
    pub fn load(file: &Path, interior: Interior) -> Result<Self, TrainError> {
        let at = |source| TrainError::WeightsFile { path: file.to_owned(), source };
        let (_, arrays) = arrays::load(file)?;
        match Self::new(&arrays, interior) {
            Err(TrainError::Weights(source) | TrainError::Run(RunError::Weights(source))) => Err(at(source)),
            other => other,
        }
    }

    /// The same by weights by name.
    ///
    /// # Errors
    /// [`TrainError`] if they are others, or the interior is too small for the network.
    pub fn new(arrays: &Arrays, interior: Interior) -> Result<Self, TrainError> {
        // Windows of 2×2 pixels are not cut.
        let size = [interior.rows().len(), interior.columns().len()].map(|side| side & !1);
        let mut made: Vec<Part> = Vec::new();
        for (k, (graph, weights)) in parts(arrays)?.into_iter().enumerate() {
            let (pool, lr) = match made.last() {
                None => (None, size.map(|side| side / 2)),
                Some(before) => {
                    let shape = before.differentiator.output_shape(FEATURES);
                    let (start, more) = if k == 1 { (CONV1_BEFORE, CONV1_MORE) } else { (0, 0) };
                    let pool = shape.and_then(|s| Pool::new([s.height, s.width], s.channels, start, more));
                    let Some(pool) = pool else {
                        let (expected, actual) =
                            ("images for SqueezeNet".to_owned(), format!("{size:?} pixels"));
                        return Err(TrainError::Setting { name: "crop", expected, actual });
                    };
                    let lr = pool.result();
                    (Some(pool), lr)
                }
            };
            let differentiator = Differentiator::new(&graph, lr, &[INPUT])?;
            let packed = differentiator.pack(&weights)?;
            made.push(Part { pool, differentiator, packed });
        }
        Ok(Self { interior, size, parts: made })
    }

    /// Memory for [`Perceptual::add`].
    #[must_use]
    pub fn memory(&self) -> PerceptualMemory {
        let part = |Part { differentiator: d, .. }: &Part| {
            let zeros = |shape: Option<Shape>| vec![0.0; shape.map_or(0, |shape| shape.len())];
            let (input, features) = (zeros(d.input_shape(INPUT)), zeros(d.output_shape(FEATURES)));
            PartMemory {
                tape: d.tape(),
                scratch: d.scratch(),
                v_input: input.clone(),
                input,
                v_features: features.clone(),
                truth: features.clone(),
                features,
                v_weights: d.v_weights(),
            }
        };
        PerceptualMemory { parts: self.parts.iter().map(part).collect() }
    }

    /// The loss of `color`, an HR image `[height, width, 4]` with the errors `error`. Adds `factor` times its
    /// derivative to `v`.
    ///
    /// # Errors
    /// [`RunError`] if `memory` is another's.
    pub fn add(
        &self,
        color: &[f32],
        error: &[f32],
        factor: f32,
        memory: &mut PerceptualMemory,
        v: &mut [f32],
    ) -> Result<f64, RunError> {
        self.forward(memory, |k| color[k] - error[k])?;
        for part in &mut memory.parts {
            std::mem::swap(&mut part.features, &mut part.truth);
        }
        self.forward(memory, |k| color[k])?;
        let mut sum = 0.0;
        for part in &mut memory.parts {
            let square = |v: &[f32]| v.iter().map(|v| f64::from(v * v)).sum::<f64>();
            let count = (self.parts.len() * part.truth.len()) as f64;
            let size = (square(&part.truth) / part.truth.len() as f64).max(LEAST_SQUARE);
            let values = part.features.iter().zip(&part.truth).map(|(feature, truth)| feature - truth);
            part.v_features.iter_mut().zip(values).for_each(|(v, change)| *v = change);
            sum += square(&part.v_features) / (count * size);
            let slope = (2.0 * f64::from(factor) / (count * size)) as f32;
            part.v_features.iter_mut().for_each(|v| *v *= slope);
        }
        self.backward(memory, v)?;
        Ok(sum)
    }

    /// Features of the image with the numbers `value(k)`.
    fn forward(&self, memory: &mut PerceptualMemory, value: impl Fn(usize) -> f32) -> Result<(), RunError> {
        for (k, part) in self.parts.iter().enumerate() {
            let (before, rest) = memory.parts.split_at_mut(k);
            let Some(now) = rest.first_mut() else { continue };
            match (&part.pool, before.last()) {
                (Some(pool), Some(before)) => pool.forward(&before.features, &mut now.input),
                _ => {
                    for (at, out) in self.pixels().zip(now.input.as_chunks_mut::<3>().0) {
                        *out = std::array::from_fn(|c| (value(at + c) - MEAN[c]) / DEVIATION[c]);
                    }
                }
            }
            part.differentiator.forward(&part.packed, &[(INPUT, &now.input)], &mut now.tape)?;
            part.differentiator.output(&now.tape, FEATURES, &mut now.features)?;
            if k == 0 {
                self.forget_padding(&mut now.features);
            }
        }
        Ok(())
    }

    /// Makes features of conv1 zero that the network has not.
    fn forget_padding(&self, features: &mut [f32]) {
        let [height, width] = self.size.map(|side| side / 2);
        let whole = |side: usize| CONV1_BEFORE..CONV1_BEFORE + side.saturating_sub(CONV1_MORE);
        let (rows, columns) = (whole(height), whole(width));
        for (k, pixel) in features.chunks_exact_mut(AFTER_CONV1).enumerate() {
            if !(rows.contains(&(k / width)) && columns.contains(&(k % width))) {
                pixel.fill(0.0);
            }
        }
    }

    /// Adds the derivative by the image to `v`, given those by all features.
    fn backward(&self, memory: &mut PerceptualMemory, v: &mut [f32]) -> Result<(), RunError> {
        for (k, part) in self.parts.iter().enumerate().rev() {
            let (before, rest) = memory.parts.split_at_mut(k);
            let Some(PartMemory { tape, scratch, input, v_input, v_features, v_weights, .. }) =
                rest.first_mut()
            else {
                continue;
            };
            let (outputs, mut inputs) = ([(FEATURES, &v_features[..])], [(INPUT, &mut v_input[..])]);
            part.differentiator.backward(&part.packed, tape, scratch, &outputs, v_weights, &mut inputs)?;
            match (&part.pool, before.last_mut()) {
                (Some(pool), Some(before)) => {
                    pool.backward(&before.features, input, v_input, &mut before.v_features);
                }
                _ => {
                    for (at, v_image) in self.pixels().zip(v_input.as_chunks::<3>().0) {
                        (0..3).for_each(|c| v[at + c] += v_image[c] / DEVIATION[c]);
                    }
                }
            }
        }
        Ok(())
    }

    /// Where the pixels that the network sees are in an HR image.
    fn pixels(&self) -> impl Iterator<Item = usize> + use<> {
        let (stride, [height, width]) = (self.interior.stride(), self.size);
        let (top, left) = (self.interior.rows().start, self.interior.columns().start);
        (0..height).flat_map(move |y| (0..width).map(move |x| (top + y) * stride + (left + x) * CHANNELS))
    }
}
