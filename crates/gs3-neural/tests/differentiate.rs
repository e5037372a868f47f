//! The fast derivatives are those of the oracle in double precision.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeMap;

use gs3_neural::adjoint::{Derivatives, walk_back};
use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, Differentiator, Filter, Graph, GraphBuilder, Header, Op, Random, Shape,
    Weights, reference,
};

/// An image by name.
type Image = (String, Vec<f32>);

/// Weights, biases included, that are not zero.
fn weights(graph: &Graph, seed: u64) -> Weights {
    let [tier, training_data, licence] = ["", "", ""].map(str::to_owned);
    let (network, version) = (graph.name().to_owned(), graph.version());
    let mut weights =
        Weights::random(graph, Header { network, version, scale: 2, tier, training_data, licence }, seed);
    let mut random = Random::new(seed);
    for array in weights.arrays.values_mut().filter(|a| a.shape().len() == 1) {
        array.values_mut().fill_with(|| 0.3 * random.signed());
    }
    weights
}

/// Numbers in ±1.
fn noise(shape: Shape, random: &mut Random) -> Vec<f32> {
    (0..shape.len()).map(|_| random.signed()).collect()
}

fn inputs(graph: &Graph, lr: [usize; 2], random: &mut Random) -> Vec<Image> {
    let shapes = graph.shapes(lr).unwrap();
    graph.inputs().map(|(t, layer)| (layer.name.clone(), noise(shapes[t.index()], random))).collect()
}

fn outputs(graph: &Graph, lr: [usize; 2], random: &mut Random) -> Vec<Image> {
    let shapes = graph.shapes(lr).unwrap();
    graph.outputs().iter().map(|o| (o.name.clone(), noise(shapes[o.tensor.index()], random))).collect()
}

fn named(images: &[Image]) -> Vec<(&str, &[f32])> {
    images.iter().map(|(name, image)| (name.as_str(), &image[..])).collect()
}

/// Zeros for each input.
fn zeros(images: &[Image]) -> Vec<Image> {
    images.iter().map(|(name, image)| (name.clone(), vec![0.0; image.len()])).collect()
}

fn named_mut(images: &mut [Image]) -> Vec<(&str, &mut [f32])> {
    images.iter_mut().map(|(name, image)| (name.as_str(), &mut image[..])).collect()
}

/// What the oracle says for `images` and derivatives by outputs.
fn oracle(
    graph: &Graph,
    weights: &Weights,
    lr: [usize; 2],
    images: &[Image],
    v_outputs: &[Image],
) -> Derivatives {
    let planes = reference::run(graph, weights, lr, &named(images)).unwrap();
    let mut v_planes: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (name, v) in v_outputs {
        let output = graph.outputs().iter().find(|o| o.name == *name).unwrap();
        let plane = v_planes.entry(output.tensor.index()).or_insert_with(|| vec![0.0; v.len()]);
        plane.iter_mut().zip(v).for_each(|(sum, v)| *sum += f64::from(*v));
    }
    walk_back(graph, weights, &planes, &v_planes)
}

/// Whether two arrays agree to 1e-4 of the largest number.
fn assert_close(what: &str, actual: &[f32], expected: &[f64]) {
    assert_eq!(actual.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(1e-3_f64, |most, v| most.max(v.abs()));
    for (k, (a, e)) in actual.iter().zip(expected).enumerate() {
        let error = (f64::from(*a) - e).abs();
        assert!(error <= 1e-4 * largest, "{what} {k}: {a}, expected {e}, largest {largest}");
    }
}

/// Compares derivatives by all weights and all inputs for random images, weights and derivatives by outputs.
fn compare(graph: &Graph, lr: [usize; 2], seed: u64) {
    let mut random = Random::new(seed);
    let (weights, images) = (weights(graph, seed), inputs(graph, lr, &mut random));
    let v_outputs = outputs(graph, lr, &mut random);
    let expected = oracle(graph, &weights, lr, &images, &v_outputs);
    let names: Vec<&str> = images.iter().map(|(name, _)| name.as_str()).collect();
    let differentiator = Differentiator::new(graph, lr, &names).unwrap();
    let packed = differentiator.pack(&weights).unwrap();
    let (mut tape, mut scratch) = (differentiator.tape(), differentiator.scratch());
    // Twice: what the first pass leaves behind does not matter, but for the sums of derivatives by weights.
    let mut v_weights = differentiator.v_weights();
    for round in 1..=2 {
        differentiator.forward(&packed, &named(&images), &mut tape).unwrap();
        let mut v_images = zeros(&images);
        let mut v_inputs = named_mut(&mut v_images);
        differentiator
            .backward(&packed, &tape, &mut scratch, &named(&v_outputs), &mut v_weights, &mut v_inputs)
            .unwrap();
        let op = graph.layers().iter().find(|l| l.name == "result").map(|l| l.op);
        for (name, v) in &v_images {
            let (tensor, _) = graph.inputs().find(|(_, l)| l.name == *name).unwrap();
            let what = format!("{} {op:?} {lr:?} {name}", graph.name());
            assert_close(&what, v, &expected.v_planes[tensor.index()].values);
        }
        for (name, v) in &expected.v_weights {
            let what = format!("{} {op:?} {lr:?} {name}", graph.name());
            let v: Vec<f64> = v.iter().map(|v| f64::from(round) * v).collect();
            assert_close(&what, v_weights[name].values(), &v);
        }
    }
}

/// A graph of one operation on images `a` and `b` of `channels`, and a factor `f` of one channel and a `flow`, each
/// behind a convolution of its own, with readers of several kinds.
fn single(op: Op, channels: usize, names: &[&str], border: Border) -> Graph {
    let mut g = GraphBuilder::new("single", 1, border);
    let mut distinct = names.to_vec();
    distinct.dedup();
    let mut made = BTreeMap::new();
    for name in distinct {
        let channels = match name {
            "f" => 1,
            "flow" => 2,
            _ => channels,
        };
        let image = g.input(name, channels, 1);
        made.insert(name, g.conv(&format!("{name}.conv"), Conv2d::new(3, channels), &[image]));
    }
    let read: Vec<_> = names.iter().map(|name| made[name]).collect();
    let result = g.layer("result", op, &read);
    let again = g.layer("again", Op::Activate(Activation::Tanh), &[result]);
    let next = g.conv("next", Conv2d::new(5, 3), &[result, again]);
    g.output("again", again);
    g.output("next", next);
    g.output("result", result);
    g.finish().unwrap()
}

#[test]
fn every_operation_has_the_oracles_derivatives() {
    let upsample = |factor, filter| Op::Upsample { factor, filter };
    let ops: Vec<(Op, Vec<&str>)> = vec![
        (Op::PixelShuffle { factor: 2 }, vec!["a"]),
        (Op::PixelShuffle { factor: 2 }, vec!["a", "b"]),
        (upsample(3, Filter::Bilinear), vec!["a"]),
        (upsample(3, Filter::Bilinear), vec!["a", "b"]),
        (upsample(2, Filter::Nearest), vec!["a"]),
        (upsample(2, Filter::Nearest), vec!["a", "f"]),
        (Op::MaxPool2, vec!["a"]),
        (Op::Concat, vec!["a", "f", "b"]),
        (Op::Concat, vec!["a", "a"]),
        (Op::Slice { first: 1, count: 3 }, vec!["a"]),
        (Op::Add, vec!["a", "b"]),
        (Op::Add, vec!["a", "a"]),
        (Op::Multiply, vec!["a", "b"]),
        (Op::Multiply, vec!["a", "f"]),
        (Op::Mix, vec!["a", "b", "f"]),
        (Op::Mix, vec!["a", "b", "b"]),
        (Op::ChannelMean, vec!["a"]),
        (Op::ChannelMax, vec!["a"]),
        (Op::Warp, vec!["a", "flow"]),
    ];
    for (op, inputs) in ops {
        for (channels, border) in [(4, Border::Zero), (36, Border::Replicate)] {
            compare(&single(op, channels, &inputs, border), [5, 7], 3);
        }
    }
    compare(&single(Op::PixelUnshuffle { factor: 2 }, 5, &["a"], Border::Zero), [4, 6], 3);
}

const ACTIVATIONS: [Activation; 8] = [
    Activation::Identity,
    Activation::Relu,
    Activation::LeakyRelu { slope: 0.2 },
    Activation::LeakyRelu { slope: -0.2 },
    Activation::Gelu,
    Activation::Silu,
    Activation::Sigmoid,
    Activation::Tanh,
];

#[test]
fn activations_have_the_oracles_derivatives() {
    for activation in ACTIVATIONS {
        compare(&single(Op::Activate(activation), 20, &["a"], Border::Zero), [5, 7], 3);
        let conv = Conv2d::new(3, 20).activation(activation);
        compare(&single(Op::Conv2d(conv), 7, &["a"], Border::Replicate), [5, 7], 3);
    }
}

#[test]
fn convolutions_of_any_size_have_the_oracles_derivatives() {
    for (kernel, dilation, channels, outputs) in
        [(3, 1, 17, 33), (1, 1, 5, 48), (7, 3, 2, 1), (3, 2, 32, 80), (3, 1, 47, 16)]
    {
        for border in [Border::Zero, Border::Replicate] {
            for bias in [false, true] {
                let conv = Conv2d { bias, ..Conv2d::new(kernel, outputs).dilation(dilation) };
                let graph = single(Op::Conv2d(conv), channels, &["a"], border);
                for lr in [[5, 29], [1, 1], [2, 13]] {
                    compare(&graph, lr, 7);
                }
            }
        }
    }
}

/// Concatenations are read in place; a tensor may be there twice.
#[test]
fn concatenated_inputs_have_the_oracles_derivatives() {
    for border in [Border::Zero, Border::Replicate] {
        let mut g = GraphBuilder::new("parts", 1, border);
        let [a, b, c] = [g.input("a", 3, 1), g.input("b", 18, 1), g.input("c", 2, 2)];
        let blocks = g.layer("c.blocks", Op::PixelUnshuffle { factor: 2 }, &[c]);
        let x = g.conv("x", Conv2d::new(3, 20), &[a, blocks, b]);
        let y = g.conv("y", Conv2d::new(3, 8), &[x, a, x, b]);
        let image = g.layer("image", Op::PixelShuffle { factor: 2 }, &[y]);
        let [first, second] =
            [0, 4].map(|first| g.layer(&format!("part.{first}"), Op::Slice { first, count: 4 }, &[y]));
        let product = g.layer("product", Op::Multiply, &[first, second]);
        g.output("image", image);
        g.output("image again", image);
        g.output("product", product);
        g.output("x", x);
        compare(&g.finish().unwrap(), [6, 9], 5);
    }
}

#[test]
fn networks_have_the_oracles_derivatives() {
    for tier in Tier::ALL {
        for graph in [super_sample(2, tier), super_sample(4, tier), interpolate(4, tier)] {
            compare(&graph.unwrap(), [6, 7], 5);
        }
    }
}
