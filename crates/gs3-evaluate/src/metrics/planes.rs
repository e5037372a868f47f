//! Separable filters on single planes, borders repeated.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_scene::Planes;
use rayon::prelude::*;

/// Correlates every row of `source` with `kernel` (odd length, centred).
pub(super) fn filter_rows(source: &Planes<1>, kernel: &[f32]) -> Planes<1> {
    let (width, height) = (source.width(), source.height());
    let radius = kernel.len() / 2;
    let mut target = Planes::new(width, height);
    let level = gs3_simd::level();
    let padded = || vec![0.0; width.next_multiple_of(16) + 2 * radius];
    target.data_mut().par_chunks_exact_mut(width).enumerate().for_each_init(padded, |padded, (y, out)| {
        let row = source.row(0, y);
        padded[..radius].fill(row[0]);
        padded[radius..radius + width].copy_from_slice(row);
        padded[radius + width..].fill(row[width - 1]);
        let taps = |tap: usize| &padded[tap..];
        dispatch!(level, simd => weighted_sum(simd, taps, kernel, out));
    });
    target
}

/// Correlates every column of `source` with `kernel` (odd length, centred).
pub(super) fn filter_columns(source: &Planes<1>, kernel: &[f32]) -> Planes<1> {
    let (width, height) = (source.width(), source.height());
    let radius = kernel.len() / 2;
    let mut target = Planes::new(width, height);
    let level = gs3_simd::level();
    target.data_mut().par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
        let taps = |tap: usize| source.row(0, (y + tap).saturating_sub(radius).min(height - 1));
        dispatch!(level, simd => weighted_sum(simd, taps, kernel, out));
    });
    target
}

/// `out[x] = Σ kernel[tap] · line(tap)[x]`; lines are at least as long as `out`.
#[inline(always)]
fn weighted_sum<'a, S: Simd>(simd: S, line: impl Fn(usize) -> &'a [f32], kernel: &[f32], out: &mut [f32]) {
    let mut chunks = out.chunks_exact_mut(16);
    let mut at = 0;
    for chunk in &mut chunks {
        let mut sum = f32x16::splat(simd, 0.0);
        for (tap, weight) in kernel.iter().enumerate() {
            sum = f32x16::from_slice(simd, &line(tap)[at..at + 16]).mul_add(*weight, sum);
        }
        sum.store_slice(chunk);
        at += 16;
    }
    for (i, value) in chunks.into_remainder().iter_mut().enumerate() {
        *value = kernel.iter().enumerate().map(|(tap, weight)| weight * line(tap)[at + i]).sum();
    }
}
