//! What the WGSL of all kernels has in common, and how large what they read and write is.

use gs3_compute::{constants, grid_source};

use super::{ImageFormat, Precision};
use crate::graph::{Activation, Shape};

/// Names of what a kernel reads. Its weights and its result are two more storage bindings of the eight that every
/// device has.
pub const PARTS: [&str; 6] = ["part0", "part1", "part2", "part3", "part4", "part5"];

/// Four channels of a pixel, as tensors are stored.
pub const BLOCK: usize = 4;

/// Invocations of a workgroup of all kernels but convolutions.
pub const THREADS: usize = 256;

/// `THREADS`, for all kernels but convolutions, which have their own.
pub fn threads() -> String {
    constants(&[("THREADS", THREADS)])
}

/// Blocks of `shape`.
pub fn blocks(shape: Shape) -> usize {
    shape.channels.div_ceil(BLOCK)
}

/// Types: `real` is what tensors are made of.
pub fn header(precision: Precision) -> String {
    let types = match precision {
        Precision::Single => "alias real = f32;\n",
        Precision::Half => "enable f16;\nalias real = f16;\n",
    };
    format!("{types}alias Block = vec4<real>;\nalias Matrix = mat4x4<real>;\n{}", grid_source())
}

/// The result of a kernel, a tensor: its binding and sizes.
pub fn result(shape: Shape) -> String {
    sizes(shape) + "@group(0) @binding(0) var<storage, read_write> result: array<Block>;\n"
}

/// Constants of what a kernel makes: `WIDTH`, `HEIGHT`, `PIXELS`, `BLOCKS`, `CHANNELS`.
pub fn sizes(shape: Shape) -> String {
    constants(&[
        ("WIDTH", shape.width),
        ("HEIGHT", shape.height),
        ("PIXELS", shape.pixels()),
        ("BLOCKS", blocks(shape)),
        ("CHANNELS", shape.channels),
    ])
}

/// Bytes of a tensor.
pub fn tensor_bytes(shape: Shape, precision: Precision) -> u64 {
    (shape.pixels() * blocks(shape) * BLOCK) as u64 * precision.bytes()
}

/// Words of 4 B of an image in its buffer.
pub fn image_words(image: Shape, format: ImageFormat) -> usize {
    match format {
        ImageFormat::HalfPixels => image.len().div_ceil(2),
        ImageFormat::Pixels | ImageFormat::Blocks => image.len(),
    }
}

/// `fn NAME(x: vec4<f32>) -> vec4<f32>`.
pub fn activate(name: &str, activation: Activation) -> String {
    // tanh of drivers may overflow beyond ±44; beyond ±10 it is ±1 to 4e-9.
    let body = match activation {
        Activation::Identity => "return x;".to_owned(),
        Activation::Relu => "return max(x, vec4<f32>(0.0));".to_owned(),
        Activation::LeakyRelu { slope } => format!("return select({slope:?}f * x, x, x > vec4<f32>(0.0));"),
        Activation::Gelu => GELU.to_owned(),
        Activation::Silu => "return x / (1.0 + exp(-x));".to_owned(),
        Activation::Sigmoid => "return 1.0 / (1.0 + exp(-x));".to_owned(),
        Activation::Tanh => "return tanh(clamp(x, vec4<f32>(-10.0), vec4<f32>(10.0)));".to_owned(),
    };
    format!("fn {name}(x: vec4<f32>) -> vec4<f32> {{\n    {body}\n}}\n")
}

/// x Φ(x) = ½ x (1 + erf(x/√2)), erf to 1.5e-7 (Abramowitz & Stegun 1964, 7.1.26).
const GELU: &str = "let z = abs(x) * 0.70710678;
    let t = 1.0 / (1.0 + 0.3275911 * z);
    let series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    let erf = 1.0 - series * exp(-z * z);
    return 0.5 * x * (1.0 + sign(x) * erf);";
