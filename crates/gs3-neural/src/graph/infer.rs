//! How operations change shapes.

use super::error::GraphError;
use super::op::{Layer, Op};
use super::shape::{MAX_SIDE, Shape};

/// The largest window and the largest enlargement: beyond any network of use, and far from overflow.
const MAX_FACTOR: usize = 64;

/// The shape of `layer`'s result from the shapes of its inputs. `lr` is `[height, width]` of the LR grid.
pub(super) fn infer(layer: &Layer, inputs: &[Shape], lr: [usize; 2]) -> Result<Shape, GraphError> {
    let fail = |expected: String| {
        let actual: Vec<String> = inputs.iter().map(Shape::to_string).collect();
        let actual = if actual.is_empty() { "none".to_owned() } else { actual.join(", ") };
        Err(GraphError::Shape { layer: layer.name.clone(), expected, actual })
    };
    let arity = layer.op.inputs();
    if !arity.contains(&inputs.len()) {
        return fail(format!("{} to {} inputs", arity.start(), arity.end()));
    }
    if let Some(factor) = layer.op.factor()
        && !(1..=MAX_FACTOR).contains(&factor)
    {
        return fail(format!("a factor of 1 to {MAX_FACTOR}, found {factor}"));
    }
    let shape = match (&layer.op, inputs) {
        (Op::Input { channels, scale }, _) => {
            Shape { height: lr[0] * scale, width: lr[1] * scale, channels: *channels }
        }
        (Op::Conv2d(conv), [x]) => {
            if conv.kernel % 2 == 0 || !(1..=MAX_FACTOR).contains(&conv.dilation) {
                return fail(format!("an odd kernel, found {} with dilation {}", conv.kernel, conv.dilation));
            }
            x.with_channels(conv.outputs)
        }
        (Op::Activate(_) | Op::Prelu | Op::LayerNorm { .. } | Op::Scale { .. }, [x]) => *x,
        (Op::Shift { .. }, [x]) => match x.channels % 3 {
            0 => *x,
            _ => return fail("a multiple of three channels".to_owned()),
        },
        (Op::PixelShuffle { factor }, [x, like @ ..]) => {
            let square = factor * factor;
            if x.channels % square != 0 {
                return fail(format!("a multiple of {square} channels"));
            }
            let full =
                Shape { height: x.height * factor, width: x.width * factor, channels: x.channels / square };
            match cropped(full, like) {
                Some(shape) => shape,
                None => return fail(format!("a crop of at most {}×{}", full.height, full.width)),
            }
        }
        (Op::Upsample { factor }, [x, like @ ..]) => {
            let full = Shape { height: x.height * factor, width: x.width * factor, channels: x.channels };
            match cropped(full, like) {
                Some(shape) => shape,
                None => return fail(format!("a crop of at most {}×{}", full.height, full.width)),
            }
        }
        (Op::PixelUnshuffle { factor }, [x]) => {
            if x.height % factor != 0 || x.width % factor != 0 {
                return fail(format!("sides that are multiples of {factor}"));
            }
            let (height, width) = (x.height / factor, x.width / factor);
            Shape { height, width, channels: x.channels * factor * factor }
        }
        (Op::MaxPool2, [x]) => Shape { height: x.height.div_ceil(2), width: x.width.div_ceil(2), ..*x },
        (Op::AveragePool { side, stride }, [x]) => {
            if side % 2 == 0 || !(1..=*side).contains(stride) {
                return fail(format!("an odd side and a stride of at most that, found {side} and {stride}"));
            }
            Shape { height: x.height.div_ceil(*stride), width: x.width.div_ceil(*stride), ..*x }
        }
        (Op::Concat, [first, ..]) => {
            if inputs.iter().any(|x| !x.same_size(first)) {
                return fail(format!("inputs of {}×{}", first.height, first.width));
            }
            first.with_channels(inputs.iter().map(|x| x.channels).sum())
        }
        (Op::Slice { first, count }, [x]) => match first.checked_add(*count) {
            Some(end) if end <= x.channels => x.with_channels(*count),
            _ => return fail(format!("channels {first} and the {count} from there on")),
        },
        (Op::Add, [a, b]) => match a == b {
            true => *a,
            false => return fail(format!("two inputs of {a}")),
        },
        (Op::Multiply, [a, factor]) => {
            match factor.same_size(a) && [1, a.channels].contains(&factor.channels) {
                true => *a,
                false => return fail(format!("{a} and a factor of as many channels, or one")),
            }
        }
        (Op::Mix, [a, b, t]) => match a == b && t.same_size(a) && [1, a.channels].contains(&t.channels) {
            true => *a,
            false => return fail(format!("two inputs of {a} and a weight of as many channels, or one")),
        },
        (Op::ChannelMean | Op::ChannelMax, [x]) => x.with_channels(1),
        (Op::Warp, [image, flow]) => match flow.same_size(image) && flow.channels == 2 {
            true => *image,
            false => return fail(format!("{image} and a flow of two channels and that size")),
        },
        // Arity was checked above.
        _ => return fail("other inputs".to_owned()),
    };
    if shape.is_empty() || [shape.height, shape.width, shape.channels].iter().any(|side| *side > MAX_SIDE) {
        return fail(format!("a result of 1 to {MAX_SIDE} a side, which {shape} is not"));
    }
    Ok(shape)
}

/// `full` cut to the size of `like`, where there is one; none if that is larger.
fn cropped(full: Shape, like: &[Shape]) -> Option<Shape> {
    match like {
        [like] if like.height > full.height || like.width > full.width => None,
        [like] => Some(Shape { channels: full.channels, ..*like }),
        _ => Some(full),
    }
}
