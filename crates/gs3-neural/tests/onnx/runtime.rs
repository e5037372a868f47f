//! ONNX Runtime against the reference, the CPU engine and the trainer's forward pass, on the same inputs.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use gs3_neural::arrays::{self, Array, Arrays};
use gs3_neural::model::{PublishedNetwork, Tier, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, Differentiator, Engine, Graph, GraphBuilder, Op, Random, Shape, Weights,
    onnx, reference,
};

use super::header;
use super::operations::operations;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/oracle/onnx_runtime.py");

/// Writes `graph` and, for each LR size `[height, width]`, inputs and the outputs that are expected.
fn write(folder: &Path, name: &str, graph: &Graph, sizes: &[[usize; 2]]) {
    let mut weights = Weights::random(graph, header(graph, name), 5);
    // Biases start as zero.
    for array in weights.arrays.values_mut().filter(|array| array.shape().len() == 1) {
        array.values_mut().iter_mut().enumerate().for_each(|(k, v)| *v = k as f32 * 0.01 - 0.1);
    }
    let bytes = onnx::export(graph, &weights).expect("an export");
    std::fs::write(folder.join(format!("{name}.onnx")), bytes).expect("written");
    for lr in sizes {
        let arrays = example(graph, &weights, *lr);
        let path = folder.join(format!("{name}.{}x{}.safetensors", lr[1], lr[0]));
        arrays::save(&path, &Default::default(), &arrays).expect("written");
    }
}

fn example(graph: &Graph, weights: &Weights, lr: [usize; 2]) -> Arrays {
    let shapes = graph.shapes(lr).expect("a size it takes");
    let mut random = Random::new(3);
    let mut images: Vec<(&str, Vec<f32>)> = Vec::new();
    let mut arrays = Arrays::new();
    for (tensor, layer) in graph.inputs() {
        let shape = shapes[tensor.index()];
        // Flows lead a few pixels away, out of the image too, and now and then very far.
        let reach = if ["flow", "motion"].contains(&&layer.name[..]) { 4.0 } else { 1.0 };
        let mut image: Vec<f32> = (0..shape.len()).map(|_| reach * random.signed()).collect();
        if reach > 1.0 {
            image.iter_mut().step_by(13).for_each(|v| *v *= 1e12);
        }
        arrays.insert(format!("input/{}", layer.name), channels_first(shape, &image));
        images.push((&layer.name, image));
    }
    let images: Vec<(&str, &[f32])> = images.iter().map(|(name, image)| (*name, &image[..])).collect();
    let planes = reference::run(graph, weights, lr, &images).expect("the reference runs");
    let mut engine = Engine::new(graph, weights, lr).expect("an engine");
    let trainer = Differentiator::new(graph, lr, &[]).expect("a differentiator");
    let mut tape = trainer.tape();
    trainer.forward(&trainer.pack(weights).expect("its weights"), &images, &mut tape).expect("it runs");
    for output in graph.outputs() {
        let name = match graph.inputs().any(|(_, layer)| layer.name == output.name) {
            true => format!("{}_out", output.name),
            false => output.name.clone(),
        };
        let shape = shapes[output.tensor.index()];
        let values: Vec<f32> = planes[output.tensor.index()].values.iter().map(|v| *v as f32).collect();
        arrays.insert(format!("reference/{name}"), channels_first(shape, &values));
        let mut values = vec![0.0; shape.len()];
        engine.run(&images, &mut [(&output.name, &mut values)]).expect("the engine runs");
        arrays.insert(format!("engine/{name}"), channels_first(shape, &values));
        trainer.output(&tape, &output.name, &mut values).expect("the trainer ran");
        arrays.insert(format!("trainer/{name}"), channels_first(shape, &values));
    }
    arrays
}

/// An image with channels last as `[1, channels, height, width]`.
fn channels_first(shape: Shape, image: &[f32]) -> Array {
    let planes = (0..shape.channels).flat_map(|c| image.iter().skip(c).step_by(shape.channels).copied());
    Array::new("image", &[1, shape.channels, shape.height, shape.width], planes.collect()).expect("as many")
}

/// A Python that has what the script imports; without one, says so.
fn python() -> Option<Command> {
    let imports = "import numpy, onnx, onnxruntime, safetensors";
    let found = Command::new("python3").args(["-c", imports]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(Command::new("python3"));
    }
    eprintln!("skipped: python3 with onnx, onnxruntime and safetensors is not there");
    None
}

/// Runs the script on `folder`.
fn compare(mut python: Command, folder: &Path) {
    let output = python.arg(SCRIPT).arg(folder).output().expect("python runs");
    let [said, errors] =
        [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    println!("{said}");
    assert!(output.status.success(), "{said}{errors}");
}

#[test]
fn onnx_runtime_computes_all_networks() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    for tier in Tier::ALL {
        for scale in [2, 4] {
            for graph in [super_sample(scale, tier), interpolate(scale, tier)] {
                let graph = graph.expect("a network");
                let name = format!("{}-{scale}-{}", graph.name(), tier.name());
                write(folder.path(), &name, &graph, &[[11, 27], [16, 10]]);
            }
        }
    }
    for peer in PublishedNetwork::ALL {
        write(folder.path(), peer.name(), &peer.graph(4).expect("a network"), &[[10, 26], [34, 18]]);
    }
    compare(python, folder.path());
}

/// A graph of one operation on images `a`, `b` and `c`, a factor `f` of one channel and a `flow`.
fn single(op: Op, channels: usize, inputs: &[&str], border: Border) -> Graph {
    let mut g = GraphBuilder::new("single", 1, border);
    let mut images = BTreeMap::new();
    for name in inputs {
        let channels = match *name {
            "f" => 1,
            "flow" => 2,
            _ => channels,
        };
        images.entry(*name).or_insert_with(|| g.input(name, channels, 1));
    }
    let read: Vec<_> = inputs.iter().map(|name| images[name]).collect();
    let result = g.layer("result", op, &read);
    g.output("result", result);
    g.finish().expect("a graph")
}

const ACTIVATIONS: [Activation; 7] = [
    Activation::Identity,
    Activation::Relu,
    Activation::LeakyRelu { slope: 0.2 },
    Activation::Gelu,
    Activation::Silu,
    Activation::Sigmoid,
    Activation::Tanh,
];

#[test]
fn onnx_runtime_computes_every_operation() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mut cases: Vec<(Op, Vec<&str>)> = operations();
    // Further shapes of the nodes that stand for these.
    cases.extend([
        (Op::PixelShuffle { factor: 1 }, vec!["a"]),
        (Op::PixelShuffle { factor: 3 }, vec!["a"]),
        (Op::PixelUnshuffle { factor: 1 }, vec!["a"]),
        (Op::Upsample { factor: 1 }, vec!["a"]),
        (Op::Upsample { factor: 5 }, vec!["a"]),
        (Op::Concat, vec!["a"]),
        (Op::Mix, vec!["a", "b", "c"]),
    ]);
    cases.extend(ACTIVATIONS.map(|activation| (Op::Activate(activation), vec!["a"])));
    let convolutions = [(3, 1), (1, 1), (7, 3), (5, 2)].into_iter().zip(ACTIVATIONS.into_iter().cycle());
    for (k, ((kernel, dilation), activation)) in convolutions.enumerate() {
        let conv = Conv2d::new(kernel, 5).dilation(dilation).activation(activation);
        cases.push((Op::Conv2d(Conv2d { bias: k % 2 == 0, ..conv }), vec!["a"]));
    }
    for (k, (op, inputs)) in cases.iter().enumerate() {
        for border in [Border::Zero, Border::Replicate] {
            if border == Border::Replicate && !matches!(op, Op::Conv2d(_)) {
                continue;
            }
            let graph = single(*op, 36, inputs, border);
            // 5×7 pixels, and a single one, from which every border is a step away.
            write(folder.path(), &format!("{k:02}-{border:?}"), &graph, &[[5, 7], [1, 1]]);
        }
    }
    let shift = single(Op::Shift { color: [0.5, -0.2, 0.1] }, 48, &["a"], Border::Zero);
    write(folder.path(), "shift", &shift, &[[5, 7]]);
    for (k, channels) in [1, 4].into_iter().enumerate() {
        let graph = single(Op::PixelUnshuffle { factor: 2 }, channels, &["a"], Border::Zero);
        write(folder.path(), &format!("unshuffle-{k}"), &graph, &[[4, 6], [2, 2]]);
    }
    compare(python, folder.path());
}
