//! Derivatives of activations, 16 numbers at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};

use crate::engine::math::{normal_density, normal_distribution, sigmoid};
use crate::graph::Activation;

/// Whether the derivative cannot be computed from the activation's result alone.
pub fn needs_argument(activation: Activation) -> bool {
    match activation {
        Activation::Identity | Activation::Relu | Activation::Sigmoid | Activation::Tanh => false,
        // Signs of argument and result agree, unless the negative side is turned up.
        Activation::LeakyRelu { slope } => slope < 0.0,
        Activation::Gelu | Activation::Silu => true,
    }
}

/// The derivative at argument `x` where the result is `y`; `x` is read only if [`needs_argument`].
#[inline(always)]
pub fn derivative<S: Simd>(simd: S, activation: Activation, x: f32x16<S>, y: f32x16<S>) -> f32x16<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    match activation {
        Activation::Identity => c(1.0),
        Activation::Relu => y.simd_gt(c(0.0)).select(c(1.0), c(0.0)),
        Activation::LeakyRelu { slope } if slope < 0.0 => x.simd_gt(c(0.0)).select(c(1.0), c(slope)),
        Activation::LeakyRelu { slope } => y.simd_gt(c(0.0)).select(c(1.0), c(slope)),
        // (x Φ)' = Φ + x φ.
        Activation::Gelu => x.mul_add(normal_density(simd, x), normal_distribution(simd, x)),
        // (x σ)' = σ + x σ (1 − σ).
        Activation::Silu => {
            let sigmoid = sigmoid(simd, x);
            (x * sigmoid).mul_add(c(1.0) - sigmoid, sigmoid)
        }
        Activation::Sigmoid => y * (c(1.0) - y),
        Activation::Tanh => c(1.0) - y * y,
    }
}
