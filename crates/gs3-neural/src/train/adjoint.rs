//! The reverse walk: derivatives of a loss by weights and images, from those by the outputs. Naive loops in double
//! precision, one adjoint for each operation of [`reference`](crate::reference): the oracle of a trainer's kernels.
//!
//! It is no trainer: it visits numbers one by one. The derivative of a convolution by its input is a convolution with
//! the weights turned round, which the engine's kernels can do at the speed of the forward pass; the derivative by the
//! weights is as much work again.

use std::collections::BTreeMap;

use crate::graph::{Activation, Conv2d, Graph, Op};
use crate::reference::{Plane, activate, moments, normal_distribution, pooled, tap_at, taps, window};
use crate::weights::Weights;

/// Derivatives of a loss.
#[derive(Clone, Debug)]
pub struct Derivatives {
    /// By the result of each layer, in the order of [`Graph::layers`]; by the images where the layer is an input.
    pub v_planes: Vec<Plane>,
    /// By each parameter, under its name.
    pub v_weights: BTreeMap<String, Vec<f64>>,
}

/// Walks back through `graph`. `planes` are the results of its layers ([`reference::run`](crate::reference::run) with
/// the same `weights`). `v_output` gives the derivative of the loss by a layer's result, where the loss reads the
/// result: by [`Tensor::index`](crate::Tensor::index), `[height, width, channels]`.
#[must_use]
pub fn walk_back(
    graph: &Graph,
    weights: &Weights,
    planes: &[Plane],
    v_output: &BTreeMap<usize, Vec<f64>>,
) -> Derivatives {
    let mut v_planes: Vec<Plane> = planes.iter().map(|plane| Plane::zeros(plane.shape)).collect();
    for (k, v) in v_output {
        v_planes[*k].values.iter_mut().zip(v).for_each(|(sum, v)| *sum += v);
    }
    let mut v_weights = BTreeMap::new();
    for k in (0..graph.layers().len()).rev() {
        // Readers come after what they read: this derivative is complete.
        let v = std::mem::replace(&mut v_planes[k], Plane { shape: planes[k].shape, values: Vec::new() });
        let mut step = Step { graph, weights, planes, k, v: &v, v_planes: &mut v_planes };
        step.run(&mut v_weights);
        v_planes[k] = v;
    }
    Derivatives { v_planes, v_weights }
}

/// The adjoint of layer `k`; `v` is the derivative by the layer's result.
struct Step<'a> {
    graph: &'a Graph,
    weights: &'a Weights,
    planes: &'a [Plane],
    k: usize,
    v: &'a Plane,
    v_planes: &'a mut [Plane],
}

impl<'a> Step<'a> {
    /// Input `i`.
    fn input(&self, i: usize) -> &'a Plane {
        &self.planes[self.graph.layers()[self.k].inputs[i].index()]
    }

    /// Adds to the derivative by channel `c` of pixel (x, y) of input `i`; a single channel stands for all.
    fn add(&mut self, i: usize, [x, y, c]: [usize; 3], v: f64) {
        let plane = &mut self.v_planes[self.graph.layers()[self.k].inputs[i].index()];
        let index = plane.index(x, y, if plane.shape.channels == 1 { 0 } else { c });
        plane.values[index] += v;
    }

    fn at(&self, i: usize, [x, y, c]: [usize; 3]) -> f64 {
        let plane = self.input(i);
        plane.at(x, y, if plane.shape.channels == 1 { 0 } else { c })
    }

    fn run(&mut self, v_weights: &mut BTreeMap<String, Vec<f64>>) {
        let layer = &self.graph.layers()[self.k];
        match &layer.op {
            Op::Conv2d(conv) => return self.convolution(conv, &layer.name, v_weights),
            Op::Prelu => return self.prelu(&layer.name, v_weights),
            Op::LayerNorm { epsilon } => return self.layer_norm(*epsilon, &layer.name, v_weights),
            _ => {}
        }
        let shape = self.v.shape;
        for y in 0..shape.height {
            for x in 0..shape.width {
                for c in 0..shape.channels {
                    self.number(&layer.op, [x, y, c], self.v.at(x, y, c));
                }
            }
        }
    }

    /// What number `at` of the result, the derivative by which is `v`, adds to those by the inputs.
    fn number(&mut self, op: &Op, at: [usize; 3], v: f64) {
        let [x, y, c] = at;
        match op {
            // What learns goes its own way.
            Op::Input { .. } | Op::Conv2d(_) | Op::Prelu | Op::LayerNorm { .. } => {}
            Op::Activate(activation) => {
                let slope = derivative(*activation, self.at(0, at));
                self.add(0, at, v * slope);
            }
            Op::PixelShuffle { factor: f } => {
                self.add(0, [x / f, y / f, c * f * f + y % f * f + x % f], v);
            }
            Op::PixelUnshuffle { factor: f } => {
                self.add(0, [x * f + c % f, y * f + c / f % f, c / (f * f)], v)
            }
            Op::Upsample { factor } => self.add(0, [x / factor, y / factor, c], v),
            Op::MaxPool2 => {
                // Of equal numbers the first is the largest.
                let largest =
                    first_largest(window(self.input(0).shape, x, y), |(x, y)| self.at(0, [x, y, c]));
                if let Some((x, y)) = largest {
                    self.add(0, [x, y, c], v);
                }
            }
            Op::Scale { factor } => self.add(0, at, v * f64::from(*factor)),
            Op::Shift { .. } => self.add(0, at, v),
            Op::AveragePool { side, stride } => {
                let pixels = pooled(self.input(0).shape, [x, y], *side, *stride);
                let share = v / pixels.clone().count() as f64;
                pixels.for_each(|(x, y)| self.add(0, [x, y, c], share));
            }
            Op::Concat => {
                let (mut i, mut c) = (0, c);
                while c >= self.input(i).shape.channels {
                    c -= self.input(i).shape.channels;
                    i += 1;
                }
                self.add(i, [x, y, c], v);
            }
            Op::Slice { first, .. } => self.add(0, [x, y, first + c], v),
            Op::Add => {
                self.add(0, at, v);
                self.add(1, at, v);
            }
            Op::Multiply => {
                let (a, factor) = (self.at(0, at), self.at(1, at));
                self.add(0, at, v * factor);
                self.add(1, at, v * a);
            }
            Op::Mix => {
                let [a, b, t] = [0, 1, 2].map(|i| self.at(i, at));
                self.add(0, at, v * (1.0 - t));
                self.add(1, at, v * t);
                self.add(2, at, v * (b - a));
            }
            Op::ChannelMean => {
                let n = self.input(0).shape.channels;
                (0..n).for_each(|c| self.add(0, [x, y, c], v / n as f64));
            }
            Op::ChannelMax => {
                let n = self.input(0).shape.channels;
                if let Some(c) = first_largest(0..n, |c| self.at(0, [x, y, c])) {
                    self.add(0, [x, y, c], v);
                }
            }
            Op::Warp => {
                let [dx, dy] = [0, 1].map(|k| self.input(1).at(x, y, k));
                for tap in taps(self.input(0).shape, x as f64 + dx, y as f64 + dy) {
                    let value = self.at(0, [tap.x, tap.y, c]);
                    self.add(0, [tap.x, tap.y, c], v * tap.weight);
                    self.add(1, [x, y, 0], v * tap.slope[0] * value);
                    self.add(1, [x, y, 1], v * tap.slope[1] * value);
                }
            }
        }
    }

    fn prelu(&mut self, name: &str, v_weights: &mut BTreeMap<String, Vec<f64>>) {
        let slopes = self.weights.parameter(name, "weight");
        let mut v_slopes = vec![0.0; slopes.len()];
        let channels = self.v.shape.channels;
        for (k, v) in self.v.values.iter().enumerate() {
            let (pixel, c) = (k / channels, k % channels);
            let at = [pixel % self.v.shape.width, pixel / self.v.shape.width, c];
            let x = self.at(0, at);
            if x > 0.0 {
                self.add(0, at, *v);
            } else {
                self.add(0, at, v * f64::from(slopes[c]));
                v_slopes[c] += v * x;
            }
        }
        v_weights.insert(format!("{name}.weight"), v_slopes);
    }

    /// With x̂ = (x − mean) / deviation and w = v · weight: (w − mean(w) − x̂ mean(w x̂)) / deviation.
    fn layer_norm(&mut self, epsilon: f32, name: &str, v_weights: &mut BTreeMap<String, Vec<f64>>) {
        let weight = self.weights.parameter(name, "weight");
        let [mut v_weight, mut v_bias] = [0, 1].map(|_| vec![0.0; weight.len()]);
        let n = weight.len() as f64;
        let shape = self.v.shape;
        for (x, y) in (0..shape.height).flat_map(|y| (0..shape.width).map(move |x| (x, y))) {
            let [mean, deviation] = moments(self.input(0), x, y, epsilon);
            let normal: Vec<f64> =
                (0..weight.len()).map(|c| (self.at(0, [x, y, c]) - mean) / deviation).collect();
            let v: Vec<f64> = (0..weight.len()).map(|c| self.v.at(x, y, c)).collect();
            let weighed: Vec<f64> = v.iter().zip(weight).map(|(v, w)| v * f64::from(*w)).collect();
            let mean = weighed.iter().sum::<f64>() / n;
            let along = weighed.iter().zip(&normal).map(|(w, x)| w * x).sum::<f64>() / n;
            for c in 0..weight.len() {
                v_weight[c] += v[c] * normal[c];
                v_bias[c] += v[c];
                self.add(0, [x, y, c], (weighed[c] - mean - normal[c] * along) / deviation);
            }
        }
        v_weights.insert(format!("{name}.weight"), v_weight);
        v_weights.insert(format!("{name}.bias"), v_bias);
    }

    fn convolution(&mut self, conv: &Conv2d, name: &str, v_weights: &mut BTreeMap<String, Vec<f64>>) {
        let w = self.weights.parameter(name, "weight");
        let bias = self.weights.parameter(name, "bias");
        let (input, border, shape) = (self.input(0), self.graph.border(), self.v.shape);
        let (taps, channels) = (conv.kernel * conv.kernel, input.shape.channels);
        let mut v_weight = vec![0.0; w.len()];
        let mut v_bias = vec![0.0; bias.len()];
        for (x, y) in (0..shape.height).flat_map(|y| (0..shape.width).map(move |x| (x, y))) {
            let seen: Vec<_> = (0..taps)
                .filter_map(|tap| Some((tap, tap_at(border, conv, input.shape, x, y, tap)?)))
                .collect();
            for o in 0..shape.channels {
                // The sum before the activation, which the derivative needs, is computed again.
                let mut sum = bias.get(o).map_or(0.0, |b| f64::from(*b));
                for (tap, (x, y)) in &seen {
                    for i in 0..channels {
                        sum += f64::from(w[(o * channels + i) * taps + tap]) * input.at(*x, *y, i);
                    }
                }
                let v = self.v.at(x, y, o) * derivative(conv.activation, sum);
                if let Some(v_bias) = v_bias.get_mut(o) {
                    *v_bias += v;
                }
                for (tap, (x, y)) in &seen {
                    for i in 0..channels {
                        let at = (o * channels + i) * taps + tap;
                        v_weight[at] += v * input.at(*x, *y, i);
                        let plane = &mut self.v_planes[self.graph.layers()[self.k].inputs[0].index()];
                        let index = plane.index(*x, *y, i);
                        plane.values[index] += v * f64::from(w[at]);
                    }
                }
            }
        }
        v_weights.insert(format!("{name}.weight"), v_weight);
        if conv.bias {
            v_weights.insert(format!("{name}.bias"), v_bias);
        }
    }
}

/// The first of `places` at which `value` is largest.
fn first_largest<T: Copy>(places: impl Iterator<Item = T>, value: impl Fn(T) -> f64) -> Option<T> {
    let mut best: Option<(T, f64)> = None;
    for place in places {
        let value = value(place);
        if best.is_none_or(|(_, most)| value > most) {
            best = Some((place, value));
        }
    }
    best.map(|(place, _)| place)
}

/// The derivative of an activation at x.
fn derivative(activation: Activation, x: f64) -> f64 {
    let sigmoid = activate(Activation::Sigmoid, x);
    match activation {
        Activation::Identity => 1.0,
        Activation::Relu if x > 0.0 => 1.0,
        Activation::Relu => 0.0,
        Activation::LeakyRelu { .. } if x > 0.0 => 1.0,
        Activation::LeakyRelu { slope } => f64::from(slope),
        // (x Φ)' = Φ + x φ.
        Activation::Gelu => {
            normal_distribution(x) + x * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt()
        }
        Activation::Silu => sigmoid * (1.0 + x * (1.0 - sigmoid)),
        Activation::Sigmoid => sigmoid * (1.0 - sigmoid),
        Activation::Tanh => 1.0 - x.tanh().powi(2),
    }
}
