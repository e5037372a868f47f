//! SPAN (Wan et al. 2024), 28 channels, ×4: swift parameter-free attention.

use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use super::conv::Conv;
use super::features::Features;
use super::{WeightError, Weights};
use crate::upscale::{UpscaleError, Upscaler, check_size};

const CHANNELS: usize = 28;
const SCALE: u32 = 4;
const NAME: &str = "span";
/// Mean of the training images, subtracted before the values are scaled to 0–255.
const MEAN: [f32; 3] = [0.4488, 0.4371, 0.4040];
const RANGE: f32 = 255.0;

/// SPAN with 28 channels.
#[derive(Clone, Debug)]
pub struct Span {
    head: Conv,
    blocks: Vec<[Conv; 3]>,
    tail: Conv,
    fuse: Conv,
    upsample: Conv,
}

impl Span {
    /// Takes the published weights, by their published names.
    ///
    /// # Errors
    /// [`WeightError`] if a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightError> {
        let conv = |name: &str| weights.conv(name, CHANNELS, CHANNELS, 3);
        let block = |i: usize| {
            let part = |c: usize| conv(&format!("block_{i}.c{c}_r.eval_conv"));
            Ok([part(1)?, part(2)?, part(3)?])
        };
        Ok(Self {
            head: weights.conv("conv_1.eval_conv", CHANNELS, 3, 3)?,
            blocks: (1..=6).map(block).collect::<Result<_, _>>()?,
            tail: conv("conv_2.eval_conv")?,
            fuse: weights.conv("conv_cat", CHANNELS, 4 * CHANNELS, 1)?,
            upsample: weights.conv("upsampler.0", 3 * (SCALE * SCALE) as usize, CHANNELS, 3)?,
        })
    }
}

impl Upscaler for Span {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale != SCALE {
            return Err(UpscaleError::Scale { method: NAME, expected: SCALE, actual: scale });
        }
        check_size(lr, scale, out)?;
        let mut color = Features::of_color(lr, 1);
        let (width, stride) = (color.width, color.stride);
        color.rows_mut().for_each(|(_, row)| {
            for (channel, mean) in row.chunks_exact_mut(stride).zip(MEAN) {
                channel[1..=width].iter_mut().for_each(|v| *v = (*v - mean) * RANGE);
            }
        });
        let first = self.head.apply(&color);
        let mut x = first.clone();
        let (mut of_first_block, mut inner) = (None, None);
        for [c1, c2, c3] in &self.blocks {
            let o1 = c1.apply(&x).combine([], |v, []| silu(v));
            let o2 = c2.apply(&o1).combine([], |v, []| silu(v));
            x = c3.apply(&o2).combine([&x], |o3, [x]| (o3 + x) * (sigmoid(o3) - 0.5));
            of_first_block.get_or_insert_with(|| x.clone());
            inner = Some(o1);
        }
        let last = self.tail.apply(&x);
        let (Some(of_first_block), Some(inner)) = (of_first_block, inner) else { return Ok(()) };
        let fused = self.fuse.apply(&Features::concatenate(&[&first, &last, &of_first_block, &inner]));
        self.upsample.apply(&fused).shuffled(SCALE as usize).write(out);
        Ok(())
    }
}

fn sigmoid(v: f32) -> f32 {
    1.0 / (1.0 + (-v).exp())
}

fn silu(v: f32) -> f32 {
    v * sigmoid(v)
}
