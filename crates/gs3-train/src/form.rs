//! Re-parameterised training: the weights that are trained are not those that are run, but give them.
//!
//! ECBSR and RT4KSR are trained with blocks of several convolutions without anything between them, and run with the
//! single 3×3 convolutions that these are equal to. As published, the blocks' inner borders are such that they are
//! equal at the image's border too. So nothing but the equal convolution ever needs to run: its weights are polynomials
//! of the trained ones, and the derivative goes back through these.

use gs3_neural::arrays::{Array, Arrays};
use gs3_neural::model::PublishedNetwork;
use gs3_neural::{Graph, Op, Parameter, Random, WeightError, Weights};

use crate::trained_network::TrainedNetwork;

/// Taps of a window.
const TAPS: usize = 9;

/// The branches of an edge-oriented block with fixed windows; only a factor for each output channel is trained.
const EDGES: [(&str, [f32; TAPS]); 3] = [
    ("sobel_x", [1.0, 0.0, -1.0, 2.0, 0.0, -2.0, 1.0, 0.0, -1.0]),
    ("sobel_y", [1.0, 2.0, 1.0, 0.0, 0.0, 0.0, -1.0, -2.0, -1.0]),
    ("laplacian", [0.0, 1.0, 0.0, 1.0, -4.0, 1.0, 0.0, 1.0, 0.0]),
];

/// Channels inside of a block for each of its outputs.
const WIDER: usize = 2;

/// How the weights of a network are trained.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Form {
    blocks: Vec<Block>,
}

/// What is trained in the place of the convolution `layer`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Block {
    layer: String,
    kind: Kind,
    inputs: usize,
    outputs: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// ECBSR: 3×3, plus 1×1 `expand` → 3×3 `squeeze`, plus 1×1 → each of [`EDGES`] · scale + bias. The 1×1 convolutions
    /// before edges have no bias: sums of edges' taps are 0, so it would do nothing.
    EdgeOriented,
    /// RT4KSR: 1×1 `expand` → 3×3 `middle` + its input → 1×1 `reduce`, plus the block's input.
    Expanded,
}

impl Form {
    /// The form of `subject`, with the graph `graph`.
    pub fn new(subject: TrainedNetwork, graph: &Graph) -> Self {
        let kind = |name: &str| match subject {
            TrainedNetwork::Published(PublishedNetwork::Ecbsr) => Some(Kind::EdgeOriented),
            TrainedNetwork::Published(PublishedNetwork::Rt4ksr) if name.ends_with(".conv") => {
                Some(Kind::Expanded)
            }
            TrainedNetwork::Published(PublishedNetwork::Rt4ksr | PublishedNetwork::Ninasr)
            | TrainedNetwork::Own { .. } => None,
        };
        let blocks = graph.layers().iter().filter_map(|layer| match (&layer.op, &layer.inputs[..]) {
            (Op::Conv2d(conv), [input]) if conv.kernel == 3 => Some(Block {
                kind: kind(&layer.name)?,
                layer: layer.name.clone(),
                inputs: graph.channels(*input),
                outputs: conv.outputs,
            }),
            _ => None,
        });
        Self { blocks: blocks.collect() }
    }

    /// Everything that is trained.
    pub fn parameters(&self, graph: &Graph) -> Vec<Parameter> {
        let mut parameters = graph.parameters();
        parameters.retain(|parameter| self.blocks.iter().all(|block| !block.gives(&parameter.name)));
        for block in &self.blocks {
            let named = |(part, shape): (&str, Vec<usize>)| Parameter { name: block.name(part), shape };
            parameters.extend(block.parts().into_iter().map(named));
        }
        parameters
    }

    /// Whether `weights` are in this form.
    ///
    /// # Errors
    /// [`WeightError`] naming the first array or field of the header that is not.
    pub fn check(&self, graph: &Graph, weights: &Weights) -> Result<(), WeightError> {
        weights.check_parameters(graph, &self.parameters(graph))
    }

    /// Initial weights: the graph's, if nothing else is trained. Otherwise they are uniform, with a variance of a
    /// third of 1 / fan-in, as in the publications' framework; factors of edges start a thousandth as large.
    pub fn initial(&self, graph: &Graph, start: Weights, seed: u64) -> Weights {
        let (Weights { header, mut arrays }, mut random) = (start, Random::new(!seed));
        arrays.retain(|name, _| self.blocks.iter().all(|block| !block.gives(name)));
        for Parameter { name, shape } in self.parameters(graph) {
            let fan_in: usize = shape.iter().skip(1).product();
            arrays.entry(name).or_insert_with_key(|name| {
                let bound = match shape.len() {
                    4 => 1.0 / (fan_in as f32).sqrt(),
                    _ if name.ends_with(".scale") => 1e-3,
                    _ => 0.0,
                };
                let values = (0..shape.iter().product()).map(|_| bound * random.signed()).collect();
                Array::new(name, &shape, values).unwrap_or_default()
            });
        }
        Weights { header, arrays }
    }

    /// The weights that are run.
    pub fn fold(&self, trained: &Weights) -> Weights {
        let mut arrays = trained.arrays.clone();
        for block in &self.blocks {
            block.fold(&mut arrays);
        }
        Weights { header: trained.header.clone(), arrays }
    }

    /// The derivative by the trained weights from `v`, that by the weights that are run.
    pub fn pull_back(&self, trained: &Weights, mut v: Arrays) -> Arrays {
        for block in &self.blocks {
            block.pull_back(&trained.arrays, &mut v);
        }
        v
    }
}

impl Block {
    fn name(&self, part: &str) -> String {
        format!("{}.{part}", self.layer)
    }

    /// Whether `parameter` is one of the convolution that is run.
    fn gives(&self, parameter: &str) -> bool {
        ["weight", "bias"].iter().any(|kind| self.name(kind) == parameter)
    }

    fn wide(&self) -> usize {
        WIDER * self.outputs
    }

    /// What is trained, and its shapes.
    fn parts(&self) -> Vec<(&'static str, Vec<usize>)> {
        let (i, o, m) = (self.inputs, self.outputs, self.wide());
        match self.kind {
            Kind::EdgeOriented => vec![
                ("conv.weight", vec![o, i, 3, 3]),
                ("conv.bias", vec![o]),
                ("expand.weight", vec![m, i, 1, 1]),
                ("expand.bias", vec![m]),
                ("squeeze.weight", vec![o, m, 3, 3]),
                ("squeeze.bias", vec![o]),
                ("sobel_x.weight", vec![o, i, 1, 1]),
                ("sobel_x.scale", vec![o]),
                ("sobel_x.bias", vec![o]),
                ("sobel_y.weight", vec![o, i, 1, 1]),
                ("sobel_y.scale", vec![o]),
                ("sobel_y.bias", vec![o]),
                ("laplacian.weight", vec![o, i, 1, 1]),
                ("laplacian.scale", vec![o]),
                ("laplacian.bias", vec![o]),
            ],
            Kind::Expanded => vec![
                ("expand.weight", vec![m, i, 1, 1]),
                ("expand.bias", vec![m]),
                ("middle.weight", vec![m, m, 3, 3]),
                ("middle.bias", vec![m]),
                ("reduce.weight", vec![o, m, 1, 1]),
                ("reduce.bias", vec![o]),
            ],
        }
    }

    /// Replaces the trained arrays by the arrays of the convolution.
    fn fold(&self, arrays: &mut Arrays) {
        let (i, o, m) = (self.inputs, self.outputs, self.wide());
        let part = |part: &str| values(arrays, &self.name(part));
        let (weight, bias) = match self.kind {
            Kind::EdgeOriented => {
                let (mut weight, mut bias) = (part("conv.weight").to_vec(), part("conv.bias").to_vec());
                let pair =
                    Pair { sizes: [o, m, i], first: part("expand.weight"), then: part("squeeze.weight") };
                pair.fold(&mut weight);
                pair.fold_bias(part("expand.bias"), &mut bias);
                add(&mut bias, part("squeeze.bias"));
                for (edge, mask) in EDGES {
                    let [first, scale] = ["weight", "scale"].map(|kind| part(&format!("{edge}.{kind}")));
                    for (weight, (k, first)) in weight.chunks_exact_mut(TAPS).zip(first.iter().enumerate()) {
                        let factor = first * scale[k / i];
                        weight.iter_mut().zip(mask).for_each(|(w, mask)| *w += factor * mask);
                    }
                    add(&mut bias, part(&format!("{edge}.bias")));
                }
                (weight, bias)
            }
            Kind::Expanded => {
                let [inner, inner_bias] = self.inner(arrays);
                let reduce = part("reduce.weight");
                let (mut weight, mut bias) = (vec![0.0; o * i * TAPS], part("reduce.bias").to_vec());
                for (k, factor) in reduce.iter().enumerate() {
                    let (to, from) = (k / m, k % m);
                    let row = &mut weight[to * i * TAPS..][..i * TAPS];
                    row.iter_mut().zip(&inner[from * i * TAPS..]).for_each(|(w, v)| *w += factor * v);
                    bias[to] += factor * inner_bias[from];
                }
                (0..o.min(i)).for_each(|c| weight[(c * i + c) * TAPS + TAPS / 2] += 1.0);
                (weight, bias)
            }
        };
        for (part, _) in self.parts() {
            arrays.remove(&self.name(part));
        }
        put(arrays, self.name("weight"), &[o, i, 3, 3], weight);
        put(arrays, self.name("bias"), &[o], bias);
    }

    /// The middle of an expanded block, its input added, after the expansion.
    fn middle(&self, arrays: &Arrays) -> Vec<f32> {
        let mut middle = values(arrays, &self.name("middle.weight")).to_vec();
        (0..self.wide()).for_each(|c| middle[(c * self.wide() + c) * TAPS + TAPS / 2] += 1.0);
        middle
    }

    /// Expansion and middle of an expanded block as one convolution: weights and biases.
    fn inner(&self, arrays: &Arrays) -> [Vec<f32>; 2] {
        let (i, m) = (self.inputs, self.wide());
        let part = |part: &str| values(arrays, &self.name(part));
        let middle = self.middle(arrays);
        let pair = Pair { sizes: [m, m, i], first: part("expand.weight"), then: &middle };
        let (mut inner, mut bias) = (vec![0.0; m * i * TAPS], part("middle.bias").to_vec());
        pair.fold(&mut inner);
        pair.fold_bias(part("expand.bias"), &mut bias);
        [inner, bias]
    }

    /// Replaces the derivatives by the convolution's arrays by those by the trained ones.
    fn pull_back(&self, arrays: &Arrays, v: &mut Arrays) {
        let (i, o, m) = (self.inputs, self.outputs, self.wide());
        let part = |part: &str| values(arrays, &self.name(part));
        let mut take = |kind: &str| v.remove(&self.name(kind)).unwrap_or_default();
        let [v_weight, v_bias] = ["weight", "bias"].map(&mut take);
        let (v_weight, v_bias) = (v_weight.values(), v_bias.values());
        let mut set = |part: &str, values: Vec<f32>| {
            let shape = self.parts().into_iter().find(|(name, _)| *name == part).map(|(_, shape)| shape);
            put(v, self.name(part), &shape.unwrap_or_default(), values);
        };
        match self.kind {
            Kind::EdgeOriented => {
                let pair =
                    Pair { sizes: [o, m, i], first: part("expand.weight"), then: part("squeeze.weight") };
                let [v_expand, v_expand_bias, v_squeeze] =
                    pair.pull_back(part("expand.bias"), v_weight, v_bias);
                set("conv.weight", v_weight.to_vec());
                set("conv.bias", v_bias.to_vec());
                set("expand.weight", v_expand);
                set("expand.bias", v_expand_bias);
                set("squeeze.weight", v_squeeze);
                set("squeeze.bias", v_bias.to_vec());
                for (edge, mask) in EDGES {
                    let [first, scale] = ["weight", "scale"].map(|kind| part(&format!("{edge}.{kind}")));
                    let along = |v: &[f32]| v.iter().zip(mask).map(|(v, mask)| v * mask).sum::<f32>();
                    let v_factor: Vec<f32> = v_weight.chunks_exact(TAPS).map(along).collect();
                    let v_first = v_factor.iter().enumerate().map(|(k, v)| v * scale[k / i]).collect();
                    let of_output =
                        |(v, first): (&[f32], &[f32])| v.iter().zip(first).map(|(v, f)| v * f).sum();
                    let v_scale =
                        v_factor.chunks_exact(i).zip(first.chunks_exact(i)).map(of_output).collect();
                    set(&format!("{edge}.weight"), v_first);
                    set(&format!("{edge}.scale"), v_scale);
                    set(&format!("{edge}.bias"), v_bias.to_vec());
                }
            }
            Kind::Expanded => {
                let [inner, inner_bias] = self.inner(arrays);
                let reduce = part("reduce.weight");
                let mut v_reduce = vec![0.0; o * m];
                let (mut v_inner, mut v_inner_bias) = (vec![0.0; m * i * TAPS], vec![0.0; m]);
                for (k, (factor, v_factor)) in reduce.iter().zip(&mut v_reduce).enumerate() {
                    let (to, from) = (k / m, k % m);
                    let v_row = &v_weight[to * i * TAPS..][..i * TAPS];
                    let row = from * i * TAPS..(from + 1) * i * TAPS;
                    *v_factor = v_row.iter().zip(&inner[row.clone()]).map(|(v, w)| v * w).sum::<f32>()
                        + v_bias[to] * inner_bias[from];
                    v_inner[row].iter_mut().zip(v_row).for_each(|(sum, v)| *sum += factor * v);
                    v_inner_bias[from] += factor * v_bias[to];
                }
                let middle = self.middle(arrays);
                let pair = Pair { sizes: [m, m, i], first: part("expand.weight"), then: &middle };
                let [v_expand, v_expand_bias, v_middle] =
                    pair.pull_back(part("expand.bias"), &v_inner, &v_inner_bias);
                set("expand.weight", v_expand);
                set("expand.bias", v_expand_bias);
                set("middle.weight", v_middle);
                set("middle.bias", v_inner_bias);
                set("reduce.weight", v_reduce);
                set("reduce.bias", v_bias.to_vec());
            }
        }
    }
}

/// A 1×1 convolution, followed by a 3×3 convolution with the first one's bias as its border.
struct Pair<'a> {
    /// Channels of the result, between, and of the input.
    sizes: [usize; 3],
    /// `[between, inputs]`.
    first: &'a [f32],
    /// `[outputs, between, taps]`.
    then: &'a [f32],
}

impl Pair<'_> {
    /// The taps `then` from channel `between` to `output`.
    fn then(&self, output: usize, between: usize) -> &[f32] {
        &self.then[(output * self.sizes[1] + between) * TAPS..][..TAPS]
    }

    /// All pairs of an output with a channel between.
    fn paths(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [outputs, between, _] = self.sizes;
        (0..outputs).flat_map(move |o| (0..between).map(move |m| (o, m)))
    }

    /// Adds the weights of both together to `weight`, `[outputs, inputs, taps]`.
    fn fold(&self, weight: &mut [f32]) {
        let inputs = self.sizes[2];
        for (o, m) in self.paths() {
            let (then, row) = (self.then(o, m), &mut weight[o * inputs * TAPS..][..inputs * TAPS]);
            for (weight, first) in row.chunks_exact_mut(TAPS).zip(&self.first[m * inputs..]) {
                weight.iter_mut().zip(then).for_each(|(w, then)| *w += first * then);
            }
        }
    }

    /// Adds the contribution of `first_bias`, the bias of the first convolution, to `bias`.
    fn fold_bias(&self, first_bias: &[f32], bias: &mut [f32]) {
        for (o, m) in self.paths() {
            bias[o] += first_bias[m] * self.then(o, m).iter().sum::<f32>();
        }
    }

    /// Derivatives by the first's weights, its bias and the second's weights from those by the weights and bias of both
    /// together.
    fn pull_back(&self, first_bias: &[f32], v_weight: &[f32], v_bias: &[f32]) -> [Vec<f32>; 3] {
        let inputs = self.sizes[2];
        let (mut v_first, mut v_then) = (vec![0.0; self.first.len()], vec![0.0; self.then.len()]);
        let mut v_first_bias = vec![0.0; first_bias.len()];
        for (o, m) in self.paths() {
            let then = self.then(o, m);
            let v_then = &mut v_then[(o * self.sizes[1] + m) * TAPS..][..TAPS];
            v_then.fill(v_bias[o] * first_bias[m]);
            v_first_bias[m] += v_bias[o] * then.iter().sum::<f32>();
            let rows = v_weight[o * inputs * TAPS..].chunks_exact(TAPS).take(inputs);
            let places = m * inputs..(m + 1) * inputs;
            for ((v, first), v_first) in rows.zip(&self.first[places.clone()]).zip(&mut v_first[places]) {
                *v_first += v.iter().zip(then).map(|(v, then)| v * then).sum::<f32>();
                v_then.iter_mut().zip(v).for_each(|(sum, v)| *sum += first * v);
            }
        }
        [v_first, v_first_bias, v_then]
    }
}

/// The numbers of an array that is there: weights are checked before they are trained.
fn values<'a>(arrays: &'a Arrays, name: &str) -> &'a [f32] {
    arrays.get(name).map_or(&[], |array| array.values())
}

/// Puts an array of that shape there.
fn put(arrays: &mut Arrays, name: String, shape: &[usize], values: Vec<f32>) {
    if let Ok(array) = Array::new(&name, shape, values) {
        arrays.insert(name, array);
    }
}

fn add(sum: &mut [f32], addend: &[f32]) {
    sum.iter_mut().zip(addend).for_each(|(sum, v)| *sum += v);
}

#[cfg(test)]
mod tests;
