//! A network as data: named layers and what connects them.

use std::collections::HashSet;
use std::ops::RangeInclusive;

use crate::error::GraphError;
use crate::shape::{MAX_SIDE, Shape, infer};

/// The result of a layer: what other layers connect to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tensor(pub(crate) usize);

impl Tensor {
    /// Place of its layer in [`Graph::layers`].
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

/// A named result of a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Its name.
    pub name: String,
    /// Where it comes from.
    pub tensor: Tensor,
}

/// An array of numbers to be learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// `layer.weight` or `layer.bias`.
    pub name: String,
    /// Of convolutions weights `[outputs, inputs, kernel, kernel]` (`oihw`) and biases `[outputs]`, else `[channels]`.
    pub shape: Vec<usize>,
}

/// A network: layers in an order in which they can be run.
#[derive(Clone, Debug, PartialEq)]
pub struct Graph {
    name: String,
    version: u32,
    border: Border,
    layers: Vec<Layer>,
    outputs: Vec<Output>,
    /// Channels of each layer's result.
    channels: Vec<usize>,
}

impl Graph {
    /// Name of the network.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Changes whenever weights of older graphs stop fitting or meaning the same.
    #[must_use]
    pub fn version(&self) -> u32 {
        self.version
    }

    /// What convolutions see outside the image.
    #[must_use]
    pub fn border(&self) -> Border {
        self.border
    }

    /// All layers; each reads only those before it.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// The named results.
    #[must_use]
    pub fn outputs(&self) -> &[Output] {
        &self.outputs
    }

    /// Channels of `tensor`.
    #[must_use]
    pub fn channels(&self, tensor: Tensor) -> usize {
        self.channels[tensor.0]
    }

    /// The layers given from outside.
    pub fn inputs(&self) -> impl Iterator<Item = (Tensor, &Layer)> {
        let layers = self.layers.iter().enumerate().map(|(k, layer)| (Tensor(k), layer));
        layers.filter(|(_, layer)| matches!(layer.op, Op::Input { .. }))
    }

    /// The shape of each layer's result for an LR grid of `[height, width]`.
    ///
    /// # Errors
    /// [`GraphError`] if the network cannot take that size.
    pub fn shapes(&self, lr: [usize; 2]) -> Result<Vec<Shape>, GraphError> {
        if lr.iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(GraphError::Size { width: lr[1], height: lr[0], max: MAX_SIDE });
        }
        let mut shapes: Vec<Shape> = Vec::with_capacity(self.layers.len());
        for layer in &self.layers {
            let inputs: Vec<Shape> = layer.inputs.iter().map(|t| shapes[t.0]).collect();
            shapes.push(infer(layer, &inputs, lr)?);
        }
        Ok(shapes)
    }

    /// Everything to be learned, in the order of the layers.
    #[must_use]
    pub fn parameters(&self) -> Vec<Parameter> {
        let mut parameters = Vec::new();
        for layer in &self.layers {
            let [input] = layer.inputs[..] else { continue };
            let learned = layer.op.parameters(self.channels[input.0]).into_iter();
            parameters.extend(
                learned.map(|(kind, shape)| Parameter { name: format!("{}.{kind}", layer.name), shape }),
            );
        }
        parameters
    }

    /// Multiply-adds of all convolutions for an LR grid of `[height, width]`, per LR pixel.
    ///
    /// # Errors
    /// [`GraphError`] if the network cannot take that size.
    pub fn multiply_adds_per_pixel(&self, lr: [usize; 2]) -> Result<f64, GraphError> {
        let shapes = self.shapes(lr)?;
        let mut total = 0.0;
        for (layer, shape) in self.layers.iter().zip(&shapes) {
            if let (Op::Conv2d(conv), [input]) = (&layer.op, &layer.inputs[..]) {
                total += shape.len() as f64 * (self.channels[input.0] * conv.kernel * conv.kernel) as f64;
            }
        }
        Ok(total / (lr[0] * lr[1]) as f64)
    }
}

/// Builds a graph, layer by layer. The first mistake is reported by [`GraphBuilder::finish`].
#[derive(Clone, Debug)]
pub struct GraphBuilder {
    graph: Graph,
    shapes: Vec<Shape>,
    error: Option<GraphError>,
}

/// The LR grid on which a graph is checked while it is built: sides that six poolings leave whole.
const NOMINAL: [usize; 2] = [64, 64];

impl GraphBuilder {
    /// An empty graph.
    #[must_use]
    pub fn new(name: &str, version: u32, border: Border) -> Self {
        let name = name.to_owned();
        let graph =
            Graph { name, version, border, layers: Vec::new(), outputs: Vec::new(), channels: Vec::new() };
        Self { graph, shapes: Vec::new(), error: None }
    }

    /// Adds a layer.
    pub fn layer(&mut self, name: &str, op: Op, inputs: &[Tensor]) -> Tensor {
        let layer = Layer { name: name.to_owned(), op, inputs: inputs.to_vec() };
        let shapes: Vec<Shape> = inputs.iter().map(|t| self.shapes[t.0]).collect();
        let shape = infer(&layer, &shapes, NOMINAL).unwrap_or_else(|error| {
            self.error.get_or_insert(error);
            // Later layers are not reported: only the first mistake is.
            Shape { height: NOMINAL[0], width: NOMINAL[1], channels: 1 }
        });
        self.shapes.push(shape);
        self.graph.channels.push(shape.channels);
        self.graph.layers.push(layer);
        Tensor(self.graph.layers.len() - 1)
    }

    /// An image given from outside, on the grid `scale` times as fine as the LR grid.
    pub fn input(&mut self, name: &str, channels: usize, scale: usize) -> Tensor {
        self.layer(name, Op::Input { channels, scale }, &[])
    }

    /// A convolution; several inputs are concatenated.
    pub fn conv(&mut self, name: &str, conv: Conv2d, inputs: &[Tensor]) -> Tensor {
        match inputs {
            [input] => self.layer(name, Op::Conv2d(conv), &[*input]),
            _ => {
                let all = self.layer(&format!("{name}.inputs"), Op::Concat, inputs);
                self.layer(name, Op::Conv2d(conv), &[all])
            }
        }
    }

    /// A gated recurrent unit on images (Cho et al. 2014, with convolutions): `h + z (c − h)`, z and r = σ(gates(x,
    /// h)), c = tanh(candidate(x, r h)). `gates` is the side of the gates' windows; h has as many channels as the
    /// result.
    pub fn gated_recurrent_unit(&mut self, name: &str, gates: usize, x: Tensor, h: Tensor) -> Tensor {
        let part = |part: &str| format!("{name}.{part}");
        let channels = self.graph.channels[h.0];
        let gate = Conv2d::new(gates, channels).activation(Activation::Sigmoid);
        let all = self.layer(&part("inputs"), Op::Concat, &[x, h]);
        let update = self.conv(&part("update"), gate, &[all]);
        let reset = self.conv(&part("reset"), gate, &[all]);
        let kept = self.layer(&part("kept"), Op::Multiply, &[h, reset]);
        let candidate = Conv2d::new(3, channels).activation(Activation::Tanh);
        let candidate = self.conv(&part("candidate"), candidate, &[x, kept]);
        self.layer(&part("state"), Op::Mix, &[h, candidate, update])
    }

    /// Names a result of the graph.
    pub fn output(&mut self, name: &str, tensor: Tensor) {
        self.graph.outputs.push(Output { name: name.to_owned(), tensor });
    }

    /// The finished graph.
    ///
    /// # Errors
    /// [`GraphError`] naming the first layer that does not fit, or that has the name of another.
    pub fn finish(self) -> Result<Graph, GraphError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let mut names = HashSet::new();
        if let Some(twice) = self.graph.layers.iter().find(|layer| !names.insert(&layer.name)) {
            return Err(GraphError::Duplicate { layer: twice.name.clone() });
        }
        let mut names = HashSet::new();
        match self.graph.outputs.iter().find(|output| !names.insert(&output.name)) {
            Some(twice) => Err(GraphError::Duplicate { layer: twice.name.clone() }),
            None => Ok(self.graph),
        }
    }
}
