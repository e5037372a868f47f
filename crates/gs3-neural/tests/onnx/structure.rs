//! Bytes, decoded again.

use std::collections::{BTreeMap, BTreeSet};

use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::onnx::proto::{self, DimensionLength, ModelProto};
use gs3_neural::onnx::{self, IR_VERSION, OPSET};
use gs3_neural::{Activation, Border, Conv2d, Graph, GraphBuilder, Op, WeightError, Weights};
use prost::Message;

use super::header;

fn exported(graph: &Graph, weights: &Weights) -> (ModelProto, proto::GraphProto) {
    let bytes = onnx::export(graph, weights).expect("an export");
    let model = ModelProto::decode(&bytes[..]).expect("protobuf");
    let nodes = model.graph.clone().expect("a graph");
    (model, nodes)
}

fn networks() -> impl Iterator<Item = Graph> {
    let pairs = Tier::ALL.into_iter().flat_map(|tier| [2, 4].map(|scale| (scale, tier)));
    pairs.flat_map(|(scale, tier)| {
        [super_sample(scale, tier), interpolate(scale, tier)].map(|g| g.expect("a network"))
    })
}

/// Each image's name and sides.
fn images(values: &[proto::ValueInfoProto]) -> Vec<(&str, Vec<String>)> {
    let sides = |value: &proto::ValueInfoProto| -> Vec<String> {
        let tensor = value.r#type.as_ref().and_then(|t| t.tensor_type.as_ref()).expect("a tensor");
        assert_eq!(tensor.elem_type, proto::FLOAT);
        let side = |d: &proto::Dimension| match &d.length {
            Some(DimensionLength::DimValue(value)) => value.to_string(),
            Some(DimensionLength::DimParam(name)) => name.clone(),
            None => "?".to_owned(),
        };
        tensor.shape.iter().flat_map(|shape| shape.dim.iter().map(side)).collect()
    };
    values.iter().map(|value| (&value.name[..], sides(value))).collect()
}

#[test]
fn every_value_is_made_once_before_it_is_read() {
    for graph in networks() {
        let weights = Weights::random(&graph, header(&graph, "any"), 1);
        let (model, nodes) = exported(&graph, &weights);
        assert_eq!((model.ir_version, model.opset_import[0].version), (IR_VERSION, OPSET));
        assert_eq!((model.opset_import.len(), &model.opset_import[0].domain[..]), (1, ""));
        let given = nodes.input.iter().map(|v| &v.name).chain(nodes.initializer.iter().map(|t| &t.name));
        let mut known = BTreeSet::new();
        for name in given {
            assert!(known.insert(name), "{name} twice");
        }
        for node in &nodes.node {
            for input in node.input.iter().filter(|name| !name.is_empty()) {
                assert!(known.contains(input), "{} reads {input}", node.name);
            }
            for output in &node.output {
                assert!(known.insert(output), "{output} twice");
            }
        }
        for output in &nodes.output {
            assert!(known.contains(&output.name), "{} is not made", output.name);
        }
    }
}

#[test]
fn initializers_are_the_weights() {
    for graph in networks() {
        let weights = Weights::random(&graph, header(&graph, "any"), 2);
        let (_, nodes) = exported(&graph, &weights);
        let tensors: BTreeMap<&str, &proto::TensorProto> =
            nodes.initializer.iter().map(|tensor| (&tensor.name[..], tensor)).collect();
        for (name, array) in &weights.arrays {
            let tensor = tensors.get(&name[..]).expect("a tensor of that name");
            assert_eq!(tensor.data_type, proto::FLOAT, "{name}");
            assert!(tensor.dims.iter().map(|d| *d as usize).eq(array.shape().iter().copied()), "{name}");
            let values = tensor.raw_data.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            assert!(values.eq(array.values().iter().copied()), "{name}");
        }
        // Every array is read: the other constants belong to operations and bear a layer's name before a slash.
        let read: BTreeSet<&str> = nodes.node.iter().flat_map(|n| n.input.iter().map(|i| &i[..])).collect();
        for name in tensors.keys() {
            assert!(read.contains(name), "{name} is not read");
            assert!(weights.arrays.contains_key(*name) || name.contains('/'), "{name}");
        }
    }
}

#[test]
fn images_have_the_names_and_grids_of_the_graph() {
    let graph = super_sample(4, Tier::Fast).expect("a network");
    let weights = Weights::random(&graph, header(&graph, "fast"), 1);
    let (model, nodes) = exported(&graph, &weights);
    assert_eq!(nodes.name, "super_sample");
    assert_eq!(model.model_version, i64::from(graph.version()));
    let inputs = images(&nodes.input);
    assert!(inputs.iter().map(|(name, _)| *name).eq(graph.inputs().map(|(_, layer)| &layer.name[..])));
    let sides = |channels: &str, height: &str, width: &str| {
        ["1", channels, height, width].map(str::to_owned).to_vec()
    };
    assert!(inputs.contains(&("history", sides("4", "4*height", "4*width"))));
    assert!(inputs.contains(&("color", sides("3", "height", "width"))));
    // Two values cannot share a name: outputs that are called as inputs are told apart.
    let [color, hidden] =
        [("color_out", sides("4", "4*height", "4*width")), ("hidden_out", sides("16", "height", "width"))];
    assert_eq!(images(&nodes.output), [color, hidden]);
    let metadata: Vec<(&str, &str)> =
        model.metadata_props.iter().map(|entry| (&entry.key[..], &entry.value[..])).collect();
    let version = graph.version().to_string();
    let [network, licence] = ["super_sample", "MIT OR Apache-2.0"];
    let expected = [
        ("network", network),
        ("version", &version),
        ("scale", "4"),
        ("tier", "fast"),
        ("training_data", "nothing"),
        ("licence", licence),
    ];
    assert!(expected.iter().all(|entry| metadata.contains(entry)), "{expected:?} in {metadata:?}");
    assert_eq!(metadata.len(), expected.len());

    let graph = interpolate(2, Tier::Fast).expect("a network");
    let (_, nodes) = exported(&graph, &Weights::random(&graph, header(&graph, "fast"), 1));
    let names: Vec<&str> = images(&nodes.output).iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["color", "alpha_correction", "hidden_out"]);
}

/// ONNX has one space of names; a graph has several.
#[test]
fn names_that_clash_are_told_apart() {
    let mut g = GraphBuilder::new("clash", 1, Border::Replicate);
    let x = g.input("conv.weight", 2, 1);
    let relu = Conv2d::new(3, 2).activation(Activation::Relu);
    let y = g.conv("conv", relu, &[x]);
    let z = g.layer("conv/sum", Op::Add, &[y, x]);
    let z = g.layer("conv/padded", Op::MaxPool2, &[z]);
    g.output("conv", z);
    g.output("conv.weight", x);
    g.output("conv/sum", y);
    let graph = g.finish().expect("a graph");
    let (_, nodes) = exported(&graph, &Weights::random(&graph, header(&graph, ""), 1));
    let values = nodes.node.iter().flat_map(|node| node.output.iter());
    let values =
        values.chain(nodes.initializer.iter().map(|t| &t.name)).chain(nodes.input.iter().map(|i| &i.name));
    let all: Vec<&String> = values.collect();
    assert_eq!(all.iter().collect::<BTreeSet<_>>().len(), all.len(), "{all:?}");
    let half = ["1", "2", "?", "?"].map(str::to_owned).to_vec();
    let full = ["1", "2", "height", "width"].map(str::to_owned).to_vec();
    assert_eq!(
        images(&nodes.output),
        [("conv", half), ("conv.weight_out", full.clone()), ("conv/sum", full)]
    );
}

#[test]
fn weights_of_another_network_are_refused() {
    let [fast, high] = [Tier::Fast, Tier::High].map(|tier| super_sample(4, tier).expect("a network"));
    let weights = Weights::random(&fast, header(&fast, "fast"), 1);
    assert!(matches!(onnx::export(&high, &weights), Err(WeightError::Shape { .. })));
}
