//! Elementary functions on sixteen lanes.

use fearless_simd::{Simd, f32x16, i32x16, prelude::*};

/// Clamp of exponents: below any exponent that counts, but far enough above the least normal number, 2⁻¹²⁶, that
/// products with opacities are normal as well. CPUs take a hundred cycles and more for each vector with a subnormal
/// number.
const LEAST: f32 = -100.0;

/// 2ˣ for `x ≤ 0` (clamped at [`LEAST`]), relative error below 3e-7.
///
/// x = n + f with |f| ≤ ½. 2ᶠ is the polynomial of degree 5 with the smallest relative error on this interval (Remez:
/// 7.5e-8; the rest is rounding). 2ⁿ comes from the exponent bits.
#[inline(always)]
pub fn exp2<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let x = x.max(f32x16::splat(s, LEAST));
    let n = x.round_ties_even();
    let f = x - n;
    let mut y = f32x16::splat(s, 1.327_647_2e-3);
    y = y.mul_add(f, f32x16::splat(s, 9.675_541e-3));
    y = y.mul_add(f, f32x16::splat(s, 5.550_713e-2));
    y = y.mul_add(f, f32x16::splat(s, 2.402_212e-1));
    y = y.mul_add(f, f32x16::splat(s, 6.931_469_4e-1));
    y = y.mul_add(f, f32x16::splat(s, 1.000_000_1));
    let exponent: i32x16<S> = n.to_int::<i32x16<S>>();
    let bits: i32x16<S> = y.bitcast::<i32x16<S>>() + (exponent << 23_u32);
    bits.bitcast()
}

/// log₂ x for positive normal `x`, absolute error below 2e-7 + 1e-7·|log₂ x|.
///
/// x = 2ᵉ m with m in [√½, √2); log₂ m = 2/ln2 · atanh((m−1)/(m+1)) by its series to the 7th power: with
/// |t| ≤ 0.172 the rest is below 2/ln2 · t⁹/9 = 4e-8.
#[inline(always)]
pub fn log2<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let c = |v: f32| f32x16::splat(s, v);
    let bits: i32x16<S> = x.bitcast();
    // Adding 1 − √½ in the bit pattern moves the split of exponent and mantissa from 1 to √½.
    let offset = bits - i32x16::splat(s, std::f32::consts::FRAC_1_SQRT_2.to_bits() as i32);
    let exponent: i32x16<S> = offset >> 23_u32;
    let m: f32x16<S> = (bits - (exponent << 23_u32)).bitcast();
    let t = (m - c(1.0)) / (m + c(1.0));
    let t2 = t * t;
    let mut y = c(1.0 / 7.0);
    y = y.mul_add(t2, c(1.0 / 5.0));
    y = y.mul_add(t2, c(1.0 / 3.0));
    y = y.mul_add(t2, c(1.0));
    (y * t).mul_add(c(2.0 * std::f32::consts::LOG2_E), exponent.to_float::<f32x16<S>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::dispatch;

    fn apply(f: impl Fn(f64) -> f64, x: [f32; 16], exp: bool) -> Vec<(f64, f64)> {
        let mut out = [0.0f32; 16];
        dispatch!(gs3_simd::level(), s => {
            let v = f32x16::from_slice(s, &x);
            if exp { exp2(s, v) } else { log2(s, v) }.store_slice(&mut out);
        });
        out.iter().zip(x).map(|(o, x)| (f64::from(*o), f(f64::from(x)))).collect()
    }

    #[test]
    fn exp2_is_accurate_on_the_range_of_exponents_that_blending_uses() {
        for k in 0..1000 {
            let x = std::array::from_fn(|i| -((k * 16 + i) as f32) * 0.002);
            for (actual, expected) in apply(f64::exp2, x, true) {
                assert!((actual / expected - 1.0).abs() < 3e-7, "{actual} {expected}");
            }
        }
    }

    #[test]
    fn exp2_far_from_a_splat_is_nothing_and_its_products_are_normal() {
        for x in [-101.0, -126.0, -1e4, f32::NEG_INFINITY] {
            for (actual, _) in apply(f64::exp2, [x; 16], true) {
                assert!(actual < 1e-20, "{x}: {actual}");
                // The least opacity of a splat.
                assert!((actual as f32 * crate::settings::MIN_ALPHA).is_normal(), "{x}: {actual}");
            }
        }
    }

    #[test]
    fn log2_is_accurate_over_many_octaves() {
        for k in 1..1000 {
            let x = std::array::from_fn(|i| (k * 16 + i) as f32 * 0.0137);
            for (actual, expected) in apply(f64::log2, x, false) {
                assert!((actual - expected).abs() < 2e-7 + 1e-7 * expected.abs(), "{actual} {expected}");
            }
        }
    }
}
