//! What a kernel computes from what is stored: WGSL functions for each layer that it looks at,
//! `layerK_block(index, x, y) -> vec4<f32>`, four channels of a pixel, `layerK_channel(index, x, y) -> f32`, one, and
//! `layerK_row(index, x, y) -> vec4<f32>`, one channel of the four pixels from x on, x a multiple of
//! four, and those beyond the image any of it. A block of a shuffled image is a row of the image.

use std::fmt::Write;

use super::fuse::{Branch, operands};
use super::source::{self, BLOCK, PARTS, blocks};
use super::{ImageFormat, Precision};
use crate::graph::{Activation, Graph, Op, Shape};

/// Where a tensor is, before buffers are given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// In a buffer of the engine, identified by the first layer with its result there.
    Tensor(usize),
    /// In the buffer of an input.
    Input(usize),
    /// In the buffer of an output.
    Output(usize),
}

/// Where a layer's result is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Located {
    pub place: Place,
    /// Where in the tensor it begins.
    pub first_block: usize,
}

/// A network on its way to kernels.
#[derive(Clone, Debug)]
pub struct Layout<'a> {
    pub graph: &'a Graph,
    pub shapes: Vec<Shape>,
    /// Where the result of each layer is, if it is stored.
    pub located: Vec<Option<Located>>,
    /// Which input each layer is, and its format.
    pub inputs: Vec<Option<(usize, ImageFormat)>>,
    pub precision: Precision,
}

/// The functions of one kernel.
pub struct Expressions<'a> {
    layout: &'a Layout<'a>,
    /// What the kernel reads, in the order of its bindings.
    pub buffers: Vec<Place>,
    /// Bytes that it reads of them.
    pub bytes: u64,
    /// Bindings and functions.
    pub text: String,
    defined: Vec<bool>,
}

/// What a function gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// Four channels.
    Block,
    /// One.
    Channel,
    /// One of four pixels.
    Row,
}

impl Width {
    const ALL: [Self; 3] = [Self::Block, Self::Channel, Self::Row];

    pub fn name(self) -> &'static str {
        match self {
            Self::Block => "block",
            Self::Channel => "channel",
            Self::Row => "row",
        }
    }

    pub fn ty(self) -> &'static str {
        match self {
            Self::Block | Self::Row => "vec4<f32>",
            Self::Channel => "f32",
        }
    }
}

impl<'a> Expressions<'a> {
    pub fn new(layout: &'a Layout<'a>) -> Self {
        let (text, defined) = (MIX_WGSL.to_owned(), vec![false; layout.shapes.len()]);
        Self { layout, buffers: Vec::new(), bytes: 0, text, defined }
    }

    /// Defines the functions of `layer` and gives their name without its end.
    pub fn layer(&mut self, layer: usize) -> String {
        let name = format!("layer{layer}");
        if !std::mem::replace(&mut self.defined[layer], true) {
            let functions = match self.layout.located[layer] {
                Some(located) => self.of_tensor(&name, layer, located),
                None => self.of_result(&name, layer),
            };
            self.text += &functions;
        }
        name
    }

    /// The functions that a kernel for the result of `layer` needs, which it stores itself.
    pub fn made(&mut self, layer: usize) -> String {
        let name = format!("made{layer}");
        let functions = self.of_result(&name, layer);
        self.text += &functions;
        name
    }

    fn of_result(&mut self, name: &str, layer: usize) -> String {
        match self.layout.inputs[layer] {
            Some((input, format)) => self.of_image(name, layer, input, format),
            None => self.of_operation(name, layer),
        }
    }

    /// `fn load(block, x, y) -> Block`: a block of `parts`, one after the other.
    pub fn load(&mut self, parts: &[usize]) {
        let mut text = "fn load(block: u32, x: u32, y: u32) -> Block {\n".to_owned();
        let mut first = 0;
        for (k, part) in parts.iter().enumerate() {
            let (name, end) = (self.layer(*part), first + blocks(self.layout.shapes[*part]));
            // Tensors' own numbers are not made longer and shorter again.
            let read = match self.layout.located[*part] {
                Some(_) => format!("{name}_stored(block - {first}u, x, y)"),
                None => format!("Block({name}_block(block - {first}u, x, y))"),
            };
            text += &match k + 1 == parts.len() {
                true => format!("    return {read};\n"),
                false => format!("    if block < {end}u {{ return {read}; }}\n"),
            };
            first = end;
        }
        self.text += &(text + "}\n");
    }

    /// `fn finish(block, x, y, sum) -> vec4<f32>`: the results of `branches`, which follow each other, from the sums
    /// of their convolutions, all with the same `activation`.
    pub fn finish(&mut self, activation: Activation, branches: &[Branch]) {
        self.text += &source::activate("activate", activation);
        let mut text = "fn finish(block: u32, x: u32, y: u32, sum: vec4<f32>) -> vec4<f32> {\n".to_owned();
        text += "    let value = activate(sum);\n";
        let mut first = 0;
        for (k, branch) in branches.iter().enumerate() {
            let end = first + blocks(self.layout.shapes[branch.conv]);
            let mut steps = format!("let index = block - {first}u;\n");
            let (mut before, mut value) = (branch.conv, "value".to_owned());
            for (number, layer) in branch.then.iter().enumerate() {
                let values: Vec<String> = operands(self.layout.graph, *layer)
                    .map(|operand| match operand == before {
                        true => value.clone(),
                        false => self.value(Width::Block, operand, *layer),
                    })
                    .collect();
                let result = self.elementwise(*layer, Width::Block, &values).unwrap_or_default();
                value = format!("value{k}_{number}");
                steps += &format!("let {value} = {result};\n");
                before = *layer;
            }
            steps += &format!("return {value};\n");
            text += &match k + 1 == branches.len() {
                true => steps,
                false => format!("if block < {end}u {{\n{steps}}}\n"),
            };
            first = end;
        }
        self.text += &(text + "}\n");
    }

    /// The number of `buffer` among what is bound.
    fn bound(&mut self, buffer: Place, element: &str) -> usize {
        if let Some(found) = self.buffers.iter().position(|b| *b == buffer) {
            return found;
        }
        let number = self.buffers.len();
        // Beyond the last name the plan is refused.
        let name = PARTS.get(number).copied().unwrap_or("none");
        // Writing to a string does not fail.
        let _ =
            writeln!(self.text, "@group(0) @binding({}) var<storage> {name}: array<{element}>;", number + 2);
        self.buffers.push(buffer);
        number
    }

    fn of_tensor(&mut self, name: &str, layer: usize, located: Located) -> String {
        let Located { place, first_block } = located;
        let shape = self.layout.shapes[layer];
        let part = format!("part{}", self.bound(place, "Block"));
        self.bytes += source::tensor_bytes(shape, self.layout.precision);
        let at = format!("(index + {first_block}u) * {}u + y * {}u + x", shape.pixels(), shape.width);
        format!("fn {name}_stored(index: u32, x: u32, y: u32) -> Block {{\n    return {part}[{at}];\n}}\n")
            + &function(name, Width::Block, &format!("return vec4<f32>({name}_stored(index, x, y));"))
            + &function(
                name,
                Width::Channel,
                &format!("return f32({name}_stored(index / 4u, x, y)[index % 4u]);"),
            )
            + &by_pixel(name, shape.width)
    }

    fn of_image(&mut self, name: &str, layer: usize, input: usize, format: ImageFormat) -> String {
        let shape = self.layout.shapes[layer];
        // Not as f16, which not every device has.
        let element = if format == ImageFormat::HalfPixels { "u32" } else { "f32" };
        let part = format!("part{}", self.bound(Place::Input(input), element));
        self.bytes += source::image_words(shape, format) as u64 * 4;
        let number = match format {
            ImageFormat::HalfPixels => format!("unpack2x16float({part}[at / 2u])[at % 2u]"),
            ImageFormat::Pixels | ImageFormat::Blocks => format!("{part}[at]"),
        };
        let Shape { width, channels, .. } = shape;
        let channel = format!("return {name}_number((y * {width}u + x) * {channels}u + index);");
        let numbers = |k: usize| format!("{name}_number(at + min({k}u, {}u - x) * {channels}u)", width - 1);
        let row = format!(
            "let at = (y * {width}u + x) * {channels}u + index;\n    return vec4<f32>({});",
            [0, 1, 2, 3].map(numbers).join(", ")
        );
        format!("fn {name}_number(at: u32) -> f32 {{\n    return {number};\n}}\n")
            + &function(name, Width::Channel, &channel)
            + &function(name, Width::Row, &row)
            + &by_channel(name, channels)
    }

    /// The value of `operand` where `reader` has its number: one channel counts for all.
    fn value(&mut self, width: Width, operand: usize, reader: usize) -> String {
        let name = self.layer(operand);
        let is_one = self.layout.shapes[operand].channels == 1 && self.layout.shapes[reader].channels > 1;
        match (is_one, width) {
            (true, Width::Block) => format!("vec4<f32>({name}_channel(0u, x, y))"),
            (true, _) => format!("{name}_{}(0u, x, y)", width.name()),
            (false, _) => format!("{name}_{}(index, x, y)", width.name()),
        }
    }

    /// What `layer` makes of numbers of the same pixel and channel.
    fn elementwise(&mut self, layer: usize, width: Width, values: &[String]) -> Option<String> {
        let text = match (self.layout.graph.layers()[layer].op, values) {
            (Op::Add, [a, b]) => format!("{a} + {b}"),
            (Op::Multiply, [a, b]) => format!("{a} * {b}"),
            (Op::Mix, [a, b, t]) => format!("mix_{}({a}, {b}, {t})", width.name()),
            (Op::Activate(activation), [a]) => {
                let name = format!("activate{layer}_{}", width.name());
                self.text += &source::activate(&name, activation);
                match width {
                    Width::Block | Width::Row => format!("{name}({a})"),
                    Width::Channel => format!("{name}(vec4<f32>({a})).x"),
                }
            }
            _ => return None,
        };
        Some(text)
    }

    /// The functions of what `layer` does.
    fn of_operation(&mut self, name: &str, layer: usize) -> String {
        let op = self.layout.graph.layers()[layer].op;
        let reads: Vec<usize> = operands(self.layout.graph, layer).collect();
        let names: Vec<String> = reads.iter().map(|operand| self.layer(*operand)).collect();
        let shapes: Vec<Shape> = reads.iter().map(|operand| self.layout.shapes[*operand]).collect();
        if matches!(op, Op::Warp) {
            self.neighbours();
        }
        let bodies = Width::ALL.map(|width| {
            let values: Vec<String> =
                reads.iter().map(|operand| self.value(width, *operand, layer)).collect();
            let elementwise = self.elementwise(layer, width, &values);
            elementwise.map(|value| format!("return {value};")).or_else(|| body(op, &names, &shapes, width))
        });
        let [block, channel, row] = bodies;
        let Shape { width, channels, .. } = self.layout.shapes[layer];
        let channel =
            channel.unwrap_or_else(|| format!("return {name}_block(index / 4u, x, y)[index % 4u];"));
        let block =
            block.map_or_else(|| by_channel(name, channels), |body| function(name, Width::Block, &body));
        let row = row.map_or_else(|| by_pixel(name, width), |body| function(name, Width::Row, &body));
        function(name, Width::Channel, &channel) + &block + &row
    }

    fn neighbours(&mut self) {
        if !self.text.contains(NEIGHBOURS_WGSL) {
            self.text += NEIGHBOURS_WGSL;
        }
    }
}

/// a + t (b − a): exactly a where t is 0.
const MIX_WGSL: &str = "fn mix_block(a: vec4<f32>, b: vec4<f32>, t: vec4<f32>) -> vec4<f32> {
    return a + t * (b - a);
}
fn mix_row(a: vec4<f32>, b: vec4<f32>, t: vec4<f32>) -> vec4<f32> {
    return a + t * (b - a);
}
fn mix_channel(a: f32, b: f32, t: f32) -> f32 {
    return a + t * (b - a);
}
";

const NEIGHBOURS_WGSL: &str = include_str!("neighbours.wgsl");

fn function(name: &str, width: Width, body: &str) -> String {
    let (end, ty) = (width.name(), width.ty());
    format!("fn {name}_{end}(index: u32, x: u32, y: u32) -> {ty} {{\n    {body}\n}}\n")
}

/// Four channels, one by one; those beyond the last are 0.
fn by_channel(name: &str, channels: usize) -> String {
    let one = |k: usize| match channels.is_multiple_of(BLOCK) {
        true => format!("{name}_channel(4u * index + {k}u, x, y)"),
        false => format!("{name}_known(4u * index + {k}u, x, y)"),
    };
    let all = (0..BLOCK).map(one).collect::<Vec<_>>().join(", ");
    let known = match channels.is_multiple_of(BLOCK) {
        true => String::new(),
        false => format!(
            "fn {name}_known(index: u32, x: u32, y: u32) -> f32 {{
    if index >= {channels}u {{ return 0.0; }}
    return {name}_channel(index, x, y);
}}\n"
        ),
    };
    known + &function(name, Width::Block, &format!("return vec4<f32>({all});"))
}

/// A channel of four pixels, one by one.
fn by_pixel(name: &str, width: usize) -> String {
    let one = |k: usize| format!("{name}_channel(index, min(x + {k}u, {}u), y)", width - 1);
    function(name, Width::Row, &format!("return vec4<f32>({});", [0, 1, 2, 3].map(one).join(", ")))
}

/// The body of the function of `op`, that is not elementwise, of operands `names`; none where the functions of
/// other widths give it.
fn body(op: Op, names: &[String], shapes: &[Shape], width: Width) -> Option<String> {
    let (first, end) = (names.first()?, width.name());
    let Shape { height, width: columns, channels, .. } = *shapes.first()?;
    let (last_x, last_y) = (columns - 1, height - 1);
    let is_block = width == Width::Block;
    let text = match op {
        Op::ChannelMean | Op::ChannelMax | Op::MaxPool2 | Op::Upsample { .. } | Op::Warp
            if width == Width::Row =>
        {
            return None;
        }
        Op::ChannelMean | Op::ChannelMax if !is_block => return None,
        Op::ChannelMean => format!(
            "var sum = vec4<f32>(0.0);
    for (var b = 0u; b < {blocks}u; b++) {{
        let lanes = vec4<u32>(4u * b) + vec4<u32>(0u, 1u, 2u, 3u);
        sum += select(vec4<f32>(0.0), {first}_block(b, x, y), lanes < vec4<u32>({channels}u));
    }}
    return vec4<f32>((sum.x + sum.y + sum.z + sum.w) / {channels}.0, 0.0, 0.0, 0.0);",
            blocks = channels.div_ceil(BLOCK),
        ),
        Op::ChannelMax => format!(
            "var largest = vec4<f32>({first}_channel(0u, x, y));
    for (var b = 0u; b < {blocks}u; b++) {{
        let lanes = vec4<u32>(4u * b) + vec4<u32>(0u, 1u, 2u, 3u);
        largest = max(largest, select(largest, {first}_block(b, x, y), lanes < vec4<u32>({channels}u)));
    }}
    return vec4<f32>(max(max(largest.x, largest.y), max(largest.z, largest.w)), 0.0, 0.0, 0.0);",
            blocks = channels.div_ceil(BLOCK),
        ),
        Op::MaxPool2 => format!(
            "let right = min(2u * x + 1u, {last_x}u);
    let below = min(2u * y + 1u, {last_y}u);
    let above = max({first}_{end}(index, 2u * x, 2u * y), {first}_{end}(index, right, 2u * y));
    return max(above, max({first}_{end}(index, 2u * x, below), {first}_{end}(index, right, below)));"
        ),
        Op::Upsample { factor } => {
            format!("return {first}_{end}(index, x / {factor}u, y / {factor}u);")
        }
        Op::Warp => {
            let flow = |axis: usize| format!("{}_channel({axis}u, x, y)", names[1]);
            let places = [format!("f32(x) + {}", flow(0)), format!("f32(y) + {}", flow(1))];
            between(first, end, [&places[0], &places[1]], [columns, height])
        }
        Op::Slice { first: from, .. } if is_block && from % BLOCK == 0 => {
            format!("return {first}_block(index + {}u, x, y);", from / BLOCK)
        }
        Op::Slice { first: from, .. } if !is_block => format!("return {first}_{end}(index + {from}u, x, y);"),
        Op::Concat if !is_block || shapes.iter().all(|s| s.channels.is_multiple_of(BLOCK)) => {
            let size = |shape: &Shape| if is_block { blocks(*shape) } else { shape.channels };
            concatenated(names, &shapes.iter().map(size).collect::<Vec<_>>(), end)
        }
        Op::PixelShuffle { factor: f } if width == Width::Row && f % BLOCK == 0 => format!(
            "return {first}_block((index * {square}u + y % {f}u * {f}u + x % {f}u) / 4u, x / {f}u, y / {f}u);",
            square = f * f
        ),
        Op::PixelUnshuffle { factor: f } if is_block && f % BLOCK == 0 => format!(
            "let channel = 4u * index;
    return {first}_row(channel / {square}u, x * {f}u + channel % {f}u, y * {f}u + channel / {f}u % {f}u);",
            square = f * f
        ),
        Op::PixelShuffle { factor: f } if width == Width::Channel => format!(
            "return {first}_channel(index * {square}u + y % {f}u * {f}u + x % {f}u, x / {f}u, y / {f}u);",
            square = f * f
        ),
        Op::PixelUnshuffle { factor: f } if width == Width::Channel => format!(
            "return {first}_channel(index / {square}u, x * {f}u + index % {f}u, y * {f}u + index / {f}u % {f}u);",
            square = f * f
        ),
        _ => return None,
    };
    Some(text)
}

/// Functions `names`, which have `sizes` numbers, one after the other.
fn concatenated(names: &[String], sizes: &[usize], end: &str) -> String {
    let (mut text, mut first) = (String::new(), 0);
    for (k, (name, size)) in names.iter().zip(sizes).enumerate() {
        let read = format!("return {name}_{end}(index - {first}u, x, y);");
        first += size;
        text += &match k + 1 == names.len() {
            true => read,
            false => format!("if index < {first}u {{ {read} }}\n    "),
        };
    }
    text
}

/// `name` at a place between pixels, of `[width, height]` of them.
fn between(name: &str, end: &str, [x, y]: [&str; 2], [width, height]: [usize; 2]) -> String {
    let read = |x: &str, y: &str| format!("{name}_{end}(index, across.{x}, down.{y})");
    let row = |y: &str| format!("mix({}, {}, across.fraction)", read("first", y), read("second", y));
    format!(
        "let across = neighbours({x}, {width}u);
    let down = neighbours({y}, {height}u);
    return mix({}, {}, down.fraction);",
        row("first"),
        row("second")
    )
}
