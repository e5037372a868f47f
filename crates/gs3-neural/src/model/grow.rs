//! Weights of a network grown into weights of a larger network that computes the same (Net2Net, Chen et al. 2016).
//! Training of the larger network then begins where the smaller network's ended.

use super::initial_weights;
use crate::arrays::Array;
use crate::graph::{Activation, Graph, GraphError, Op, Tensor};
use crate::weights::{Header, Weights};

/// A channel of the larger network's tensor that holds one of the smaller one's.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Channel {
    index: usize,
    /// What it holds over what the smaller one's holds: less than 1 for means, which are over more channels.
    factor: f32,
}

/// Where channels of a tensor of the smaller network are in a tensor of the larger one.
#[derive(Clone, Debug, PartialEq)]
enum Place {
    /// Channel k of the smaller one's is `channels[k]`.
    Old { channels: Vec<Channel>, others_are_zero: bool },
    /// The smaller one has no such tensor, and this one is zero.
    Zero,
}

/// Weights of `large` with which it gives what `small` gives with `weights`: channels and windows that the smaller
/// one lacks count nothing, but are there to learn; layers that it lacks are zero, and must be added to something.
/// What is new begins at random, the same for the same seed; but new channels begin at zero where means or maxima are
/// taken over all channels, so that both differ only where all channels of the smaller network are negative: their
/// maximum is zero then.
///
/// # Errors
/// [`GraphError::Shape`] naming a layer in which both networks differ in another way.
///
/// # Panics
/// Never for `weights` that [`Weights::check`] accepts for `small`.
pub fn grown(
    small: &Graph,
    weights: &Weights,
    large: &Graph,
    header: Header,
    seed: u64,
) -> Result<Weights, GraphError> {
    let mut start = initial_weights(large, header, seed);
    let mut places: Vec<Place> = Vec::with_capacity(large.layers().len());
    for layer in large.layers() {
        let fail = |expected: String, actual: String| GraphError::Shape {
            layer: layer.name.clone(),
            expected,
            actual,
        };
        let inputs: Vec<&Place> = layer.inputs.iter().map(|t| &places[t.index()]).collect();
        let of_layer = start.arrays.iter_mut().filter_map(|(name, array)| {
            let (owner, kind) = name.rsplit_once('.')?;
            (owner == layer.name).then_some((kind, array))
        });
        let Some(old) = small.layers().iter().find(|old| old.name == layer.name) else {
            places.push(match (&layer.op, &inputs[..]) {
                (Op::Conv2d(_), _) => {
                    of_layer.for_each(|(_, array)| array.values_mut().fill(0.0));
                    Place::Zero
                }
                (Op::Add, [old @ Place::Old { .. }, Place::Zero]) => (*old).clone(),
                _ => return Err(fail("a layer of both networks, or one added".into(), "neither".into())),
            });
            continue;
        };
        // What it reads holds all that the smaller one's reads.
        let read: Vec<&[Channel]> = inputs
            .iter()
            .zip(&old.inputs)
            .filter_map(|(place, t)| match place {
                Place::Old { channels, .. } if channels.len() == small.channels(*t) => Some(&channels[..]),
                _ => None,
            })
            .collect();
        if read.len() != layer.inputs.len() || read.len() != old.inputs.len() {
            let text = |inputs: usize| format!("{inputs} inputs of both networks");
            return Err(fail(text(old.inputs.len()), text(read.len())));
        }
        let others_are_zero = is_pooled(large, places.len()) && keeps_zero(&layer.op);
        for (kind, array) in of_layer {
            let name = format!("{}.{kind}", layer.name);
            if others_are_zero {
                array.values_mut().fill(0.0);
            }
            match (weights.arrays.get(&name), &old.op, &read[..]) {
                (Some(old), Op::Conv2d(_), [read]) => embed(old, read, array),
                (Some(old), ..) if old.shape() == array.shape() => {
                    array.values_mut().copy_from_slice(old.values());
                }
                _ => {}
            }
        }
        let other_inputs_are_zero =
            inputs.iter().all(|place| matches!(place, Place::Old { others_are_zero: true, .. }));
        let Some(channels) = result(&old.op, &layer.op, &read, other_inputs_are_zero, large, &layer.inputs)
        else {
            return Err(fail(format!("{:?}", old.op), format!("{:?} of other channels", layer.op)));
        };
        places.push(Place::Old { channels, others_are_zero });
    }
    Ok(start)
}

/// Whether means or maxima over all its channels are taken of what layer `index` gives.
fn is_pooled(graph: &Graph, index: usize) -> bool {
    let over_all = |op: &Op| matches!(op, Op::ChannelMean | Op::ChannelMax);
    graph
        .layers()
        .iter()
        .any(|reader| over_all(&reader.op) && reader.inputs.iter().any(|t| t.index() == index))
}

/// Whether outputs are zero if their weights are zero.
fn keeps_zero(op: &Op) -> bool {
    matches!(op, Op::Conv2d(conv) if conv.activation != Activation::Sigmoid)
}

/// Where channels of what `old` gives are in what `new` gives; none if operations differ in kind or mix channels.
/// `other_inputs_are_zero`: the inputs' channels that the smaller network lacks are zero.
fn result(
    old: &Op,
    new: &Op,
    read: &[&[Channel]],
    other_inputs_are_zero: bool,
    large: &Graph,
    inputs: &[Tensor],
) -> Option<Vec<Channel>> {
    let at = |index| Channel { index, factor: 1.0 };
    let first = read.first().copied().unwrap_or_default();
    let is_all = || {
        let channels = inputs.iter().map(|t| large.channels(*t));
        read.iter().zip(channels).all(|(read, channels)| read.len() == channels)
    };
    // Convolutions undo factors; other operations would need channels as they are.
    let is_linear = matches!(old, Op::Conv2d(_) | Op::Concat);
    if !is_linear && read.iter().any(|read| read.iter().any(|channel| channel.factor != 1.0)) {
        return None;
    }
    match (old, new) {
        (Op::Input { channels, scale }, Op::Input { channels: now, scale: same }) => {
            (channels <= now && scale == same).then(|| (0..*channels).map(at).collect())
        }
        (Op::ChannelMean, Op::ChannelMean) if other_inputs_are_zero => {
            let channels = large.channels(*inputs.first()?);
            Some(vec![Channel { index: 0, factor: first.len() as f32 / channels as f32 }])
        }
        (Op::ChannelMax, Op::ChannelMax) if other_inputs_are_zero => Some(vec![at(0)]),
        (Op::Conv2d(old), Op::Conv2d(new)) => {
            let is_within = old.outputs <= new.outputs && old.kernel <= new.kernel;
            let is_alike =
                (old.dilation, old.activation, old.bias) == (new.dilation, new.activation, new.bias);
            // Windows grow around their middle; the distance between taps stays.
            (is_within && is_alike).then(|| (0..old.outputs).map(at).collect())
        }
        (Op::Concat, Op::Concat) => {
            let mut before = 0;
            let mut places = Vec::new();
            for (read, tensor) in read.iter().zip(inputs) {
                places.extend(read.iter().map(|k| Channel { index: before + k.index, ..*k }));
                before += large.channels(*tensor);
            }
            Some(places)
        }
        (Op::Slice { first: from, count }, Op::Slice { first: now, count: new }) => {
            let place = |k: &Channel| k.index.checked_sub(*now).filter(|k| k < new).map(at);
            first.get(*from..from + count)?.iter().map(place).collect()
        }
        (Op::PixelUnshuffle { factor }, Op::PixelUnshuffle { factor: same }) if factor == same => {
            let block = factor * factor;
            Some(first.iter().flat_map(|k| (0..block).map(move |i| at(k.index * block + i))).collect())
        }
        (Op::PixelShuffle { factor }, Op::PixelShuffle { factor: same }) if factor == same => {
            let block = factor * factor;
            let places: Vec<Channel> = first.iter().step_by(block).map(|k| at(k.index / block)).collect();
            let inside = |i: usize| places[i / block].index * block + i % block;
            first.iter().enumerate().all(|(i, k)| k.index == inside(i)).then_some(places)
        }
        // Of each channel on its own.
        (
            Op::Activate(_) | Op::Add | Op::Multiply | Op::Mix | Op::Warp | Op::MaxPool2 | Op::Scale { .. },
            _,
        ) if old == new => Some(first.to_vec()),
        _ if old == new && is_all() => Some((0..first.len()).map(at).collect()),
        _ => None,
    }
}

/// Copies the weights or biases of a convolution that reads channels `read` into a larger convolution. The first
/// outputs of the larger one are then the outputs of the smaller one.
fn embed(old: &Array, read: &[Channel], new: &mut Array) {
    let (&[outputs, inputs, kernel, _], &[_, channels, side, _]) = (old.shape(), new.shape()) else {
        // Biases.
        new.values_mut()[..old.values().len()].copy_from_slice(old.values());
        return;
    };
    let window = side * side;
    // Windows have odd sides and grow around their middle.
    let (middle, rows) = ((side - kernel) / 2, new.values_mut());
    rows[..outputs * channels * window].fill(0.0);
    for (k, value) in old.values().iter().enumerate() {
        let (x, y) = (k % kernel, k / kernel % kernel);
        let (input, output) = (k / (kernel * kernel) % inputs, k / (kernel * kernel * inputs));
        let Channel { index, factor } = read[input];
        rows[(output * channels + index) * window + (y + middle) * side + x + middle] = *value / factor;
    }
}
