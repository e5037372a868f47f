//! Layers, and what they do.

use std::ops::RangeInclusive;

/// The result of a layer: what other layers connect to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tensor(pub(crate) usize);

impl Tensor {
    /// Place of its layer in [`Graph::layers`](super::Graph::layers).
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

/// A function of each number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    /// x.
    Identity,
    /// max(x, 0).
    Relu,
    /// x where positive, else `slope` · x.
    LeakyRelu {
        /// Slope of the negative side.
        slope: f32,
    },
    /// x Φ(x), Φ the normal distribution (the exact form, not that by tanh).
    Gelu,
    /// x σ(x).
    Silu,
    /// σ(x) = 1 / (1 + e⁻ˣ).
    Sigmoid,
    /// tanh x.
    Tanh,
}

/// A convolution of stride 1. Its result has the size of its input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conv2d {
    /// Side of the window, odd.
    pub kernel: usize,
    /// Distance of the window's taps in pixels.
    pub dilation: usize,
    /// Channels of the result.
    pub outputs: usize,
    /// Whether a number is added to each output channel.
    pub bias: bool,
    /// Applied to the result.
    pub activation: Activation,
}

impl Conv2d {
    /// A window of `kernel`×`kernel` to `outputs` channels, with bias and without activation.
    #[must_use]
    pub const fn new(kernel: usize, outputs: usize) -> Self {
        Self { kernel, dilation: 1, outputs, bias: true, activation: Activation::Identity }
    }

    /// The same with `activation`.
    #[must_use]
    pub fn activation(self, activation: Activation) -> Self {
        Self { activation, ..self }
    }

    /// The same with taps `dilation` pixels apart.
    #[must_use]
    pub fn dilation(self, dilation: usize) -> Self {
        Self { dilation, ..self }
    }

    /// Pixels that the window reaches beyond its centre.
    #[must_use]
    pub fn reach(&self) -> usize {
        self.kernel / 2 * self.dilation
    }
}

/// What convolutions see outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// Zeros, as published networks.
    Zero,
    /// The nearest pixel: a flat image stays flat.
    Replicate,
}

/// What a layer does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Op {
    /// An image given from outside, `scale` times as wide and high as the LR grid.
    Input {
        /// Its channels.
        channels: usize,
        /// HR pixels per LR pixel along a side.
        scale: usize,
    },
    /// A convolution with the weights of the layer's name.
    Conv2d(Conv2d),
    /// A function of each number.
    Activate(Activation),
    /// Channel c·f² + i·f + j goes to pixel (f·y + i, f·x + j) of channel c. A second input gives a size to crop to.
    PixelShuffle {
        /// f.
        factor: usize,
    },
    /// The inverse of [`Op::PixelShuffle`].
    PixelUnshuffle {
        /// f.
        factor: usize,
    },
    /// Repeats each pixel `factor` times along each side. A second input gives a size to crop to.
    Upsample {
        /// Enlargement along a side.
        factor: usize,
    },
    /// x where positive, else the learned `weight` of the channel times x (He et al. 2015).
    Prelu,
    /// The channels of a pixel brought to mean 0 and variance 1, times the learned `weight` plus `bias` of the
    /// channel (Ba et al. 2016, over channels only).
    LayerNorm {
        /// Added to the variance.
        epsilon: f32,
    },
    /// x · factor.
    Scale {
        /// The factor.
        factor: f32,
    },
    /// A constant colour added: red to the first third of the channels, green to the second, blue to the last.
    Shift {
        /// The colour.
        color: [f32; 3],
    },
    /// The largest number of each 2×2 pixels; an odd last row or column stands alone.
    MaxPool2,
    /// The mean of the `side`×`side` pixels around every `stride`-th pixel of every `stride`-th row, of those within
    /// the image.
    AveragePool {
        /// Side of the window, odd.
        side: usize,
        /// Distance of windows, at most `side`.
        stride: usize,
    },
    /// All channels of all inputs.
    Concat,
    /// Channels `first..first + count`.
    Slice {
        /// The first.
        first: usize,
        /// How many.
        count: usize,
    },
    /// a + b.
    Add,
    /// a · factor, the factor having as many channels or one.
    Multiply,
    /// a + t (b − a), t having as many channels or one.
    Mix,
    /// The mean over channels.
    ChannelMean,
    /// The largest over channels.
    ChannelMax,
    /// The image at (x + flow₀, y + flow₁), in pixels, bilinear, clamped to the image.
    Warp,
}

impl Op {
    /// How many inputs it takes.
    pub(crate) fn inputs(&self) -> RangeInclusive<usize> {
        match self {
            Self::Input { .. } => 0..=0,
            Self::PixelShuffle { .. } | Self::Upsample { .. } => 1..=2,
            Self::Add | Self::Multiply | Self::Warp => 2..=2,
            Self::Mix => 3..=3,
            Self::Concat => 1..=usize::MAX,
            _ => 1..=1,
        }
    }

    /// What it learns where its input has `channels`: kinds and shapes.
    pub(crate) fn parameters(&self, channels: usize) -> Vec<(&'static str, Vec<usize>)> {
        match self {
            Self::Conv2d(conv) => {
                let weight = ("weight", vec![conv.outputs, channels, conv.kernel, conv.kernel]);
                let bias = conv.bias.then(|| ("bias", vec![conv.outputs]));
                std::iter::once(weight).chain(bias).collect()
            }
            Self::Prelu => vec![("weight", vec![channels])],
            Self::LayerNorm { .. } => vec![("weight", vec![channels]), ("bias", vec![channels])],
            _ => Vec::new(),
        }
    }

    /// By how much it changes sizes, or the side of its window.
    pub(crate) fn factor(&self) -> Option<usize> {
        match self {
            Self::Input { scale: factor, .. }
            | Self::PixelShuffle { factor }
            | Self::PixelUnshuffle { factor }
            | Self::Upsample { factor }
            | Self::AveragePool { side: factor, .. }
            | Self::Conv2d(Conv2d { kernel: factor, .. }) => Some(*factor),
            _ => None,
        }
    }
}

/// An operation with its name and what it reads.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Unique in the graph; its weights are `name.weight` and `name.bias`.
    pub name: String,
    /// What it does.
    pub op: Op,
    /// What it reads: results of layers before it.
    pub inputs: Vec<Tensor>,
}
