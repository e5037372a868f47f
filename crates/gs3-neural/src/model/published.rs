//! Published single-image networks, to be trained on the same frames as ours and compared with them.
//!
//! Input `color` (LR, 3), output `color` (HR, 3): display-encoded RGB. Borders are zeros, as published. The graphs
//! are what is run: blocks that are trained with more branches than that are single convolutions here, which they
//! fold to exactly.

use super::check_scale;
use crate::graph::{Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Op, Tensor};

/// A published single-image network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PublishedNetwork {
    /// ECBSR with 4 blocks of 16 channels (Zhang, Zeng, Zhang 2021): plain 3×3 convolutions.
    Ecbsr,
    /// RT4KSR (Zamfir, Conde, Timofte 2023): 24 channels at half the LR size.
    Rt4ksr,
    /// NinaSR-B1 (Gouvine 2021): 26 residual blocks of 32 channels with local attention.
    Ninasr,
}

impl PublishedNetwork {
    /// All of them, cheapest first.
    pub const ALL: [Self; 3] = [Self::Ecbsr, Self::Rt4ksr, Self::Ninasr];

    /// [`Graph::name`].
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ecbsr => "ecbsr",
            Self::Rt4ksr => "rt4ksr",
            Self::Ninasr => "ninasr",
        }
    }

    /// The published size that the graph is of, in the place of a tier.
    #[must_use]
    pub const fn size(self) -> &'static str {
        match self {
            Self::Ecbsr => "m4c16",
            Self::Rt4ksr => "c24",
            Self::Ninasr => "b1",
        }
    }

    /// The pixel of a block of `scale`×`scale` HR pixels, in both directions, at which networks trained here expect the
    /// sample of an LR pixel: the one before the middle. It is the middle itself that publications mean, which no
    /// pixel of even blocks is at.
    #[must_use]
    pub const fn sample(self, scale: usize) -> usize {
        scale.saturating_sub(1) / 2
    }

    /// The jitter of LR frames that are sampled there, in LR pixels.
    #[must_use]
    pub fn jitter(self, scale: usize) -> [f32; 2] {
        [((self.sample(scale) as f32 + 0.5) / scale.max(1) as f32) - 0.5; 2]
    }

    /// The network of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|peer| peer.name() == name)
    }

    /// The network that enlarges by `scale`.
    ///
    /// # Errors
    /// [`GraphError::Scale`] if there is none.
    pub fn graph(self, scale: usize) -> Result<Graph, GraphError> {
        check_scale(scale)?;
        match self {
            Self::Ecbsr => ecbsr(scale),
            Self::Rt4ksr => rt4ksr(scale),
            Self::Ninasr => ninasr(scale),
        }
    }
}

fn ecbsr(scale: usize) -> Result<Graph, GraphError> {
    const CHANNELS: usize = 16;
    const BLOCKS: usize = 4;
    let block = scale * scale;
    let mut g = GraphBuilder::new(PublishedNetwork::Ecbsr.name(), 1, Border::Zero);
    let color = g.input("color", 3, 1);
    let mut x = color;
    for k in 0..=BLOCKS {
        x = g.conv(&format!("backbone.{k}"), Conv2d::new(3, CHANNELS), &[x]);
        x = g.layer(&format!("backbone.{k}.act"), Op::Prelu, &[x]);
    }
    let x = g.conv(&format!("backbone.{}", BLOCKS + 1), Conv2d::new(3, 3 * block), &[x]);
    // The input is added to each of a channel's S² places: nearest interpolation.
    let mut places = Vec::with_capacity(3 * block);
    for (c, name) in ["red", "green", "blue"].into_iter().enumerate() {
        let channel = g.layer(name, Op::Slice { first: c, count: 1 }, &[color]);
        places.resize(places.len() + block, channel);
    }
    let nearest = g.layer("nearest", Op::Concat, &places);
    let image = g.layer("image.blocks", Op::Add, &[x, nearest]);
    let image = g.layer("image", Op::PixelShuffle { factor: scale }, &[image]);
    g.output("color", image);
    g.finish()
}

/// Sides of LR images are even: it works on blocks of 2×2 pixels.
fn rt4ksr(scale: usize) -> Result<Graph, GraphError> {
    const CHANNELS: usize = 24;
    const BLOCKS: usize = 4;
    let conv = || Conv2d::new(3, CHANNELS);
    let mut g = GraphBuilder::new(PublishedNetwork::Rt4ksr.name(), 1, Border::Zero);
    let color = g.input("color", 3, 1);
    let x = g.layer("blocks", Op::PixelUnshuffle { factor: 2 }, &[color]);
    let mut x = g.conv("head", conv(), &[x]);
    for k in 0..BLOCKS {
        x = g.layer(&format!("body.{k}.norm"), Op::LayerNorm { epsilon: 1e-6 }, &[x]);
        x = g.conv(&format!("body.{k}.conv"), conv().activation(Activation::Gelu), &[x]);
    }
    let x = g.layer("tail.norm", Op::LayerNorm { epsilon: 1e-6 }, &[x]);
    let x = g.conv("tail.conv", conv(), &[x]);
    let x = g.conv("upsample", Conv2d::new(3, 3 * 4 * scale * scale), &[x]);
    let image = g.layer("image", Op::PixelShuffle { factor: 2 * scale }, &[x]);
    g.output("color", image);
    g.finish()
}

fn ninasr(scale: usize) -> Result<Graph, GraphError> {
    const CHANNELS: usize = 32;
    const BLOCKS: usize = 26;
    /// What a block's branches are multiplied with for each block of the network.
    const EXPANSION: f32 = 4.0 / BLOCKS as f32;
    /// Mean colour of the images that it was published with.
    const MEAN: [f32; 3] = [0.4488, 0.4371, 0.4040];
    let plain = |outputs| Conv2d { bias: false, ..Conv2d::new(3, outputs) };
    let mut g = GraphBuilder::new(PublishedNetwork::Ninasr.name(), 1, Border::Zero);
    let color = g.input("color", 3, 1);
    let x = g.layer("color.centered", Op::Shift { color: MEAN.map(|v| -v) }, &[color]);
    let head = g.conv("head", plain(CHANNELS), &[x]);
    let mut x = head;
    for k in 0..BLOCKS {
        let name = |part: &str| format!("body.{k}.{part}");
        // What a block sees has variance 1, if each branch before it added its share.
        let factor = 1.0 / (1.0 + k as f32 * EXPANSION * EXPANSION).sqrt();
        let h = g.layer(&name("normal"), Op::Scale { factor }, &[x]);
        let h = g.conv(&name("expand"), Conv2d::new(3, 2 * CHANNELS).activation(Activation::Relu), &[h]);
        let h = attention(&mut g, &name("attention"), h);
        let h = g.conv(&name("reduce"), plain(CHANNELS), &[h]);
        let h = g.layer(&name("branch"), Op::Scale { factor: 2.0 * EXPANSION }, &[h]);
        x = g.layer(&name("sum"), Op::Add, &[x, h]);
    }
    let x = g.layer("body", Op::Add, &[x, head]);
    let x = g.conv("tail", Conv2d::new(3, 3 * scale * scale), &[x]);
    let x = g.layer("image.blocks", Op::Shift { color: MEAN }, &[x]);
    let image = g.layer("image", Op::PixelShuffle { factor: scale }, &[x]);
    g.output("color", image);
    g.finish()
}

/// Channels weighted by their surroundings: a squeeze-and-excitation block with a local mean.
fn attention(g: &mut GraphBuilder, name: &str, x: Tensor) -> Tensor {
    const STRIDE: usize = 16;
    let part = |part: &str| format!("{name}.{part}");
    let pooled = g.layer(&part("pool"), Op::AveragePool { side: 2 * STRIDE - 1, stride: STRIDE }, &[x]);
    let squeezed = g.conv(&part("squeeze"), Conv2d::new(1, 16).activation(Activation::Relu), &[pooled]);
    let weights = g.conv(&part("excite"), Conv2d::new(1, 64).activation(Activation::Sigmoid), &[squeezed]);
    let nearest = Op::Upsample { factor: STRIDE };
    let weights = g.layer(&part("weights"), nearest, &[weights, x]);
    g.layer(name, Op::Multiply, &[x, weights])
}
