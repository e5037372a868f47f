//! Networks as ONNX files, for ONNX Runtime, TensorRT and other readers.
//!
//! The export interprets the same [`Graph`] as the engines. Images are `[1, channels, height, width]` in f32, of any
//! size. Inputs on the LR grid are `height`×`width`; inputs on the HR grid are `scale*height`×`scale*width`. Inputs
//! have the graph's names, and initializers have the weights' names. Outputs have the graph's names as well. But ONNX
//! has one namespace for values, so an output with the name of an input gets `_out` (super sampling reads `color` and
//! gives `color_out`; both networks read `hidden` and give `hidden_out`, which is the next frame's `hidden`). The
//! fields of the weights' header are the file's metadata.
//!
//! Operators are from opset 20, in files of IR version 9, which came with opset 20. Every TensorRT 10 reads opset 20
//! (10.0: 9 to 20, 10.15: 9 to 24), and ONNX Runtime does since 1.17. Opset 20 is the first with a GELU of its own.
//! Only operators that TensorRT 10 lists as supported are used.
//!
//! Weights are f32: runtimes that compute in f16 or bf16 convert when they load.

mod ops;
pub mod proto;
mod warp;
mod writer;

use prost::Message;

use crate::error::WeightError;
use crate::graph::{Graph, Op};
use crate::weights::Weights;
use proto::{ModelProto, OperatorSetIdProto, StringStringEntryProto};
use writer::{Scale, Writer};

/// Version of ONNX's operators.
pub const OPSET: i64 = 20;

/// Version of ONNX's file format.
pub const IR_VERSION: i64 = 9;

/// `graph` with `weights` as the bytes of an ONNX file.
///
/// # Errors
/// [`WeightError`] if the weights are not the graph's.
pub fn export(graph: &Graph, weights: &Weights) -> Result<Vec<u8>, WeightError> {
    Ok(model(graph, weights)?.encode_to_vec())
}

/// `graph` with `weights` in ONNX's terms.
///
/// # Errors
/// [`WeightError`] if the weights are not the graph's.
pub fn model(graph: &Graph, weights: &Weights) -> Result<ModelProto, WeightError> {
    weights.check(graph)?;
    let metadata = weights.header.to_texts().into_iter();
    Ok(ModelProto {
        ir_version: IR_VERSION,
        producer_name: "gs3".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        model_version: graph.version().into(),
        graph: Some(nodes(graph, weights)),
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPSET }],
        metadata_props: metadata.map(|(key, value)| StringStringEntryProto { key, value }).collect(),
    })
}

fn nodes(graph: &Graph, weights: &Weights) -> proto::GraphProto {
    let mut writer = Writer::new(graph.name());
    // Names that others rely on come first.
    let mut values: Vec<Option<String>> = vec![None; graph.layers().len()];
    for (tensor, layer) in graph.inputs() {
        values[tensor.index()] = Some(writer.claim(&layer.name, "_in"));
    }
    let parameters = weights.arrays.iter().map(|(name, array)| (&name[..], writer.weight(name, array)));
    let parameters = parameters.collect();
    let outputs: Vec<String> = graph.outputs().iter().map(|o| writer.claim(&o.name, "_out")).collect();
    for (name, output) in outputs.iter().zip(graph.outputs()) {
        // A layer that is called as what it gives needs no other name.
        let index = output.tensor.index();
        if graph.layers()[index].name == output.name && values[index].is_none() {
            values[index] = Some(name.clone());
        }
    }

    let mut done: Vec<String> = Vec::with_capacity(values.len());
    let mut scales: Vec<Scale> = Vec::with_capacity(values.len());
    for (layer, name) in graph.layers().iter().zip(values) {
        let name = name.unwrap_or_else(|| writer.claim(&layer.name, "_layer"));
        scales.push(scale(&layer.op, layer.inputs.iter().map(|t| scales[t.index()])));
        match layer.op {
            Op::Input { channels, scale } => writer.input(&name, channels, Some(scale)),
            _ => {
                let inputs = layer.inputs.iter().map(|t| (&done[t.index()][..], graph.channels(*t)));
                let inputs: Vec<(&str, usize)> = inputs.collect();
                ops::write(&mut writer, graph.border(), layer, &inputs, &parameters, &name);
            }
        }
        done.push(name);
    }
    for (name, output) in outputs.iter().zip(graph.outputs()) {
        let index = output.tensor.index();
        if done[index] != *name {
            writer.node("Identity", &[&done[index]], name, vec![]);
        }
        writer.output(name, graph.channels(output.tensor), scales[index]);
    }
    writer.finish()
}

/// The grid of a layer's result from the grids of its inputs.
fn scale(op: &Op, mut inputs: impl Iterator<Item = Scale>) -> Scale {
    let first = inputs.next().flatten();
    match op {
        Op::Input { scale, .. } => Some(*scale),
        Op::PixelShuffle { factor } | Op::Upsample { factor } => match inputs.next() {
            Some(like) => like,
            None => first.map(|scale| scale * factor),
        },
        Op::PixelUnshuffle { factor } => first.filter(|s| s % factor == 0).map(|s| s / factor),
        // Half of an odd size, rounded up, is no multiple.
        Op::MaxPool2 | Op::AveragePool { .. } => None,
        _ => first,
    }
}
