//! RT4KSR (Zamfir, Conde, Timofte 2023), ×2, applied twice for ×4. Its training form is folded to plain 3×3
//! convolutions.

use gs3::neural::model::PublishedNetwork;
use gs3_scene::{GBuffer, Image};

use super::runner::{Runner, color_of, write};
use super::{PublishedWeightError, PublishedWeights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 24;
const NAME: &str = "rt4ksr";

/// RT4KSR ×2.
#[derive(Clone, Debug)]
pub struct Rt4ksr {
    /// One for each doubling: they are of different sizes.
    networks: [Runner; 2],
}

impl Rt4ksr {
    /// Takes the published weights in training form, by their published names.
    ///
    /// # Errors
    /// [`PublishedWeightError`] if a tensor is missing, has another shape or is not finite.
    pub fn new(weights: &PublishedWeights) -> Result<Self, PublishedWeightError> {
        let graph = PublishedNetwork::Rt4ksr.graph(2).map_err(|e| weights.unusable(e.into()))?;
        let network = weights.runner_from(NAME, graph, |layer, kind, shape| {
            let published = match layer {
                "head" => "module.head.0",
                "tail.norm" => "module.tail.0",
                "tail.conv" => "module.tail.1",
                "upsample" => "module.upsample.0",
                // body.0.norm, body.0.conv and so on.
                _ => &format!("module.{layer}").replace(".conv", ".conv1"),
            };
            if layer.ends_with(".conv") {
                let [kernel, bias] = folded(weights, published)?;
                return Ok(if kind == "weight" { kernel } else { bias });
            }
            weights.tensor(&format!("{published}.{kind}"), shape)
        })?;
        Ok(Self { networks: [network.clone(), network] })
    }
}

impl Upscaler for Rt4ksr {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if !(scale == 2 || scale == 4) {
            return Err(UpscaleError::Scale { method: NAME, expected: 4, actual: scale });
        }
        check_size(lr, scale, out)?;
        // It works on blocks of 2×2 pixels.
        let (mut color, mut size) = color_of(lr, 2);
        for network in &mut self.networks[..scale.ilog2() as usize] {
            let mut doubled = vec![0.0; 4 * color.len()];
            network.run(size, &[("color", &color)], &mut [("color", &mut doubled)])?;
            doubled.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
            (color, size) = (doubled, size.map(|side| 2 * side));
        }
        write(&color, size[1], out);
        Ok(())
    }
}

/// The block `1×1 expand → 3×3 + identity → 1×1 reduce → + input` as one 3×3 convolution, its weights and its biases.
/// The expanded maps are padded with the expansion's bias, which is what a zero border expands to, so folding is exact
/// at borders, too.
fn folded(weights: &PublishedWeights, name: &str) -> Result<[Vec<f32>; 2], PublishedWeightError> {
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
    Ok([kernel, bias])
}
