//! Activations of 16 numbers.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16};

use crate::graph::Activation;

/// `activation` of each number; relative error below 1e-6 of the larger of argument and result.
#[inline(always)]
pub fn activate<S: Simd>(simd: S, activation: Activation, x: f32x16<S>) -> f32x16<S> {
    let zero = f32x16::splat(simd, 0.0);
    match activation {
        Activation::Identity => x,
        Activation::Relu => x.max(zero),
        Activation::LeakyRelu { slope } => x.simd_gt(zero).select(x, x * slope),
        Activation::Gelu => x * normal_distribution(simd, x),
        Activation::Silu => x * sigmoid(simd, x),
        Activation::Sigmoid => sigmoid(simd, x),
        Activation::Tanh => (sigmoid(simd, x * 2.0)).mul_add(2.0, f32x16::splat(simd, -1.0)),
    }
}

/// 1 / (1 + e⁻ˣ).
#[inline(always)]
pub fn sigmoid<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    reciprocal(simd, exp(simd, -x) + 1.0)
}

/// 1 / x of numbers from 1 to 2¹²⁶, relative error below 2e-7. The CPU's estimate has an error below 2⁻⁸ on every CPU
/// that has one. Each of two Newton steps squares the error: to 2⁻¹⁶, then to rounding. A division takes as long as
/// the whole rest of [`sigmoid`].
#[inline(always)]
fn reciprocal<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let one = f32x16::splat(simd, 1.0);
    let mut y = x.approximate_recip();
    for _ in 0..2 {
        let error = (-x).mul_add(y, one);
        y = error.mul_add(y, y);
    }
    y
}

/// eˣ, relative error below 3e-7, clamped to e^±87 so that it stays a normal number.
///
/// eˣ = 2ⁿ eʳ with n = round(x / ln 2), |r| ≤ ½ ln 2 + rounding; eʳ by Taylor's series to the 7th power: the rest is
/// below 0.347⁸/8! = 5e-9. ln 2 in two parts (Cody and Waite), the first exact in 9 bits so that n · ln2 is exact.
#[inline(always)]
fn exp<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    let x = x.max(c(-87.0)).min(c(87.0));
    let n = (x * std::f32::consts::LOG2_E + 0.5).floor();
    let r = n.mul_add(c(-0.693_359_375), x);
    let r = n.mul_add(c(2.121_944_4e-4), r);
    let mut y = c(1.0 / 5040.0);
    for factorial in [720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0] {
        y = y.mul_add(r, c(1.0 / factorial));
    }
    let n: i32x16<S> = n.to_int::<i32x16<S>>();
    let bits: i32x16<S> = y.bitcast::<i32x16<S>>() + (n << 23_u32);
    bits.bitcast()
}

/// Φ(x), absolute error below 2e-7: erfc by Abramowitz and Stegun 7.1.26.
#[inline(always)]
pub fn normal_distribution<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = c(1.0) / z.mul_add(c(0.327_591_1), c(1.0));
    let mut y = c(1.061_405_429);
    for a in [-1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592] {
        y = y.mul_add(t, c(a));
    }
    let half_tail = y * t * exp(simd, -(z * z)) * 0.5;
    x.simd_gt(c(0.0)).select(c(1.0) - half_tail, half_tail)
}

/// φ(x) = e^(−x²/2) / √(2π).
#[inline(always)]
pub fn normal_density<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    exp(simd, x * x * -0.5) * (0.5 * std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2)
}
