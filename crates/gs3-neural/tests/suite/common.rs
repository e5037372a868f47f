//! Graphs of one operation and what goes into them.

use gs3_neural::{Activation, Border, Conv2d, Graph, GraphBuilder, Op, Random};

/// Images of numbers in ±1 for all inputs of `graph`.
pub fn images(graph: &Graph, lr: [usize; 2], seed: u64) -> Vec<(String, Vec<f32>)> {
    let (shapes, mut random) = (graph.shapes(lr).expect("a size it takes"), Random::new(seed));
    let image = |len: usize, random: &mut Random| (0..len).map(|_| random.signed()).collect();
    graph.inputs().map(|(t, l)| (l.name.clone(), image(shapes[t.index()].len(), &mut random))).collect()
}

pub fn named(images: &[(String, Vec<f32>)]) -> Vec<(&str, &[f32])> {
    images.iter().map(|(name, image)| (name.as_str(), &image[..])).collect()
}

/// A graph of one operation on images `a` and `b` of `channels`, and a factor `f` of one channel and a `flow`.
pub fn single(op: Op, channels: usize, inputs: &[&str], border: Border) -> Graph {
    let mut g = GraphBuilder::new("single", 1, border);
    let channels = |name: &str| match name {
        "f" => 1,
        "flow" => 2,
        _ => channels,
    };
    let mut tensors = Vec::new();
    for (k, name) in inputs.iter().enumerate() {
        let first = inputs.iter().position(|n| n == name).unwrap_or(k);
        let tensor = if first < k { tensors[first] } else { g.input(name, channels(name), 1) };
        tensors.push(tensor);
    }
    let result = g.layer("result", op, &tensors);
    // Something that reads the result with a margin, and something that is not fused into the output.
    let again = g.layer("again", Op::Activate(Activation::Identity), &[result]);
    let next = g.conv("next", Conv2d::new(5, 3), &[result]);
    g.output("again", again);
    g.output("next", next);
    g.output("result", result);
    g.finish().unwrap()
}
