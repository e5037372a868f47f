//! SPAN (Wan et al. 2024), 28 channels, ×4: swift parameter-free attention.

use gs3::neural::{Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Op};
use gs3_scene::{GBuffer, Image};

use super::runner::{Runner, color_of, write};
use super::{PublishedWeightError, PublishedWeights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 28;
const BLOCKS: usize = 6;
const SCALE: usize = 4;
const NAME: &str = "span";
/// Mean of the training images, subtracted before the values are scaled to 0–255.
const MEAN: [f32; 3] = [0.4488, 0.4371, 0.4040];
const RANGE: f32 = 255.0;

/// SPAN with 28 channels.
#[derive(Clone, Debug)]
pub struct Span {
    network: Runner,
    image: Vec<f32>,
}

impl Span {
    /// Takes the published weights, by their published names.
    ///
    /// # Errors
    /// [`PublishedWeightError`] if a tensor is missing, has another shape or is not finite.
    pub fn new(weights: &PublishedWeights) -> Result<Self, PublishedWeightError> {
        let graph = graph().map_err(|e| weights.unusable(e.into()))?;
        Ok(Self { network: weights.runner(NAME, graph)?, image: Vec::new() })
    }
}

/// Layers have their published names.
fn graph() -> Result<Graph, GraphError> {
    let conv = || Conv2d::new(3, CHANNELS);
    let mut g = GraphBuilder::new(NAME, 1, Border::Zero);
    let color = g.input("color", 3, 1);
    let x = g.layer("color.centered", Op::Shift { color: MEAN.map(|v| -v) }, &[color]);
    let x = g.layer("color.scaled", Op::Scale { factor: RANGE }, &[x]);
    let first = g.conv("conv_1.eval_conv", conv(), &[x]);
    let (mut x, mut of_first_block, mut inner) = (first, first, first);
    for k in 1..=BLOCKS {
        let name = |part: &str| format!("block_{k}.{part}");
        let silu = || conv().activation(Activation::Silu);
        inner = g.conv(&name("c1_r.eval_conv"), silu(), &[x]);
        let o2 = g.conv(&name("c2_r.eval_conv"), silu(), &[inner]);
        let o3 = g.conv(&name("c3_r.eval_conv"), conv(), &[o2]);
        let sum = g.layer(&name("sum"), Op::Add, &[o3, x]);
        // σ(v) − ½ = ½ tanh(v / 2).
        let gate = g.layer(&name("halved"), Op::Scale { factor: 0.5 }, &[o3]);
        let gate = g.layer(&name("gate"), Op::Activate(Activation::Tanh), &[gate]);
        let gate = g.layer(&name("attention"), Op::Scale { factor: 0.5 }, &[gate]);
        x = g.layer(&name("out"), Op::Multiply, &[sum, gate]);
        if k == 1 {
            of_first_block = x;
        }
    }
    let last = g.conv("conv_2.eval_conv", conv(), &[x]);
    let all = g.layer("all", Op::Concat, &[first, last, of_first_block, inner]);
    let fused = g.conv("conv_cat", Conv2d::new(1, CHANNELS), &[all]);
    let blocks = g.conv("upsampler.0", Conv2d::new(3, 3 * SCALE * SCALE), &[fused]);
    let image = g.layer("image", Op::PixelShuffle { factor: SCALE }, &[blocks]);
    g.output("color", image);
    g.finish()
}

impl Upscaler for Span {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale as usize != SCALE {
            return Err(UpscaleError::Scale { method: NAME, expected: SCALE as u32, actual: scale });
        }
        check_size(lr, scale, out)?;
        let (color, size) = color_of(lr, 1);
        self.image.resize(SCALE * SCALE * color.len(), 0.0);
        self.network.run(size, &[("color", &color)], &mut [("color", &mut self.image)])?;
        write(&self.image, SCALE * size[1], out);
        Ok(())
    }
}
