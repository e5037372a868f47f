//! A graph of ONNX that grows: values with names of their own, nodes, constants.

use std::collections::HashSet;

use super::proto::{
    AttributeProto, Dimension, DimensionLength, FLOAT, GraphProto, INT64, NodeProto, TensorProto,
    TensorShape, TensorType, TypeProto, ValueInfoProto,
};
use crate::arrays::Array;

/// HR pixels per LR pixel along a side, where an image is on such a grid.
pub type Scale = Option<usize>;

pub struct Writer {
    graph: GraphProto,
    names: HashSet<String>,
}

impl Writer {
    pub fn new(name: &str) -> Self {
        Self { graph: GraphProto { name: name.to_owned(), ..GraphProto::default() }, names: HashSet::new() }
    }

    pub fn finish(self) -> GraphProto {
        self.graph
    }

    /// A name that nothing else has: `wanted`, with `suffix` as often as it takes.
    pub fn claim(&mut self, wanted: &str, suffix: &str) -> String {
        let mut name = wanted.to_owned();
        while !self.names.insert(name.clone()) {
            name.push_str(suffix);
        }
        name
    }

    /// Declares what comes from outside.
    pub fn input(&mut self, name: &str, channels: usize, scale: Scale) {
        self.graph.input.push(image(name, channels, scale));
    }

    /// Declares a result.
    pub fn output(&mut self, name: &str, channels: usize, scale: Scale) {
        self.graph.output.push(image(name, channels, scale));
    }

    /// Writes learned numbers and gives their name in the file.
    pub fn weight(&mut self, name: &str, array: &Array) -> String {
        let dims: Vec<i64> = array.shape().iter().map(|side| *side as i64).collect();
        self.floats(name, &dims, array.values())
    }

    /// Writes constants and gives their name in the file.
    pub fn floats(&mut self, name: &str, dims: &[i64], values: &[f32]) -> String {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, dims, FLOAT, bytes)
    }

    /// Writes constants and gives their name in the file. No `dims` stand for a single number.
    pub fn ints(&mut self, name: &str, dims: &[i64], values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, dims, INT64, bytes)
    }

    fn constant(&mut self, name: &str, dims: &[i64], data_type: i32, raw_data: Vec<u8>) -> String {
        let name = self.claim(name, "_constant");
        self.graph.initializer.push(TensorProto {
            dims: dims.to_vec(),
            data_type,
            name: name.clone(),
            raw_data,
        });
        name
    }

    /// Writes a node, called as its result.
    pub fn node(&mut self, op_type: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>) {
        self.graph.node.push(NodeProto {
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![output.to_owned()],
            name: output.to_owned(),
            op_type: op_type.to_owned(),
            attribute,
        });
    }
}

/// An image of `[1, channels, height, width]`.
fn image(name: &str, channels: usize, scale: Scale) -> ValueInfoProto {
    let side = |side: &str| match scale {
        Some(1) => Some(DimensionLength::DimParam(side.to_owned())),
        Some(scale) => Some(DimensionLength::DimParam(format!("{scale}*{side}"))),
        None => None,
    };
    let lengths = [
        Some(DimensionLength::DimValue(1)),
        Some(DimensionLength::DimValue(channels as i64)),
        side("height"),
        side("width"),
    ];
    let shape = TensorShape { dim: lengths.map(|length| Dimension { length }).into() };
    let tensor_type = TensorType { elem_type: FLOAT, shape: Some(shape) };
    ValueInfoProto { name: name.to_owned(), r#type: Some(TypeProto { tensor_type: Some(tensor_type) }) }
}
