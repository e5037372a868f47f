//! Weights of a network grown into those of a larger one that computes the same (Net2Net, Chen et al. 2016), so that its
//! training begins where the smaller one's ended.

use super::initial_weights;
use crate::arrays::Array;
use crate::error::GraphError;
use crate::graph::{Graph, Op, Tensor};
use crate::weights::{Header, Weights};

/// Where channels of a tensor of the smaller network are in a tensor of the larger one.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Place {
    /// Channel k of the smaller one's is channel `places[k]`.
    Old(Vec<usize>),
    /// The smaller one has no such tensor, and this one is zero.
    Zero,
}

/// Weights of `large` with which it gives what `small` gives with `weights`: channels and windows that the smaller one lacks
/// count nothing, but are there to learn; layers that it lacks are zero, and must be added to something. What is new begins at
/// random, the same for the same seed.
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
                (Op::Add, [old @ Place::Old(_), Place::Zero]) => (*old).clone(),
                _ => return Err(fail("a layer of both networks, or one added".into(), "neither".into())),
            });
            continue;
        };
        // What it reads holds all that the smaller one's reads.
        let read: Vec<&[usize]> = inputs
            .iter()
            .zip(&old.inputs)
            .filter_map(|(place, t)| match place {
                Place::Old(places) if places.len() == small.channels(*t) => Some(&places[..]),
                _ => None,
            })
            .collect();
        if read.len() != layer.inputs.len() || read.len() != old.inputs.len() {
            let text = |inputs: usize| format!("{inputs} inputs of both networks");
            return Err(fail(text(old.inputs.len()), text(read.len())));
        }
        for (kind, array) in of_layer {
            let name = format!("{}.{kind}", layer.name);
            match (weights.arrays.get(&name), &old.op, &read[..]) {
                (Some(old), Op::Conv2d(_), [read]) => embed(old, read, array),
                (Some(old), ..) if old.shape() == array.shape() => {
                    array.values_mut().copy_from_slice(old.values());
                }
                _ => {}
            }
        }
        let Some(result) = result(&old.op, &layer.op, &read, large, &layer.inputs) else {
            return Err(fail(format!("{:?}", old.op), format!("{:?} of other channels", layer.op)));
        };
        places.push(Place::Old(result));
    }
    Ok(start)
}

/// Where channels of what `old` gives are in what `new` gives; none if operations differ in kind or mix channels.
fn result(old: &Op, new: &Op, read: &[&[usize]], large: &Graph, inputs: &[Tensor]) -> Option<Vec<usize>> {
    let first = read.first().copied().unwrap_or_default();
    let is_all = || {
        let channels = inputs.iter().map(|t| large.channels(*t));
        read.iter().zip(channels).all(|(read, channels)| read.len() == channels)
    };
    match (old, new) {
        (Op::Input { channels, scale }, Op::Input { channels: now, scale: same }) => {
            (channels <= now && scale == same).then(|| (0..*channels).collect())
        }
        (Op::Conv2d(old), Op::Conv2d(new)) => {
            let is_within = old.outputs <= new.outputs && old.kernel <= new.kernel;
            let is_alike =
                (old.dilation, old.activation, old.bias) == (new.dilation, new.activation, new.bias);
            // Windows grow around their middle, whose distance between taps must stay.
            let is_aligned = old.kernel == new.kernel || old.kernel == 1 || old.dilation == new.dilation;
            (is_within && is_alike && is_aligned).then(|| (0..old.outputs).collect())
        }
        (Op::Concat, Op::Concat) => {
            let mut before = 0;
            let mut places = Vec::new();
            for (read, tensor) in read.iter().zip(inputs) {
                places.extend(read.iter().map(|k| before + k));
                before += large.channels(*tensor);
            }
            Some(places)
        }
        (Op::Slice { first: from, count }, Op::Slice { first: now, count: new }) => {
            let place = |k: &usize| k.checked_sub(*now).filter(|k| k < new);
            first.get(*from..from + count)?.iter().map(place).collect()
        }
        (Op::PixelUnshuffle { factor }, Op::PixelUnshuffle { factor: same }) if factor == same => {
            let block = factor * factor;
            Some(first.iter().flat_map(|k| (0..block).map(move |i| k * block + i)).collect())
        }
        (Op::PixelShuffle { factor }, Op::PixelShuffle { factor: same }) if factor == same => {
            let block = factor * factor;
            let places: Vec<usize> = first.iter().step_by(block).map(|k| k / block).collect();
            let is_whole = first.iter().enumerate().all(|(i, k)| *k == places[i / block] * block + i % block);
            is_whole.then_some(places)
        }
        // Of each channel on its own.
        (
            Op::Activate(_) | Op::Add | Op::Multiply | Op::Mix | Op::Warp | Op::MaxPool2 | Op::Scale { .. },
            _,
        ) if old == new => Some(first.to_vec()),
        _ if old == new && is_all() => Some((0..first.len()).collect()),
        _ => None,
    }
}

/// Puts the weights or biases of a convolution that reads channels `read` into those of a larger one, whose first outputs are
/// then the smaller one's.
fn embed(old: &Array, read: &[usize], new: &mut Array) {
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
        rows[(output * channels + read[input]) * window + (y + middle) * side + x + middle] = *value;
    }
}
