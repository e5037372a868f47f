//! SAFMN++ light (Sun et al. 2023, and its entry for the 2024 efficient super-resolution challenges), 32 channels, ×4:
//! spatially-adaptive feature modulation, no biases.

use gs3::neural::{Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Op, Tensor};
use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use super::runner::{Runner, color_of, write};
use super::{PublishedWeightError, PublishedWeights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 32;
/// Channels that are modulated by a coarse version of themselves; the others pass.
const MODULATED: usize = CHANNELS / 2;
const HIDDEN: usize = 48;
const BLOCKS: usize = 2;
const SCALE: usize = 4;
/// Pixels per side of a coarse pixel, nearly: sides that it does not divide are pooled over windows that overlap.
const COARSE: usize = 8;
const NAME: &str = "safmn";

/// SAFMN++ light.
#[derive(Clone, Debug)]
pub struct Safmn {
    /// The layers before the coarse version that the first block needs, the layers between two blocks, and the layers
    /// after the last block.
    parts: [Runner; BLOCKS + 1],
    /// Of each block one 3×3 kernel per modulated channel, `[9, MODULATED]`.
    depthwise: [Vec<[f32; MODULATED]>; BLOCKS],
    images: Images,
}

/// What goes from part to part, `[height, width, channels]`.
#[derive(Clone, Debug, Default)]
struct Images {
    features: Vec<f32>,
    projected: Vec<f32>,
    next: Vec<f32>,
    color: Vec<f32>,
}

impl Safmn {
    /// Takes the published weights, by their published names.
    ///
    /// # Errors
    /// [`PublishedWeightError`] if a tensor is missing, has another shape or is not finite.
    pub fn new(weights: &PublishedWeights) -> Result<Self, PublishedWeightError> {
        let part = |k: usize| weights.runner(NAME, graph(k).map_err(|e| weights.unusable(e.into()))?);
        let depthwise = |k: usize| {
            let name = format!("feats.{k}.conv1.dwconv.weight");
            let kernels = weights.tensor(&name, &[MODULATED, 1, 3, 3])?;
            Ok((0..9).map(|t| std::array::from_fn(|c| kernels[9 * c + t])).collect())
        };
        Ok(Self {
            parts: [part(0)?, part(1)?, part(2)?],
            depthwise: [depthwise(0)?, depthwise(1)?],
            images: Images::default(),
        })
    }
}

/// Part `k`: the end of block `k − 1`, from its projection and the coarse version of that, enlarged; the start of block
/// `k`. Layers have their published names.
fn graph(k: usize) -> Result<Graph, GraphError> {
    let mut g = GraphBuilder::new(NAME, 1, Border::Zero);
    let x = match k {
        0 => {
            let color = g.input("color", 3, 1);
            let features = g.conv("to_feat", plain(3, CHANNELS), &[color]);
            g.output("features", features);
            features
        }
        _ => end_of_block(&mut g, &format!("feats.{}", k - 1)),
    };
    if k < BLOCKS {
        let projected = g.conv(&format!("feats.{k}.conv1.proj"), plain(3, CHANNELS), &[x]);
        g.output("projected", projected);
    } else {
        let features = g.input("features", CHANNELS, 1);
        let sum = g.layer("sum", Op::Add, &[x, features]);
        let blocks = g.conv("to_img.0", plain(3, 3 * SCALE * SCALE), &[sum]);
        let image = g.layer("image", Op::PixelShuffle { factor: SCALE }, &[blocks]);
        g.output("color", image);
    }
    g.finish()
}

fn end_of_block(g: &mut GraphBuilder, name: &str) -> Tensor {
    let name = |part: &str| format!("{name}.{part}");
    let gelu = Activation::Gelu;
    let [projected, coarse] = [g.input("projected", CHANNELS, 1), g.input("coarse", MODULATED, 1)];
    let fine = g.layer(&name("fine"), Op::Slice { first: 0, count: MODULATED }, &[projected]);
    let passing = Op::Slice { first: MODULATED, count: CHANNELS - MODULATED };
    let passing = g.layer(&name("passing"), passing, &[projected]);
    let coarse = g.layer(&name("coarse"), Op::Activate(gelu), &[coarse]);
    let modulated = g.layer(&name("modulated"), Op::Multiply, &[fine, coarse]);
    let both = g.layer(&name("both"), Op::Concat, &[passing, modulated]);
    let both = g.layer(&name("both.act"), Op::Activate(gelu), &[both]);
    let x = g.conv(&name("conv1.out"), plain(1, CHANNELS), &[both]);
    let x = g.conv(&name("conv2.conv.0"), plain(3, HIDDEN).activation(gelu), &[x]);
    g.conv(&name("conv2.conv.2"), plain(1, CHANNELS), &[x])
}

fn plain(kernel: usize, outputs: usize) -> Conv2d {
    Conv2d { bias: false, ..Conv2d::new(kernel, outputs) }
}

impl Upscaler for Safmn {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale as usize != SCALE {
            return Err(UpscaleError::Scale { method: NAME, expected: SCALE as u32, actual: scale });
        }
        check_size(lr, scale, out)?;
        let (color, size) = color_of(lr, 1);
        let pixels = size[0] * size[1];
        let Images { features, projected, next, color: image } = &mut self.images;
        for image in [&mut *features, projected, next] {
            image.resize(CHANNELS * pixels, 0.0);
        }
        image.resize(3 * SCALE * SCALE * pixels, 0.0);
        let [start, between @ .., end] = &mut self.parts;
        start.run(size, &[("color", &color)], &mut [("features", features), ("projected", projected)])?;
        let modulation = |projected: &[f32], kernels: &[[f32; MODULATED]]| {
            enlarged(&convolved(&pooled(projected, size), kernels), size)
        };
        for (part, kernels) in between.iter_mut().zip(&self.depthwise) {
            let coarse = modulation(projected, kernels);
            let images = [("projected", &projected[..]), ("coarse", coarse.as_flattened())];
            part.run(size, &images, &mut [("projected", next)])?;
            std::mem::swap(projected, next);
        }
        let coarse = modulation(projected, &self.depthwise[BLOCKS - 1]);
        let images =
            [("projected", &projected[..]), ("coarse", coarse.as_flattened()), ("features", &features[..])];
        end.run(size, &images, &mut [("color", image)])?;
        write(image, SCALE * size[1], out);
        Ok(())
    }
}

/// The modulated channels at a coarse size, `[height, width]`.
struct Coarse {
    size: [usize; 2],
    pixels: Vec<[f32; MODULATED]>,
}

/// Of the first channels of `projected` maxima over `sides / COARSE` (at least 1) windows along each side, `i n / m`
/// rounded down to `(i + 1) n / m` rounded up.
fn pooled(projected: &[f32], size: [usize; 2]) -> Coarse {
    let coarse = size.map(|side| (side / COARSE).max(1));
    let window = |i: usize, k: usize| i * size[k] / coarse[k]..((i + 1) * size[k]).div_ceil(coarse[k]);
    let pixel = |i: usize| {
        let mut most = [f32::NEG_INFINITY; MODULATED];
        for y in window(i / coarse[1], 0) {
            for x in window(i % coarse[1], 1) {
                let values = &projected[(y * size[1] + x) * CHANNELS..];
                most.iter_mut().zip(values).for_each(|(most, v)| *most = most.max(*v));
            }
        }
        most
    };
    Coarse { size: coarse, pixels: (0..coarse[0] * coarse[1]).into_par_iter().map(pixel).collect() }
}

/// Every channel convolved with its own 3×3 kernel, zeros around.
fn convolved(x: &Coarse, kernels: &[[f32; MODULATED]]) -> Coarse {
    let [height, width] = x.size;
    let pixel = |i: usize| {
        let mut sums = [0.0; MODULATED];
        for (t, weights) in kernels.iter().enumerate() {
            let (y, x0) = ((i / width + t / 3).wrapping_sub(1), (i % width + t % 3).wrapping_sub(1));
            if y < height && x0 < width {
                let values = x.pixels[y * width + x0];
                for c in 0..MODULATED {
                    sums[c] += weights[c] * values[c];
                }
            }
        }
        sums
    };
    Coarse { size: x.size, pixels: (0..height * width).into_par_iter().map(pixel).collect() }
}

/// Linear interpolation between pixel centres, edges repeated.
fn enlarged(x: &Coarse, [height, width]: [usize; 2]) -> Vec<[f32; MODULATED]> {
    // The two nearest samples and the weight of the second.
    let place = |i: usize, to: usize, from: usize| {
        let at = ((i as f32 + 0.5) * from as f32 / to as f32 - 0.5).max(0.0);
        let first = (at as usize).min(from - 1);
        (first, (first + 1).min(from - 1), at - first as f32)
    };
    let mut out = vec![[0.0; MODULATED]; height * width];
    out.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        let (top, bottom, down) = place(y, height, x.size[0]);
        for (i, pixel) in row.iter_mut().enumerate() {
            let (left, right, across) = place(i, width, x.size[1]);
            let [a, b, c, d] = [(top, left), (top, right), (bottom, left), (bottom, right)]
                .map(|(y, column)| &x.pixels[y * x.size[1] + column]);
            for (k, value) in pixel.iter_mut().enumerate() {
                let (top, bottom) = (a[k] + (b[k] - a[k]) * across, c[k] + (d[k] - c[k]) * across);
                *value = top + (bottom - top) * down;
            }
        }
    });
    out
}
