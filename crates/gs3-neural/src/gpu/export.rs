//! Kernels that make images of results.

use super::ImageFormat;
use super::expression::{Expressions, Width};
use super::source::{self, BLOCK, image_words};
use crate::graph::Shape;

/// The kernel of an image of `shape` from the value `name` of `expressions`, and its invocations. `header` is the
/// header of all kernels.
pub fn export(
    header: &str,
    expressions: &Expressions<'_>,
    name: &str,
    shape: Shape,
    format: ImageFormat,
) -> (String, usize) {
    let (element, numbers) = match format {
        ImageFormat::HalfPixels => ("u32", 2),
        ImageFormat::Pixels | ImageFormat::Blocks => ("f32", 1),
    };
    let mut text = header.to_owned() + &source::sizes(shape) + &source::threads();
    text += &format!("@group(0) @binding(0) var<storage, read_write> result: array<{element}>;\n");
    text += &expressions.text;
    let word = |numbers: &[String]| match numbers {
        [low, high] => format!("pack2x16float(vec2<f32>({low}, {high}))"),
        _ => numbers.concat(),
    };
    if shape.channels.is_multiple_of(numbers) {
        text += &value_of(name, Width::Row);
        let rows =
            (0..shape.channels).map(|c| format!("    let row{c} = value({c}u, x, y);\n")).collect::<String>();
        let words = shape.channels / numbers;
        let mut stores = String::new();
        for (pixel, w) in (0..BLOCK).flat_map(|pixel| (0..words).map(move |w| (pixel, w))) {
            let all: Vec<String> = (0..numbers).map(|n| format!("row{}[{pixel}]", w * numbers + n)).collect();
            let store = format!("result[first + {}u] = {};", pixel * words + w, word(&all));
            stores += &format!("    if x + {pixel}u < WIDTH {{ {store} }}\n");
        }
        text += &include_str!("export_rows.wgsl")
            .replace("    ROWS\n", &rows)
            .replace("    STORES\n", &stores)
            .replace("WORDS", &format!("{words}u"));
        return (text, shape.width.div_ceil(BLOCK) * shape.height);
    }
    // Words with numbers of two pixels.
    let words = image_words(shape, format);
    text += &value_of(name, Width::Channel);
    let all: Vec<String> = (0..numbers).map(|n| format!("number(at * {numbers}u + {n}u)")).collect();
    text += &include_str!("export_words.wgsl")
        .replace("WORDS", &format!("{words}u"))
        .replace("WORD", &word(&all));
    (text, words)
}

/// `fn value`, which is the function `name` of what a kernel makes.
pub fn value_of(name: &str, width: Width) -> String {
    let (end, ty) = (width.name(), width.ty());
    format!("fn value(index: u32, x: u32, y: u32) -> {ty} {{\n    return {name}_{end}(index, x, y);\n}}\n")
}
