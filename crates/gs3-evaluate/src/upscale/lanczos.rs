//! Lanczos-3 interpolation.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_scene::{GBuffer, Image};
use rayon::prelude::*;

use super::lattice::{LANES, PAD, Padded, Phase, PhaseRow, phases};
use super::{UpscaleError, Upscaler, check_size};

/// Separable Lanczos interpolation with three lobes, six taps per axis, weights normalised to sum 1.
#[derive(Clone, Debug, Default)]
pub struct Lanczos {
    lr: Padded,
}

const LOBES: f64 = 3.0;
const TAPS: usize = 6;

impl Upscaler for Lanczos {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        check_size(lr, scale, out)?;
        self.lr.fill(&lr.color, |v| v);
        let [xs, ys] = lr.jitter.map(|jitter| {
            phases(scale, jitter).into_iter().map(|p| (p, weights(p.fraction))).collect::<Vec<_>>()
        });
        let padded = &self.lr;
        let level = gs3_simd::level();
        let scratch = || (vec![0.0; padded.row(0, 0).len()], PhaseRow::new(scale, padded));
        out.pixels_mut().par_chunks_exact_mut(lr.width() * scale as usize).enumerate().for_each_init(
            scratch,
            |(line, phase_row), (y, row)| {
                let (k, r) = ((y / scale as usize) as isize, y % scale as usize);
                dispatch!(level, simd => upscaled_row(simd, padded, k, &ys[r], &xs, line, phase_row));
                phase_row.interleave(row);
            },
        );
        Ok(())
    }
}

/// Weights of the samples −2 to 3 around a place `fraction` between samples 0 and 1.
fn weights(fraction: f32) -> [f32; TAPS] {
    let lanczos = |x: f64| {
        let px = std::f64::consts::PI * x;
        if x == 0.0 { 1.0 } else { LOBES * px.sin() * (px / LOBES).sin() / (px * px) }
    };
    let raw: [f64; TAPS] = std::array::from_fn(|i| lanczos(f64::from(fraction) + 2.0 - i as f64));
    let sum: f64 = raw.iter().sum();
    raw.map(|w| (w / sum) as f32)
}

/// Filters down into `line`, then across into every phase.
#[inline(always)]
fn upscaled_row<S: Simd>(
    simd: S,
    lr: &Padded,
    k: isize,
    (down, down_weights): &(Phase, [f32; TAPS]),
    xs: &[(Phase, [f32; TAPS])],
    line: &mut [f32],
    out: &mut PhaseRow,
) {
    for c in 0..3 {
        line.fill(0.0);
        for (tap, weight) in down_weights.iter().enumerate() {
            let row = lr.row(c, k + down.offset - 2 + tap as isize);
            for (sum, value) in line.iter_mut().zip(row) {
                *sum += weight * value;
            }
        }
        for (r, (across, weights)) in xs.iter().enumerate() {
            for block in 0..lr.blocks() {
                let start = (PAD + block * LANES).wrapping_add_signed(across.offset - 2);
                let mut sum = f32x16::splat(simd, 0.0);
                for (tap, weight) in weights.iter().enumerate() {
                    let at = start + tap;
                    sum = f32x16::from_slice(simd, &line[at..at + LANES]).mul_add(*weight, sum);
                }
                sum.store_slice(out.block(c, r, block));
            }
        }
    }
}
