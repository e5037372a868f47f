//! A network as data: named layers and what connects them.

use std::collections::HashSet;

mod error;
mod infer;
mod op;
mod shape;

pub use error::GraphError;
pub use op::{Activation, Border, Conv2d, Layer, Op, Tensor};
pub use shape::Shape;
pub(crate) use shape::pooled;

use infer::infer;
use shape::MAX_SIDE;

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
