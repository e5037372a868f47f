//! RT4KSR (Zamfir, Conde, Timofte 2023), ×2, applied twice for ×4. Its training form is folded to plain 3×3
//! convolutions.

use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use super::activation::gelu;
use super::conv::Conv;
use super::features::Features;
use super::{WeightError, Weights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 24;
const BLOCKS: usize = 4;
const NAME: &str = "rt4ksr";

/// RT4KSR ×2.
#[derive(Clone, Debug)]
pub struct Rt4ksr {
    head: Conv,
    /// The blocks of the body, and the tail.
    stages: Vec<(Norm, Conv)>,
    upsample: Conv,
}

/// Layer normalisation over channels, per pixel.
#[derive(Clone, Debug)]
struct Norm {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Rt4ksr {
    /// Takes the published weights in training form, by their published names.
    ///
    /// # Errors
    /// [`WeightError`] if a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightError> {
        let stage = |norm: &str, conv: &str| Ok((Norm::new(weights, norm)?, folded(weights, conv)?));
        let body = (0..BLOCKS)
            .map(|i| stage(&format!("module.body.{i}.norm"), &format!("module.body.{i}.conv1")))
            .chain([stage("module.tail.0", "module.tail.1")]);
        Ok(Self {
            head: weights.conv("module.head.0", CHANNELS, 12, 3)?,
            stages: body.collect::<Result<_, WeightError>>()?,
            upsample: weights.conv("module.upsample.0", 48, CHANNELS, 3)?,
        })
    }

    /// Doubles the size.
    fn double(&self, color: &Features) -> Features {
        let mut x = self.head.apply(&color.unshuffled(2));
        for (i, (norm, conv)) in self.stages.iter().enumerate() {
            x = conv.apply(&norm.apply(x));
            if i < BLOCKS {
                x = x.combine([], |v, []| gelu(v));
            }
        }
        // The network unshuffles by 2 and shuffles by 4.
        self.upsample.apply(&x).shuffled(4)
    }
}

impl Upscaler for Rt4ksr {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if !(scale == 2 || scale == 4) {
            return Err(UpscaleError::Scale { method: NAME, expected: 4, actual: scale });
        }
        check_size(lr, scale, out)?;
        let mut color = Features::of_color(lr, 2);
        for _ in 0..scale.ilog2() {
            color = self.double(&color).combine([], |v, []| v.clamp(0.0, 1.0));
        }
        color.write(out);
        Ok(())
    }
}

/// The block `1×1 expand → 3×3 + identity → 1×1 reduce → + input` as one 3×3 convolution. The expanded maps are padded
/// with the expansion's bias, which is what a zero border expands to, so folding is exact at borders, too.
fn folded(weights: &Weights, name: &str) -> Result<Conv, WeightError> {
    const WIDE: usize = 2 * CHANNELS;
    let tensor = |part: &str, shape: &[usize]| weights.tensor(&format!("{name}.{part}"), shape);
    let expand = tensor("expand_conv.weight", &[WIDE, CHANNELS, 1, 1])?;
    let expand_bias = tensor("expand_conv.bias", &[WIDE])?;
    let mut middle = tensor("fea_conv.weight", &[WIDE, WIDE, 3, 3])?;
    let middle_bias = tensor("fea_conv.bias", &[WIDE])?;
    let reduce = tensor("reduce_conv.weight", &[CHANNELS, WIDE, 1, 1])?;
    let reduce_bias = tensor("reduce_conv.bias", &[CHANNELS])?;
    const CENTRE: usize = 4;
    for m in 0..WIDE {
        middle[(m * WIDE + m) * 9 + CENTRE] += 1.0;
    }
    let product = |a: f32, b: f32| f64::from(a) * f64::from(b);
    // Expansion and 3×3 together, `[WIDE, CHANNELS, 9]`, then the reduction.
    let mut inner = vec![0.0f64; WIDE * CHANNELS * 9];
    let mut inner_bias: Vec<f64> = middle_bias.iter().map(|b| f64::from(*b)).collect();
    for m in 0..WIDE {
        for n in 0..WIDE {
            for t in 0..9 {
                let weight = middle[(m * WIDE + n) * 9 + t];
                inner_bias[m] += product(weight, expand_bias[n]);
                for i in 0..CHANNELS {
                    inner[(m * CHANNELS + i) * 9 + t] += product(weight, expand[n * CHANNELS + i]);
                }
            }
        }
    }
    let mut kernel = vec![0.0f32; CHANNELS * CHANNELS * 9];
    let mut bias = vec![0.0f32; CHANNELS];
    for o in 0..CHANNELS {
        let row = |m: usize| f64::from(reduce[o * WIDE + m]);
        bias[o] = ((0..WIDE).map(|m| row(m) * inner_bias[m]).sum::<f64>() + f64::from(reduce_bias[o])) as f32;
        for it in 0..CHANNELS * 9 {
            let identity = f64::from(it == o * 9 + CENTRE);
            let sum: f64 = (0..WIDE).map(|m| row(m) * inner[m * CHANNELS * 9 + it]).sum();
            kernel[o * CHANNELS * 9 + it] = (sum + identity) as f32;
        }
    }
    Ok(Conv::new(CHANNELS, CHANNELS, 3, &kernel, Some(&bias)))
}

impl Norm {
    fn new(weights: &Weights, name: &str) -> Result<Self, WeightError> {
        let part = |part: &str| weights.tensor(&format!("{name}.{part}"), &[CHANNELS]);
        Ok(Self { weight: part("weight")?, bias: part("bias")? })
    }

    fn apply(&self, mut x: Features) -> Features {
        const EPSILON: f32 = 1e-6;
        let (width, stride) = (x.width, x.stride);
        x.rows_mut().for_each(|(_, row)| {
            for at in 1..=width {
                let values = || (0..CHANNELS).map(|c| c * stride + at);
                let mean = values().map(|i| row[i]).sum::<f32>() / CHANNELS as f32;
                let variance = values().map(|i| (row[i] - mean).powi(2)).sum::<f32>() / CHANNELS as f32;
                let scale = 1.0 / (variance + EPSILON).sqrt();
                for c in 0..CHANNELS {
                    let value = &mut row[c * stride + at];
                    *value = (*value - mean) * scale * self.weight[c] + self.bias[c];
                }
            }
        });
        x
    }
}
