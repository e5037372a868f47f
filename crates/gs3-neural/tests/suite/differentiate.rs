//! The fast derivatives equal the derivatives of the oracle in double precision.

use std::collections::BTreeMap;

use gs3_neural::adjoint::{Derivatives, walk_back};
use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, Differentiator, Graph, GraphBuilder, Header, Op, Random, RunError, Shape,
    WeightError, Weights, reference,
};
use rayon::prelude::*;

use crate::operations::operations;

/// An image by name.
type Image = (String, Vec<f32>);

/// Weights, biases included, that are not zero.
fn weights(graph: &Graph, seed: u64) -> Weights {
    let mut weights = Weights::random(graph, Header::of(graph, 2), seed);
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
    compare_on(graph, lr, &inputs(graph, lr, &mut Random::new(seed)), seed);
}

/// The same for given images.
fn compare_on(graph: &Graph, lr: [usize; 2], images: &[Image], seed: u64) {
    let (weights, mut random) = (weights(graph, seed), Random::new(!seed));
    let v_outputs = outputs(graph, lr, &mut random);
    let expected = oracle(graph, &weights, lr, images, &v_outputs);
    let names: Vec<&str> = images.iter().map(|(name, _)| name.as_str()).collect();
    let differentiator = Differentiator::new(graph, lr, &names).unwrap();
    let packed = differentiator.pack(&weights).unwrap();
    let (mut tape, mut scratch) = (differentiator.tape(), differentiator.scratch());
    // Twice: what the first pass leaves behind does not matter, but for the sums of derivatives by weights.
    let mut v_weights = differentiator.v_weights();
    for round in 1..=2 {
        differentiator.forward(&packed, &named(images), &mut tape).unwrap();
        let mut v_images = zeros(images);
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
    for (op, inputs) in operations() {
        for (channels, border) in [(4, Border::Zero), (36, Border::Replicate)] {
            compare(&single(op, channels, &inputs, border), [5, 7], 3);
        }
    }
    compare(&single(Op::PixelUnshuffle { factor: 2 }, 5, &["a"], Border::Zero), [4, 6], 3);
    compare(&single(Op::Shift { color: [0.5, -0.2, 0.1] }, 48, &["a"], Border::Zero), [5, 7], 3);
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

/// Of equal numbers the first is the largest.
#[test]
fn ties_have_the_oracles_derivatives() {
    let lr = [5, 7];
    for op in [Op::MaxPool2, Op::ChannelMax] {
        let mut g = GraphBuilder::new("ties", 1, Border::Zero);
        let image = g.input("image", 20, 1);
        let result = g.layer("result", op, &[image]);
        g.output("result", result);
        let graph = g.finish().unwrap();
        let mut images = inputs(&graph, lr, &mut Random::new(3));
        // −1, 0 or 1.
        images[0].1.iter_mut().for_each(|v| *v = v.round());
        compare_on(&graph, lr, &images, 3);
    }
}

/// Three frames of the super sampling network, the state of each going to the next: back through time, the derivative
/// by the state that came in is that by the state that went out of the frame before.
#[test]
fn derivatives_through_time_are_the_oracles() {
    let (graph, lr) = (super_sample(2, Tier::Fast).unwrap(), [6, 7]);
    let mut random = Random::new(8);
    let weights = weights(&graph, 8);
    let frames: Vec<Vec<Image>> = (0..3).map(|_| inputs(&graph, lr, &mut random)).collect();
    let v_colors: Vec<Vec<f32>> = (0..3)
        .map(|_| outputs(&graph, lr, &mut random).into_iter().find(|(name, _)| name == "color").unwrap().1)
        .collect();
    let with_hidden = |frame: &[Image], hidden: &[f32]| {
        let mut frame = frame.to_vec();
        frame.iter_mut().filter(|(name, _)| name == "hidden").for_each(|(_, image)| *image = hidden.to_vec());
        frame
    };
    let index = |name: &str| {
        graph.outputs().iter().find(|output| output.name == name).map(|output| output.tensor.index()).unwrap()
    };
    let (hidden_in, _) = graph.inputs().find(|(_, layer)| layer.name == "hidden").unwrap();

    // The oracle: states rounded to what the network is given, as between frames.
    let mut state: Vec<f32> = frames[0].iter().find(|(name, _)| name == "hidden").unwrap().1.clone();
    let mut passes = Vec::new();
    for frame in &frames {
        let images = with_hidden(frame, &state);
        let planes = reference::run(&graph, &weights, lr, &named(&images)).unwrap();
        state = planes[index("hidden")].values.iter().map(|v| *v as f32).collect();
        passes.push(planes);
    }
    let mut expected: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut v_hidden = vec![0.0; state.len()];
    for (planes, v_color) in passes.iter().zip(&v_colors).rev() {
        let v_color = v_color.iter().map(|v| f64::from(*v)).collect();
        let v_planes = BTreeMap::from([(index("color"), v_color), (index("hidden"), v_hidden)]);
        let derivatives = walk_back(&graph, &weights, planes, &v_planes);
        v_hidden = derivatives.v_planes[hidden_in.index()].values.clone();
        for (name, v) in derivatives.v_weights {
            let sums = expected.entry(name).or_insert_with(|| vec![0.0; v.len()]);
            sums.iter_mut().zip(v).for_each(|(sum, v)| *sum += v);
        }
    }

    let differentiator = Differentiator::new(&graph, lr, &["hidden"]).unwrap();
    let packed = differentiator.pack(&weights).unwrap();
    let mut state: Vec<f32> = frames[0].iter().find(|(name, _)| name == "hidden").unwrap().1.clone();
    let mut tapes = vec![differentiator.tape(); 3];
    for (frame, tape) in frames.iter().zip(&mut tapes) {
        differentiator.forward(&packed, &named(&with_hidden(frame, &state)), tape).unwrap();
        differentiator.output(tape, "hidden", &mut state).unwrap();
    }
    let (mut scratch, mut v_weights) = (differentiator.scratch(), differentiator.v_weights());
    let mut v_state: Option<Vec<f32>> = None;
    for (tape, v_color) in tapes.iter().zip(&v_colors).rev() {
        // The last frame's state goes nowhere.
        let v_hidden = v_state.as_ref().map(|v| ("hidden", &v[..]));
        let v_outputs: Vec<(&str, &[f32])> = [("color", &v_color[..])].into_iter().chain(v_hidden).collect();
        let mut v_in = vec![f32::NAN; state.len()];
        let mut v_inputs = [("hidden", &mut v_in[..])];
        differentiator
            .backward(&packed, tape, &mut scratch, &v_outputs, &mut v_weights, &mut v_inputs)
            .unwrap();
        v_state = Some(v_in);
    }
    assert_close("hidden", &v_state.unwrap(), &v_hidden);
    for (name, v) in &expected {
        assert_close(name, v_weights[name].values(), v);
    }
}

/// A batch has the same derivatives, bit for bit, on any number of threads.
#[test]
fn derivatives_are_the_same_on_any_number_of_threads() {
    let (graph, lr) = (interpolate(2, Tier::Fast).unwrap(), [9, 11]);
    let weights = weights(&graph, 2);
    let differentiator = Differentiator::new(&graph, lr, &["hidden"]).unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let packed = differentiator.pack(&weights).unwrap();
            let mut all: Vec<_> = (0..6).map(|_| differentiator.v_weights()).collect();
            all.par_iter_mut().enumerate().for_each(|(item, v_weights)| {
                let mut random = Random::new(item as u64);
                let (images, v) = (inputs(&graph, lr, &mut random), outputs(&graph, lr, &mut random));
                let (mut tape, mut scratch) = (differentiator.tape(), differentiator.scratch());
                differentiator.forward(&packed, &named(&images), &mut tape).unwrap();
                differentiator
                    .backward(&packed, &tape, &mut scratch, &named(&v), v_weights, &mut [])
                    .unwrap();
            });
            all
        })
    };
    let alone = run(1);
    assert!(alone[0].values().any(|array| array.values().iter().any(|v| *v != 0.0)));
    for threads in [2, 5] {
        assert!(run(threads) == alone, "{threads} threads");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let (graph, lr) = (super_sample(2, Tier::Fast).unwrap(), [3, 5]);
    let weights = weights(&graph, 1);
    let unknown = |result: Result<(), RunError>, what: &str| {
        assert!(matches!(&result, Err(RunError::Unknown { name, .. }) if name == what), "{result:?}");
    };
    let memory = |result: Result<(), RunError>, what: &str| {
        assert!(matches!(&result, Err(RunError::Memory { name, .. }) if *name == what), "{result:?}");
    };
    unknown(Differentiator::new(&graph, lr, &["colour"]).map(|_| ()), "colour");
    assert!(matches!(Differentiator::new(&graph, [0, 5], &[]), Err(RunError::Graph(_))));
    let differentiator = Differentiator::new(&graph, lr, &["hidden"]).unwrap();
    let other = Differentiator::new(&graph, lr, &["hidden"]).unwrap();
    let mut wrong = weights.clone();
    wrong.arrays.remove("enter.weight");
    assert!(matches!(differentiator.pack(&wrong), Err(RunError::Weights(WeightError::Missing { .. }))));

    let mut random = Random::new(1);
    let (mut images, v_outputs) = (inputs(&graph, lr, &mut random), outputs(&graph, lr, &mut random));
    let packed = differentiator.pack(&weights).unwrap();
    let (mut tape, mut scratch) = (differentiator.tape(), differentiator.scratch());
    let mut color = vec![0.0; differentiator.output_shape("color").unwrap().len()];
    memory(differentiator.output(&tape, "color", &mut color), "tape");
    memory(differentiator.forward(&other.pack(&weights).unwrap(), &named(&images), &mut tape), "weights");
    memory(differentiator.forward(&packed, &named(&images), &mut other.tape()), "tape");
    let none = differentiator.forward(&packed, &[], &mut tape);
    assert!(matches!(none, Err(RunError::Missing { .. })));
    differentiator.forward(&packed, &named(&images), &mut tape).unwrap();
    unknown(differentiator.output(&tape, "colour", &mut color), "colour");
    let short = differentiator.output(&tape, "color", &mut color[1..]);
    assert!(matches!(short, Err(RunError::Length { .. })));

    let mut v_weights = differentiator.v_weights();
    let v = named(&v_outputs);
    let mut v_color = vec![0.0; images[0].1.len()];
    // There is such an input, but derivatives by it were not asked for.
    let mut v_inputs = [(images[0].0.as_str(), &mut v_color[..])];
    let result = differentiator.backward(&packed, &tape, &mut scratch, &v, &mut v_weights, &mut v_inputs);
    unknown(result, &images[0].0);
    let result = differentiator.backward(&packed, &tape, &mut other.scratch(), &v, &mut v_weights, &mut []);
    memory(result, "scratch");
    let short = [("color", &v_color[..1])];
    let result = differentiator.backward(&packed, &tape, &mut scratch, &short, &mut v_weights, &mut []);
    assert!(matches!(result, Err(RunError::Length { .. })));
    v_weights.remove("enter.bias");
    let result = differentiator.backward(&packed, &tape, &mut scratch, &v, &mut v_weights, &mut []);
    assert!(matches!(result, Err(RunError::Weights(WeightError::Missing { .. }))));
    images[0].1.pop();
    let short = differentiator.forward(&packed, &named(&images), &mut tape);
    assert!(matches!(short, Err(RunError::Length { .. })));
}
