//! Every adjoint is the derivative: central finite differences of the reference.

use std::collections::BTreeMap;

use gs3_neural::adjoint::walk_back;
use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{Activation, Border, Conv2d, Graph, GraphBuilder, Header, Op, Random, Weights, reference};

use crate::operations::operations;

const LR: [usize; 2] = [4, 6];

/// A loss that weighs each number of every output by another factor, its derivatives, and how they compare.
struct Check<'a> {
    graph: &'a Graph,
    weights: Weights,
    images: Vec<(String, Vec<f32>)>,
    factors: BTreeMap<usize, Vec<f64>>,
}

impl<'a> Check<'a> {
    fn new(graph: &'a Graph, seed: u64) -> Self {
        let (mut random, shapes) = (Random::new(seed), graph.shapes(LR).expect("a size it takes"));
        let mut weights = Weights::random(graph, Header::of(graph, 2), seed);
        for array in weights.arrays.values_mut().filter(|a| a.shape().len() == 1) {
            array.values_mut().fill_with(|| 0.3 * random.signed());
        }
        let mut image = |len: usize| (0..len).map(|_| random.signed()).collect::<Vec<f32>>();
        let images = graph.inputs().map(|(t, l)| (l.name.clone(), image(shapes[t.index()].len()))).collect();
        let mut factor = |k: usize| image(shapes[k].len()).iter().map(|v| f64::from(*v)).collect();
        let factors = graph.outputs().iter().map(|o| (o.tensor.index(), factor(o.tensor.index()))).collect();
        Self { graph, weights, images, factors }
    }

    fn planes(&self) -> Vec<reference::Plane> {
        let images: Vec<(&str, &[f32])> = self.images.iter().map(|(n, i)| (n.as_str(), &i[..])).collect();
        reference::run(self.graph, &self.weights, LR, &images).expect("it runs")
    }

    fn loss(&self) -> f64 {
        let planes = self.planes();
        let dot = |(k, f): (&usize, &Vec<f64>)| -> f64 {
            planes[*k].values.iter().zip(f).map(|(a, b)| a * b).sum()
        };
        self.factors.iter().map(dot).sum()
    }

    /// The slope of the loss along a number that `get` finds, by steps small enough to cross no kink but rarely.
    fn slope(&mut self, get: impl Fn(&mut Self) -> &mut f32) -> f64 {
        let start = *get(self);
        let step = 2.0_f32.powi(-12);
        let (above, below) = (start + step, start - step);
        *get(self) = above;
        let more = self.loss();
        *get(self) = below;
        let less = self.loss();
        *get(self) = start;
        (more - less) / (f64::from(above) - f64::from(below))
    }

    /// Compares some derivatives of every image and parameter.
    fn run(mut self, count: usize) {
        let derivatives = walk_back(self.graph, &self.weights, &self.planes(), &self.factors);
        let mut random = Random::new(99);
        let mut place = |len: usize| (random.next_bits() % len as u64) as usize;
        let inputs: Vec<usize> = self.graph.inputs().map(|(t, _)| t.index()).collect();
        for (image, tensor) in inputs.into_iter().enumerate() {
            for _ in 0..count {
                let k = place(self.images[image].1.len());
                let expected = self.slope(|check| &mut check.images[image].1[k]);
                self.compare(&self.images[image].0, k, derivatives.v_planes[tensor].values[k], expected);
            }
        }
        let parameters = self.graph.parameters();
        assert_eq!(parameters.len(), derivatives.v_weights.len());
        for name in parameters.into_iter().map(|p| p.name) {
            for _ in 0..count {
                let k = place(derivatives.v_weights[&name].len());
                let expected =
                    self.slope(|c| &mut c.weights.arrays.get_mut(&name).expect("there").values_mut()[k]);
                self.compare(&name, k, derivatives.v_weights[&name][k], expected);
            }
        }
    }

    fn compare(&self, name: &str, k: usize, actual: f64, expected: f64) {
        let error = (actual - expected).abs();
        let layers = self.graph.layers();
        let op = layers.iter().find(|l| l.name == "result").map(|l| l.op);
        assert!(error <= 1e-5 * (1.0 + expected.abs()), "{op:?} {name} {k}: {actual} {expected}");
    }
}

#[test]
fn every_adjoint_is_the_derivative() {
    let mut ops = operations();
    ops.push((Op::PixelUnshuffle { factor: 2 }, vec!["a"]));
    let leaky = Activation::LeakyRelu { slope: 0.1 };
    for activation in [
        Activation::Identity,
        Activation::Relu,
        leaky,
        Activation::Gelu,
        Activation::Silu,
        Activation::Sigmoid,
        Activation::Tanh,
    ] {
        ops.push((Op::Activate(activation), vec!["a"]));
        ops.push((Op::Conv2d(Conv2d::new(3, 5).dilation(2).activation(activation)), vec!["a"]));
        ops.push((Op::Conv2d(Conv2d { bias: false, ..Conv2d::new(1, 3).activation(activation) }), vec!["a"]));
    }
    for (op, inputs) in ops {
        for border in [Border::Zero, Border::Replicate] {
            let mut g = GraphBuilder::new("single", 1, border);
            let mut names: Vec<&str> = inputs.clone();
            names.dedup();
            let channels = |name: &str| match name {
                "f" => 1,
                "flow" => 2,
                _ => 4,
            };
            let given: BTreeMap<&str, _> = names.iter().map(|n| (*n, g.input(n, channels(n), 1))).collect();
            let read: Vec<_> = inputs.iter().map(|n| given[n]).collect();
            let result = g.layer("result", op, &read);
            g.output("result", result);
            let graph = g.finish().expect("a graph");
            Check::new(&graph, 4).run(12);
        }
    }
}

#[test]
fn derivatives_of_whole_networks_are_right() {
    for graph in [super_sample(2, Tier::Fast), interpolate(2, Tier::Fast)] {
        let graph = graph.expect("a network");
        Check::new(&graph, 11).run(1);
    }
}
