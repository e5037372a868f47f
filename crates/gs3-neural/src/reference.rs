//! What every operation means: naive loops in double precision, the oracle of the engines and of derivatives.

use crate::error::RunError;
use crate::graph::{Activation, Border, Conv2d, Graph, Op, Shape, Tensor};
use crate::images::{self, Named};
use crate::weights::Weights;

/// A tensor in double precision, channels last.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Its size.
    pub shape: Shape,
    /// `[height, width, channels]`.
    pub values: Vec<f64>,
}

impl Plane {
    /// Zeros.
    #[must_use]
    pub fn zeros(shape: Shape) -> Self {
        Self { shape, values: vec![0.0; shape.len()] }
    }

    /// Where channel `c` of pixel (x, y) is.
    #[must_use]
    pub fn index(&self, x: usize, y: usize, c: usize) -> usize {
        (y * self.shape.width + x) * self.shape.channels + c
    }

    /// Channel `c` of pixel (x, y).
    #[must_use]
    pub fn at(&self, x: usize, y: usize, c: usize) -> f64 {
        self.values[self.index(x, y, c)]
    }

    fn from_fn(shape: Shape, f: impl Fn(usize, usize, usize) -> f64) -> Self {
        let mut values = Vec::with_capacity(shape.len());
        for y in 0..shape.height {
            for x in 0..shape.width {
                values.extend((0..shape.channels).map(|c| f(x, y, c)));
            }
        }
        Self { shape, values }
    }
}

/// The results of all layers of `graph` for an LR grid of `[height, width]`, in the order of [`Graph::layers`].
///
/// # Errors
/// [`RunError`] if weights or images do not fit.
pub fn run(
    graph: &Graph,
    weights: &Weights,
    lr: [usize; 2],
    images: &[Named<'_>],
) -> Result<Vec<Plane>, RunError> {
    let shapes = graph.shapes(lr)?;
    weights.check(graph)?;
    images::check(graph, &shapes, images)?;
    let mut planes: Vec<Plane> = Vec::with_capacity(shapes.len());
    for (k, shape) in shapes.iter().enumerate() {
        let plane = match images::find(images, &graph.layers()[k].name) {
            Some(image) => Plane { shape: *shape, values: image.iter().map(|v| f64::from(*v)).collect() },
            None => layer(graph, weights, k, &planes, *shape),
        };
        planes.push(plane);
    }
    Ok(planes)
}

/// The result of layer `k` from the results of the layers before it.
pub(crate) fn layer(graph: &Graph, weights: &Weights, k: usize, planes: &[Plane], shape: Shape) -> Plane {
    let layer = &graph.layers()[k];
    let input = |i: usize| &planes[layer.inputs[i].index()];
    match &layer.op {
        // Given from outside: there is nothing to compute.
        Op::Input { .. } => Plane::zeros(shape),
        Op::Conv2d(conv) => convolution(graph, weights, &layer.name, conv, input(0), shape),
        Op::Activate(activation) => {
            Plane { shape, values: input(0).values.iter().map(|v| activate(*activation, *v)).collect() }
        }
        Op::PixelShuffle { factor: f } => {
            Plane::from_fn(shape, |x, y, c| input(0).at(x / f, y / f, c * f * f + y % f * f + x % f))
        }
        Op::PixelUnshuffle { factor: f } => Plane::from_fn(shape, |x, y, c| {
            let (channel, i, j) = (c / (f * f), c / f % f, c % f);
            input(0).at(x * f + j, y * f + i, channel)
        }),
        Op::Upsample { factor } => Plane::from_fn(shape, |x, y, c| input(0).at(x / factor, y / factor, c)),
        Op::MaxPool2 => Plane::from_fn(shape, |x, y, c| {
            window(input(0).shape, x, y).map(|(x, y)| input(0).at(x, y, c)).fold(f64::NEG_INFINITY, f64::max)
        }),
        Op::Prelu => {
            let slopes = weights.parameter(&layer.name, "weight");
            Plane::from_fn(shape, |x, y, c| {
                let value = input(0).at(x, y, c);
                if value > 0.0 { value } else { f64::from(slopes[c]) * value }
            })
        }
        Op::LayerNorm { epsilon } => {
            let [weight, bias] = ["weight", "bias"].map(|kind| weights.parameter(&layer.name, kind));
            Plane::from_fn(shape, |x, y, c| {
                let [mean, deviation] = moments(input(0), x, y, *epsilon);
                (input(0).at(x, y, c) - mean) / deviation * f64::from(weight[c]) + f64::from(bias[c])
            })
        }
        Op::Scale { factor } => Plane::from_fn(shape, |x, y, c| f64::from(*factor) * input(0).at(x, y, c)),
        Op::Shift { color } => {
            Plane::from_fn(shape, |x, y, c| input(0).at(x, y, c) + f64::from(color[3 * c / shape.channels]))
        }
        Op::AveragePool { side, stride } => Plane::from_fn(shape, |x, y, c| {
            let pixels = pooled(input(0).shape, [x, y], *side, *stride);
            let count = pixels.clone().count() as f64;
            pixels.map(|(x, y)| input(0).at(x, y, c)).sum::<f64>() / count
        }),
        Op::Concat => Plane::from_fn(shape, |x, y, mut c| {
            let mut parts = layer.inputs.iter().map(|t: &Tensor| &planes[t.index()]);
            let part = parts.find(|part| {
                let here = c < part.shape.channels;
                c -= if here { 0 } else { part.shape.channels };
                here
            });
            part.map_or(0.0, |part| part.at(x, y, c))
        }),
        Op::Slice { first, .. } => Plane::from_fn(shape, |x, y, c| input(0).at(x, y, first + c)),
        Op::Add => Plane::from_fn(shape, |x, y, c| input(0).at(x, y, c) + input(1).at(x, y, c)),
        Op::Multiply => Plane::from_fn(shape, |x, y, c| input(0).at(x, y, c) * broadcast(input(1), x, y, c)),
        Op::Mix => Plane::from_fn(shape, |x, y, c| {
            let (a, b) = (input(0).at(x, y, c), input(1).at(x, y, c));
            a + broadcast(input(2), x, y, c) * (b - a)
        }),
        Op::ChannelMean => Plane::from_fn(shape, |x, y, _| {
            let n = input(0).shape.channels;
            (0..n).map(|c| input(0).at(x, y, c)).sum::<f64>() / n as f64
        }),
        Op::ChannelMax => Plane::from_fn(shape, |x, y, _| {
            (0..input(0).shape.channels).map(|c| input(0).at(x, y, c)).fold(f64::NEG_INFINITY, f64::max)
        }),
        Op::Warp => Plane::from_fn(shape, |x, y, c| {
            let [dx, dy] = [0, 1].map(|k| input(1).at(x, y, k));
            let taps = taps(input(0).shape, x as f64 + dx, y as f64 + dy);
            taps.iter().map(|t| t.weight * input(0).at(t.x, t.y, c)).sum()
        }),
    }
}

fn convolution(
    graph: &Graph,
    weights: &Weights,
    name: &str,
    conv: &Conv2d,
    input: &Plane,
    shape: Shape,
) -> Plane {
    let w = weights.parameter(name, "weight");
    let bias = conv.bias.then(|| weights.parameter(name, "bias"));
    let (k, channels) = (conv.kernel, input.shape.channels);
    Plane::from_fn(shape, |x, y, o| {
        let mut sum = bias.map_or(0.0, |bias| f64::from(bias[o]));
        for tap in 0..k * k {
            let Some((x, y)) = tap_at(graph.border(), conv, input.shape, x, y, tap) else { continue };
            for i in 0..channels {
                sum += f64::from(w[(o * channels + i) * k * k + tap]) * input.at(x, y, i);
            }
        }
        activate(conv.activation, sum)
    })
}

/// The pixel that tap `tap` of a window at (x, y) sees; none where it sees zero.
pub(crate) fn tap_at(
    border: Border,
    conv: &Conv2d,
    shape: Shape,
    x: usize,
    y: usize,
    tap: usize,
) -> Option<(usize, usize)> {
    let place = |at: usize, tap: usize, side: usize| {
        let place = (at + tap * conv.dilation) as isize - conv.reach() as isize;
        match border {
            Border::Zero => usize::try_from(place).ok().filter(|place| *place < side),
            Border::Replicate => Some(place.clamp(0, side as isize - 1) as usize),
        }
    };
    Some((place(x, tap % conv.kernel, shape.width)?, place(y, tap / conv.kernel, shape.height)?))
}

/// The number for all channels where there is one only.
pub(crate) fn broadcast(plane: &Plane, x: usize, y: usize, c: usize) -> f64 {
    plane.at(x, y, if plane.shape.channels == 1 { 0 } else { c })
}

/// The pixels that pool into (x, y).
pub(crate) fn window(shape: Shape, x: usize, y: usize) -> impl Iterator<Item = (usize, usize)> {
    let (right, below) = ((2 * x + 1).min(shape.width - 1), (2 * y + 1).min(shape.height - 1));
    (2 * y..=below).flat_map(move |y| (2 * x..=right).map(move |x| (x, y)))
}

/// Mean of the channels of pixel (x, y), and the root of their variance plus `epsilon`.
pub(crate) fn moments(plane: &Plane, x: usize, y: usize, epsilon: f32) -> [f64; 2] {
    let n = plane.shape.channels;
    let mean = (0..n).map(|c| plane.at(x, y, c)).sum::<f64>() / n as f64;
    let variance = (0..n).map(|c| (plane.at(x, y, c) - mean).powi(2)).sum::<f64>() / n as f64;
    [mean, (variance + f64::from(epsilon)).sqrt()]
}

/// The pixels that [`Op::AveragePool`] sees at (x, y) of its result.
pub(crate) fn pooled(
    shape: Shape,
    [x, y]: [usize; 2],
    side: usize,
    stride: usize,
) -> impl Iterator<Item = (usize, usize)> + Clone {
    let taps = (0..side).flat_map(move |dy| (0..side).map(move |dx| (x * stride + dx, y * stride + dy)));
    // For a window with its first tap half a side above and left of its centre.
    let inside = move |(x, y): (usize, usize)| Some((x.checked_sub(side / 2)?, y.checked_sub(side / 2)?));
    taps.filter_map(inside).filter(move |(x, y)| *x < shape.width && *y < shape.height)
}

/// A pixel of bilinear interpolation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tap {
    pub x: usize,
    pub y: usize,
    pub weight: f64,
    /// Derivatives of the weight by the place.
    pub slope: [f64; 2],
}

/// The pixels around (x, y), where pixel centres are at integers. Places outside are moved to the border.
pub(crate) fn taps(shape: Shape, x: f64, y: f64) -> [Tap; 4] {
    let axis = |place: f64, side: usize| {
        let last = (side - 1) as f64;
        // Moving beyond the border changes nothing.
        let inside = if (0.0..=last).contains(&place) { 1.0 } else { 0.0 };
        let place = place.clamp(0.0, last);
        let first = (place.floor() as usize).min(side.saturating_sub(2));
        let fraction = place - first as f64;
        [(first, 1.0 - fraction, -inside), ((first + 1).min(side - 1), fraction, inside)]
    };
    let (xs, ys) = (axis(x, shape.width), axis(y, shape.height));
    std::array::from_fn(|k| {
        let ((x, wx, dx), (y, wy, dy)) = (xs[k % 2], ys[k / 2]);
        Tap { x, y, weight: wx * wy, slope: [dx * wy, wx * dy] }
    })
}

/// An activation.
pub(crate) fn activate(activation: Activation, x: f64) -> f64 {
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    match activation {
        Activation::Identity => x,
        Activation::Relu => x.max(0.0),
        Activation::LeakyRelu { slope } => {
            if x > 0.0 {
                x
            } else {
                f64::from(slope) * x
            }
        }
        Activation::Gelu => x * normal_distribution(x),
        Activation::Silu => x * sigmoid(x),
        Activation::Sigmoid => sigmoid(x),
        Activation::Tanh => x.tanh(),
    }
}

/// Φ(x) = ½ (1 + erf(x/√2)), by the series ½ + φ(x) (x + x³/3 + x⁵/(3·5) + …). All terms have one sign.
pub(crate) fn normal_distribution(x: f64) -> f64 {
    // Beyond, Φ is 0 or 1 to 1e-15, and the series is long.
    if x.abs() > 8.0 {
        return if x > 0.0 { 1.0 } else { 0.0 };
    }
    let (mut term, mut sum, mut n) = (x, x, 1.0);
    while term.abs() > 1e-17 * sum.abs() {
        n += 2.0;
        term *= x * x / n;
        sum += term;
    }
    0.5 + sum * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt()
}
