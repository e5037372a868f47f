//! SAFMN++ light (Sun et al. 2023, and its entry for the 2024 efficient super-resolution challenges), 32 channels, ×4:
//! spatially-adaptive feature modulation, no biases.

use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use super::activation::gelu;
use super::conv::Conv;
use super::features::Features;
use super::{WeightError, Weights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 32;
/// Channels that are modulated by a coarse version of themselves; the others pass.
const MODULATED: usize = CHANNELS / 2;
const HIDDEN: usize = 48;
const BLOCKS: usize = 2;
const SCALE: u32 = 4;
/// Pixels per side of a coarse pixel, nearly: sides that it does not divide are pooled over windows that overlap.
const COARSE: usize = 8;
const NAME: &str = "safmn";

/// SAFMN++ light.
#[derive(Clone, Debug)]
pub struct Safmn {
    to_feat: Conv,
    blocks: Vec<Block>,
    to_img: Conv,
}

#[derive(Clone, Debug)]
struct Block {
    proj: Conv,
    /// One 3×3 kernel per modulated channel, `[MODULATED, 9]`.
    depthwise: Vec<f32>,
    out: Conv,
    expand: Conv,
    reduce: Conv,
}

impl Safmn {
    /// Takes the published weights, by their published names.
    ///
    /// # Errors
    /// [`WeightError`] if a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightError> {
        let conv = |name: &str, outputs, inputs, side| weights.conv_without_bias(name, outputs, inputs, side);
        let block = |i: usize| {
            let name = |part: &str| format!("feats.{i}.{part}");
            Ok(Block {
                proj: conv(&name("conv1.proj"), CHANNELS, CHANNELS, 3)?,
                depthwise: weights.tensor(&name("conv1.dwconv.weight"), &[MODULATED, 1, 3, 3])?,
                out: conv(&name("conv1.out"), CHANNELS, CHANNELS, 1)?,
                expand: conv(&name("conv2.conv.0"), HIDDEN, CHANNELS, 3)?,
                reduce: conv(&name("conv2.conv.2"), CHANNELS, HIDDEN, 1)?,
            })
        };
        Ok(Self {
            to_feat: conv("to_feat", CHANNELS, 3, 3)?,
            blocks: (0..BLOCKS).map(block).collect::<Result<_, _>>()?,
            to_img: conv("to_img.0", 3 * (SCALE * SCALE) as usize, CHANNELS, 3)?,
        })
    }
}

impl Block {
    fn apply(&self, x: &Features) -> Features {
        let x = self.proj.apply(x);
        let (fine, passing) = (x.part(0, MODULATED), x.part(MODULATED, CHANNELS - MODULATED));
        let wide = enlarged(&convolved(&pooled(&fine), &self.depthwise), x.width, x.height);
        let modulated = wide.combine([&fine], |wide, [fine]| gelu(wide) * fine);
        let mixed = Features::concatenate(&[&passing, &modulated]).combine([], |v, []| gelu(v));
        self.reduce.apply(&self.expand.apply(&self.out.apply(&mixed)).combine([], |v, []| gelu(v)))
    }
}

impl Upscaler for Safmn {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale != SCALE {
            return Err(UpscaleError::Scale { method: NAME, expected: SCALE, actual: scale });
        }
        check_size(lr, scale, out)?;
        let first = self.to_feat.apply(&Features::of_color(lr, 1));
        let mut x = first.clone();
        for block in &self.blocks {
            x = block.apply(&x);
        }
        let x = x.combine([&first], |x, [first]| x + first);
        self.to_img.apply(&x).shuffled(SCALE as usize).write(out);
        Ok(())
    }
}

/// Maxima over `sides / COARSE` (at least 1) windows along each side, `i n / m` rounded down to `(i + 1) n / m` rounded
/// up.
fn pooled(x: &Features) -> Features {
    let [width, height] = [x.width, x.height].map(|side| (side / COARSE).max(1));
    let mut out = Features::new(x.channels, width, height);
    let stride = out.stride;
    let window = |i: usize, from: usize, to: usize| i * from / to..((i + 1) * from).div_ceil(to);
    out.rows_mut().for_each(|(j, row)| {
        for (c, channel) in row.chunks_exact_mut(stride).enumerate() {
            for (i, value) in channel[1..=width].iter_mut().enumerate() {
                let columns = window(i, x.width, width);
                let rows = window(j, x.height, height);
                let of_row = |y: usize| {
                    let row = &x.row(y as isize)[c * x.stride + 1..];
                    row[columns.clone()].iter().copied().fold(f32::NEG_INFINITY, f32::max)
                };
                *value = rows.map(of_row).fold(f32::NEG_INFINITY, f32::max);
            }
        }
    });
    out
}

/// Every channel convolved with its own 3×3 kernel of `kernels` `[channels, 9]`, zeros around.
fn convolved(x: &Features, kernels: &[f32]) -> Features {
    let mut out = Features::new(x.channels, x.width, x.height);
    let stride = out.stride;
    out.rows_mut().for_each(|(y, row)| {
        let rows = [-1, 0, 1].map(|dy| x.row(y as isize + dy));
        for ((c, channel), kernel) in row.chunks_exact_mut(stride).enumerate().zip(kernels.chunks_exact(9)) {
            for (i, value) in channel[1..=x.width].iter_mut().enumerate() {
                let taps = kernel.iter().enumerate();
                *value = taps.map(|(t, weight)| weight * rows[t / 3][c * stride + i + t % 3]).sum();
            }
        }
    });
    out
}

/// Linear interpolation between pixel centres, edges repeated.
fn enlarged(x: &Features, width: usize, height: usize) -> Features {
    let mut out = Features::new(x.channels, width, height);
    let stride = out.stride;
    // The two nearest samples and the weight of the second.
    let place = |i: usize, to: usize, from: usize| {
        let at = ((i as f32 + 0.5) * from as f32 / to as f32 - 0.5).max(0.0);
        let first = (at as usize).min(from - 1);
        (first, (first + 1).min(from - 1), at - first as f32)
    };
    out.rows_mut().for_each(|(y, row)| {
        let (top, bottom, down) = place(y, height, x.height);
        let (top, bottom) = (x.row(top as isize), x.row(bottom as isize));
        for (c, channel) in row.chunks_exact_mut(stride).enumerate() {
            for (i, value) in channel[1..=width].iter_mut().enumerate() {
                let (left, right, across) = place(i, width, x.width);
                let of = |row: &[f32]| {
                    let row = &row[c * x.stride + 1..];
                    row[left] + (row[right] - row[left]) * across
                };
                let (top, bottom) = (of(top), of(bottom));
                *value = top + (bottom - top) * down;
            }
        }
    });
    out
}
