//! Kernels of all operations but convolutions.

use super::source::{self, BLOCK, PARTS};
use super::{ImageFormat, Precision};
use crate::graph::{Filter, Op};
use crate::shape::Shape;

/// The kernel of `op` from tensors of shapes `reads`; `concat` lists, for a concatenation, which of them come one after
/// the other.
pub fn map(op: &Op, reads: &[Shape], concat: &[usize], result: Shape, precision: Precision) -> String {
    let broadcast = |k: usize| match reads.get(k) {
        Some(shape) if shape.channels == 1 => format!("vec4<f32>(part{k}_block(0u, x, y).x)"),
        _ => format!("part{k}_block(block, x, y)"),
    };
    let body = match op {
        Op::Activate(_) => "return activate(part0_block(block, x, y));".to_owned(),
        Op::Add => "return part0_block(block, x, y) + part1_block(block, x, y);".to_owned(),
        Op::Multiply => format!("return part0_block(block, x, y) * {};", broadcast(1)),
        Op::Mix => format!(
            "let a = part0_block(block, x, y);\n    return a + {} * (part1_block(block, x, y) - a);",
            broadcast(2)
        ),
        Op::ChannelMean => CHANNEL_MEAN.to_owned(),
        Op::ChannelMax => CHANNEL_MAX.to_owned(),
        Op::MaxPool2 => "let right = min(2u * x + 1u, PART0_WIDTH - 1u);
    let below = min(2u * y + 1u, PART0_HEIGHT - 1u);
    let first = max(part0_block(block, 2u * x, 2u * y), part0_block(block, right, 2u * y));
    return max(first, max(part0_block(block, 2u * x, below), part0_block(block, right, below)));"
            .to_owned(),
        Op::Upsample { factor, filter: Filter::Nearest } => {
            format!("return part0_block(block, x / {factor}u, y / {factor}u);")
        }
        Op::Upsample { factor, filter: Filter::Bilinear } => format!(
            "return part0_between(block, (f32(x) + 0.5) / {factor}.0 - 0.5, (f32(y) + 0.5) / {factor}.0 - 0.5);"
        ),
        Op::Warp => "let flow = part1_block(0u, x, y).xy;
    return part0_between(block, f32(x) + flow.x, f32(y) + flow.y);"
            .to_owned(),
        Op::Slice { first, .. } if first % BLOCK == 0 => {
            format!("return part0_block(block + {}u, x, y);", first / BLOCK)
        }
        Op::Concat if concat.iter().all(|k| reads[*k].channels.is_multiple_of(BLOCK)) => {
            let mut first = 0;
            concat_parts(reads, concat, |k, start, end| {
                let read = format!("return part{k}_block(block - {first}u, x, y);", first = start / BLOCK);
                first = end;
                format!("if block < {}u {{ {read} }}", end / BLOCK)
            }) + "return vec4<f32>(0.0);"
        }
        _ => BY_CHANNEL.to_owned(),
    };
    let channel = match op {
        Op::Slice { first, .. } => format!("return part0_channel(c + {first}u, x, y);"),
        Op::Concat => {
            concat_parts(reads, concat, |k, start, end| {
                format!("if c < {end}u {{ return part{k}_channel(c - {start}u, x, y); }}")
            }) + "return 0.0;"
        }
        Op::PixelShuffle { factor: f } => {
            format!("return part0_channel(c * {f}u * {f}u + y % {f}u * {f}u + x % {f}u, x / {f}u, y / {f}u);")
        }
        Op::PixelUnshuffle { factor: f } => format!(
            "return part0_channel(c / {square}u, x * {f}u + c % {f}u, y * {f}u + c / {f}u % {f}u);",
            square = f * f
        ),
        _ => "return 0.0;".to_owned(),
    };
    let mut text = source::header(precision) + &source::tensors(reads, result);
    if let Op::Activate(activation) = op {
        text += &source::activate(*activation);
    }
    if matches!(op, Op::Warp | Op::Upsample { filter: Filter::Bilinear, .. }) {
        text += include_str!("bilinear.wgsl");
    }
    text += &by_channel(&channel);
    text + &format!("fn value(block: u32, x: u32, y: u32) -> vec4<f32> {{\n    {body}\n}}\n")
        + include_str!("map.wgsl")
}

/// One line for each part of a concatenation, which has channels `start..end` of the result.
fn concat_parts(
    reads: &[Shape],
    concat: &[usize],
    mut line: impl FnMut(usize, usize, usize) -> String,
) -> String {
    let mut start = 0;
    let parts = concat.iter().map(|k| {
        let end = start + reads[*k].channels;
        let text = line(*k, start, end) + "\n    ";
        start = end;
        text
    });
    parts.collect()
}

/// Four channels, one by one; those beyond the last are 0.
const BY_CHANNEL: &str = "return vec4<f32>(by_channel(4u * block, x, y), by_channel(4u * block + 1u, x, y),
        by_channel(4u * block + 2u, x, y), by_channel(4u * block + 3u, x, y));";

fn by_channel(body: &str) -> String {
    format!(
        "fn by_channel(c: u32, x: u32, y: u32) -> f32 {{\n    if c >= CHANNELS {{ return 0.0; }}\n    {body}\n}}\n"
    )
}

const CHANNEL_MEAN: &str = "var sum = vec4<f32>(0.0);
    for (var b = 0u; b < PART0_BLOCKS; b++) {
        let lanes = vec4<u32>(4u * b) + vec4<u32>(0u, 1u, 2u, 3u);
        let values = select(vec4<f32>(0.0), part0_block(b, x, y), lanes < vec4<u32>(PART0_CHANNELS));
        sum += values;
    }
    return vec4<f32>((sum.x + sum.y + sum.z + sum.w) / f32(PART0_CHANNELS), 0.0, 0.0, 0.0);";

const CHANNEL_MAX: &str = "var largest = vec4<f32>(part0_channel(0u, x, y));
    for (var b = 0u; b < PART0_BLOCKS; b++) {
        let lanes = vec4<u32>(4u * b) + vec4<u32>(0u, 1u, 2u, 3u);
        largest = max(largest, select(largest, part0_block(b, x, y), lanes < vec4<u32>(PART0_CHANNELS)));
    }
    return vec4<f32>(max(max(largest.x, largest.y), max(largest.z, largest.w)), 0.0, 0.0, 0.0);";

/// What a word of an image's buffer is, and how its number `at` is read: `f32` and two halves of a word alike.
fn numbers(format: ImageFormat, at: &str) -> (&'static str, String) {
    let name = PARTS[0];
    match format {
        // Not as f16, which not every device has.
        ImageFormat::HalfPixels => ("u32", format!("unpack2x16float({name}[({at}) / 2u])[({at}) % 2u]")),
        ImageFormat::Pixels | ImageFormat::Blocks => ("f32", format!("{name}[{at}]")),
    }
}

/// The kernel that makes a tensor of shape `result` from an image of shape `image`, blocks of `factor`² pixels becoming
/// channels.
pub fn import(
    image: Shape,
    format: ImageFormat,
    factor: usize,
    result: Shape,
    precision: Precision,
) -> String {
    let (word, number) = numbers(format, "at");
    let channel = format!(
        "let at_x = x * {factor}u + c % {factor}u;
    let at_y = y * {factor}u + c / {factor}u % {factor}u;
    let at = (at_y * IMAGE_WIDTH + at_x) * IMAGE_CHANNELS + c / {square}u;
    return {number};",
        square = factor * factor,
    );
    let mut text =
        source::header(precision) + &source::tensors(&[], result) + &source::sizes("IMAGE_", image);
    text += &format!("@group(0) @binding(2) var<storage> {}: array<{word}>;\n", PARTS[0]);
    text += &by_channel(&channel);
    text + &format!("fn value(block: u32, x: u32, y: u32) -> vec4<f32> {{\n    {BY_CHANNEL}\n}}\n")
        + include_str!("map.wgsl")
}

/// Words of 4 B of an image in its buffer.
pub fn words(image: Shape, format: ImageFormat) -> usize {
    match format {
        ImageFormat::HalfPixels => image.len().div_ceil(2),
        ImageFormat::Pixels | ImageFormat::Blocks => image.len(),
    }
}

/// The kernel that makes an image of shape `image` from a tensor of shape `read`, blocks of `factor`² channels becoming
/// pixels.
pub fn export(read: Shape, factor: usize, image: Shape, format: ImageFormat, precision: Precision) -> String {
    let (word, packed) = match format {
        ImageFormat::HalfPixels => ("u32", "pack2x16float(vec2<f32>(number(at * 2u), number(at * 2u + 1u)))"),
        ImageFormat::Pixels | ImageFormat::Blocks => ("f32", "number(at)"),
    };
    let mut text = source::header(precision) + &source::tensors(&[read], image);
    text = text.replace("result: array<Block>", &format!("result: array<{word}>"));
    text += &format!("const FACTOR: u32 = {factor}u;\nconst WORDS: u32 = {}u;\n", words(image, format));
    text += &format!("fn word(at: u32) -> {word} {{\n    return {packed};\n}}\n");
    text + include_str!("export.wgsl")
}
