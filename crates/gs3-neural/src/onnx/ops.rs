//! Operations as nodes of ONNX.

use std::collections::BTreeMap;

use super::proto::AttributeProto;
use super::warp;
use super::writer::Writer;
use crate::graph::{Activation, Border, Conv2d, Layer, Op};

/// Writes the nodes of `layer`. `inputs` are names of values with their channels, `parameters` names of learned
/// numbers in the file by those in the graph, `result` is the name of the layer's result.
pub fn write(
    writer: &mut Writer,
    border: Border,
    layer: &Layer,
    inputs: &[(&str, usize)],
    parameters: &BTreeMap<&str, String>,
    result: &str,
) {
    let x: Vec<&str> = inputs.iter().map(|(name, _)| *name).collect();
    let mut nodes = Nodes { writer, layer: &layer.name, result };
    match &layer.op {
        // Declared, not computed.
        Op::Input { .. } => {}
        Op::Conv2d(conv) => {
            let parameter = |kind: &str| parameters.get(&format!("{}.{kind}", layer.name)[..]);
            let learned = [parameter("weight"), parameter("bias")];
            let learned: Vec<&str> = learned.into_iter().flatten().map(|name| &name[..]).collect();
            nodes.convolution(conv, border, x[0], &learned);
        }
        Op::Activate(activation) => nodes.activation(*activation, x[0]),
        Op::PixelShuffle { factor } => {
            // Channel c·f² + i·f + j: "column, row, depth" order.
            let attributes =
                vec![AttributeProto::int("blocksize", *factor as i64), AttributeProto::text("mode", "CRD")];
            nodes.cropped("DepthToSpace", &x[..1], attributes, x.get(1).copied());
        }
        Op::PixelUnshuffle { factor } => nodes.pixel_unshuffle(*factor, inputs[0]),
        Op::Upsample { factor } => {
            let factor = *factor as f32;
            let scales = nodes.writer.floats(&nodes.name("scales"), &[4], &[1.0, 1.0, factor, factor]);
            let attributes = vec![
                AttributeProto::text("mode", "nearest"),
                AttributeProto::text("coordinate_transformation_mode", "asymmetric"),
                AttributeProto::text("nearest_mode", "floor"),
            ];
            nodes.cropped("Resize", &[x[0], "", &scales], attributes, x.get(1).copied());
        }
        Op::MaxPool2 => nodes.result(
            "MaxPool",
            &x,
            vec![
                AttributeProto::ints("kernel_shape", &[2, 2]),
                AttributeProto::ints("strides", &[2, 2]),
                // An odd last row or column stands alone.
                AttributeProto::int("ceil_mode", 1),
            ],
        ),
        Op::Prelu => {
            // One number a channel, for all rows and columns.
            let slopes = parameters.get(&format!("{}.weight", layer.name)[..]).map_or("", |name| name);
            let axes = nodes.ints("axes", &[1, 2]);
            let slopes = nodes.inner("slopes", "Unsqueeze", &[slopes, &axes], vec![]);
            nodes.result("PRelu", &[x[0], &slopes], vec![]);
        }
        Op::LayerNorm { epsilon } => {
            // ONNX normalises the last axes: channels go there and back.
            let learned = ["weight", "bias"]
                .map(|kind| parameters.get(&format!("{}.{kind}", layer.name)[..]).map_or("", |name| name));
            let last =
                nodes.inner("last", "Transpose", &[x[0]], vec![AttributeProto::ints("perm", &[0, 2, 3, 1])]);
            let attributes =
                vec![AttributeProto::int("axis", -1), AttributeProto::float("epsilon", *epsilon)];
            let normal =
                nodes.inner("normal", "LayerNormalization", &[&last, learned[0], learned[1]], attributes);
            nodes.result("Transpose", &[&normal], vec![AttributeProto::ints("perm", &[0, 3, 1, 2])]);
        }
        Op::Scale { factor } => {
            let factor = nodes.constant("factor", *factor);
            nodes.result("Mul", &[x[0], &factor], vec![]);
        }
        Op::Shift { color } => {
            let channels = inputs[0].1;
            let each: Vec<f32> = (0..channels).map(|c| color[3 * c / channels]).collect();
            let color = nodes.writer.floats(&nodes.name("color"), &[1, channels as i64, 1, 1], &each);
            nodes.result("Add", &[x[0], &color], vec![]);
        }
        Op::AveragePool { side, stride } => {
            let (reach, side, stride) = ((side / 2) as i64, *side as i64, *stride as i64);
            let attributes = vec![
                AttributeProto::ints("kernel_shape", &[side; 2]),
                AttributeProto::ints("strides", &[stride; 2]),
                AttributeProto::ints("pads", &[reach; 4]),
                AttributeProto::int("count_include_pad", 0),
            ];
            nodes.result("AveragePool", &x, attributes);
        }
        Op::Concat => nodes.result("Concat", &x, vec![AttributeProto::int("axis", 1)]),
        Op::Slice { first, count } => {
            let starts = nodes.ints("first", &[*first as i64]);
            let ends = nodes.ints("end", &[(first + count) as i64]);
            let axes = nodes.ints("axes", &[1]);
            nodes.result("Slice", &[x[0], &starts, &ends, &axes], vec![]);
        }
        Op::Add => nodes.result("Add", &x, vec![]),
        Op::Multiply => nodes.result("Mul", &x, vec![]),
        Op::Mix => {
            let difference = nodes.inner("difference", "Sub", &[x[1], x[0]], vec![]);
            let share = nodes.inner("share", "Mul", &[&difference, x[2]], vec![]);
            nodes.result("Add", &[x[0], &share], vec![]);
        }
        Op::ChannelMean | Op::ChannelMax => {
            let axes = nodes.ints("axes", &[1]);
            let op_type = if layer.op == Op::ChannelMax { "ReduceMax" } else { "ReduceMean" };
            nodes.result(op_type, &[x[0], &axes], vec![AttributeProto::int("keepdims", 1)]);
        }
        Op::Warp => warp::write(&mut nodes, x[0], x[1]),
    }
}

/// The nodes of one layer.
pub struct Nodes<'a> {
    writer: &'a mut Writer,
    /// The layer's name.
    layer: &'a str,
    /// The name of its result.
    result: &'a str,
}

impl Nodes<'_> {
    /// The name of a part of the layer.
    fn name(&self, part: &str) -> String {
        format!("{}/{part}", self.layer)
    }

    /// A node within the layer; gives the name of its result.
    pub fn inner(
        &mut self,
        part: &str,
        op_type: &str,
        inputs: &[&str],
        attributes: Vec<AttributeProto>,
    ) -> String {
        let output = self.writer.claim(&self.name(part), "_value");
        self.writer.node(op_type, inputs, &output, attributes);
        output
    }

    /// The node that gives the layer's result.
    pub fn result(&mut self, op_type: &str, inputs: &[&str], attributes: Vec<AttributeProto>) {
        self.writer.node(op_type, inputs, self.result, attributes);
    }

    /// A list of whole numbers.
    pub fn ints(&mut self, part: &str, values: &[i64]) -> String {
        self.writer.ints(&self.name(part), &[values.len() as i64], values)
    }

    /// A single whole number.
    pub fn index(&mut self, part: &str, value: i64) -> String {
        self.writer.ints(&self.name(part), &[], &[value])
    }

    /// A single number.
    pub fn constant(&mut self, part: &str, value: f32) -> String {
        self.writer.floats(&self.name(part), &[], &[value])
    }

    fn convolution(&mut self, conv: &Conv2d, border: Border, x: &str, learned: &[&str]) {
        let (kernel, dilation, reach) = (conv.kernel as i64, conv.dilation as i64, conv.reach() as i64);
        let (x, pads) = match border {
            Border::Replicate if reach > 0 => {
                let pads = self.ints("pads", &[0, 0, reach, reach, 0, 0, reach, reach]);
                let edge = vec![AttributeProto::text("mode", "edge")];
                (self.inner("padded", "Pad", &[x, &pads], edge), 0)
            }
            _ => (x.to_owned(), reach),
        };
        let inputs: Vec<&str> = std::iter::once(&x[..]).chain(learned.iter().copied()).collect();
        let attributes = vec![
            AttributeProto::ints("kernel_shape", &[kernel; 2]),
            AttributeProto::ints("dilations", &[dilation; 2]),
            AttributeProto::ints("pads", &[pads; 4]),
        ];
        if conv.activation == Activation::Identity {
            return self.result("Conv", &inputs, attributes);
        }
        let sum = self.inner("sum", "Conv", &inputs, attributes);
        self.activation(conv.activation, &sum);
    }

    fn activation(&mut self, activation: Activation, x: &str) {
        let (op_type, attributes) = match activation {
            Activation::Identity => ("Identity", vec![]),
            Activation::Relu => ("Relu", vec![]),
            Activation::LeakyRelu { slope } => ("LeakyRelu", vec![AttributeProto::float("alpha", slope)]),
            Activation::Gelu => ("Gelu", vec![AttributeProto::text("approximate", "none")]),
            Activation::Silu => {
                let gate = self.inner("gate", "Sigmoid", &[x], vec![]);
                return self.result("Mul", &[x, &gate], vec![]);
            }
            Activation::Sigmoid => ("Sigmoid", vec![]),
            Activation::Tanh => ("Tanh", vec![]),
        };
        self.result(op_type, &[x], attributes);
    }

    /// A node with its result cut to the size of `like`, if there is one.
    fn cropped(
        &mut self,
        op_type: &str,
        inputs: &[&str],
        attributes: Vec<AttributeProto>,
        like: Option<&str>,
    ) {
        let Some(like) = like else { return self.result(op_type, inputs, attributes) };
        let full = self.inner("full", op_type, inputs, attributes);
        let size = self.inner("size", "Shape", &[like], vec![AttributeProto::int("start", 2)]);
        let starts = self.ints("origin", &[0, 0]);
        let axes = self.ints("axes", &[2, 3]);
        self.result("Slice", &[&full, &starts, &size, &axes], vec![]);
    }

    fn pixel_unshuffle(&mut self, factor: usize, (x, channels): (&str, usize)) {
        let places = factor * factor;
        let attributes = vec![AttributeProto::int("blocksize", factor as i64)];
        if channels == 1 || places == 1 {
            return self.result("SpaceToDepth", &[x], attributes);
        }
        // SpaceToDepth gives channel k·C + c where the graph has c·f² + k, k = i·f + j.
        let blocks = self.inner("blocks", "SpaceToDepth", &[x], attributes);
        let order = (0..channels).flat_map(|c| (0..places).map(move |k| (k * channels + c) as i64));
        let order = self.ints("order", &order.collect::<Vec<i64>>());
        self.result("Gather", &[&blocks, &order], vec![AttributeProto::int("axis", 1)]);
    }
}
