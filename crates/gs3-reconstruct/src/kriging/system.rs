//! Systems of equations of sixteen pixels, one in each lane.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::{CERTAIN, DATA, DOUBTFUL, FADE, FARTHEST, LENGTH, NUGGET, SAMPLES};
use crate::samples::{CHUNK, DX, DY, Sample};

/// The samples around sixteen pixels. Where there are too few, others in the pixel's place count for nothing by their noise.
pub(super) struct Around<'a> {
    /// Variances of their first-order predictions, and of the best one left out.
    pub keys: [[f32; CHUNK]; SAMPLES + 1],
    /// Positions relative to the pixel, in lengths of the covariance.
    pub x: [[f32; CHUNK]; SAMPLES],
    pub y: [[f32; CHUNK]; SAMPLES],
    /// Variances of the data.
    pub noise: [[f32; CHUNK]; SAMPLES],
    pub samples: [[Option<&'a Sample>; SAMPLES]; CHUNK],
}

/// Three vectors: a row of the three columns of a sample.
pub(super) type Row = [[f32; CHUNK]; 3];

/// Rows of all columns.
pub(super) const ROWS: usize = start(SAMPLES);

/// Sixteen systems: lower triangles, sample by sample the rows from its own on, and as one row more the pixel's covariances.
pub(super) type Systems = [Row; ROWS];

/// Variance of what is not there.
pub(super) const NOTHING: f32 = 1e6;

impl Around<'_> {
    pub const fn new() -> Self {
        Self {
            keys: [[FARTHEST; CHUNK]; SAMPLES + 1],
            x: [[0.0; CHUNK]; SAMPLES],
            y: [[0.0; CHUNK]; SAMPLES],
            noise: [[NOTHING; CHUNK]; SAMPLES],
            samples: [[None; SAMPLES]; CHUNK],
        }
    }

    /// The covariances of the data with each other and with the pixels. Derivatives are per length of the covariance.
    #[inline(always)]
    pub fn fill_systems<S: Simd>(&self, simd: S, systems: &mut Systems) {
        let one_left_out = 1.0 / load(simd, &self.keys[SAMPLES]);
        for j in 0..SAMPLES {
            let (xj, yj) = (load(simd, &self.x[j]), load(simd, &self.y[j]));
            let rows = &mut systems[start(j)..start(j + 1)];
            for (i, rows) in (j..SAMPLES).zip(rows.as_chunks_mut::<3>().0) {
                let (ux, uy) = (load(simd, &self.x[i]) - xj, load(simd, &self.y[i]) - yj);
                let q = covariance(simd, ux, uy);
                let q2 = q * q;
                let (qx, qy) = (q2 * ux, q2 * uy);
                let (bend_x, bend_y) = (q * qx * -2.0, q * qy * -2.0);
                let mut noise = f32x16::splat(simd, 0.0);
                if i == j {
                    let share = load(simd, &self.keys[i]) * one_left_out;
                    noise = share * share * FADE / (1.0 + 1e-4 - share) + load(simd, &self.noise[i]);
                }
                // Rows: value and derivatives of i; columns: of j.
                let block = [
                    [q + noise, qx, qy],
                    [-qx, bend_x.mul_add(ux, q2) + noise, bend_x * uy],
                    [-qy, bend_x * uy, bend_y.mul_add(uy, q2) + noise],
                ];
                for (value, to) in block.as_flattened().iter().zip(rows.as_flattened_mut()) {
                    value.store_array(to);
                }
            }
            let q = covariance(simd, xj, yj);
            let q2 = q * q;
            if let Some(row) = rows.last_mut() {
                for (value, to) in [q, -q2 * xj, -q2 * yj].iter().zip(row) {
                    value.store_array(to);
                }
            }
        }
    }

    /// Changes `pixel`, whose RGB is the mean, into what the samples of a lane say.
    #[inline(always)]
    pub fn predict(&self, lane: usize, weights: &[[f32; CHUNK]; DATA], pixel: &mut [f32; 4]) {
        let mut sum = [0.0_f32; 3];
        for (sample, weights) in self.samples[lane].iter().zip(weights.as_chunks::<3>().0) {
            let Some(sample) = sample else { continue };
            let [value, along_x, along_y] = [weights[0][lane], weights[1][lane], weights[2][lane]];
            for (c, sum) in sum.iter_mut().enumerate() {
                let slopes = along_x * sample[DX + c] + along_y * sample[DY + c];
                *sum += value * (sample[c] - pixel[c]) + LENGTH * slopes;
            }
        }
        pixel.iter_mut().zip(sum).for_each(|(pixel, sum)| *pixel += sum);
    }
}

/// The covariance of values `ux`, `uy` apart, in its lengths: 1 / (1 + δ²/2), by an estimate and a step of Newton's.
#[inline(always)]
fn covariance<S: Simd>(simd: S, ux: f32x16<S>, uy: f32x16<S>) -> f32x16<S> {
    reciprocal((ux * ux).mul_add(0.5, (uy * uy).mul_add(0.5, f32x16::splat(simd, 1.0))))
}

#[inline(always)]
fn reciprocal<S: Simd>(value: f32x16<S>) -> f32x16<S> {
    let estimate = value.approximate_recip();
    estimate * (2.0 - value * estimate)
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, values: &[f32; CHUNK]) -> f32x16<S> {
    f32x16::load_array_ref(simd, values)
}

#[inline(always)]
fn row<S: Simd>(simd: S, row: &Row) -> [f32x16<S>; 3] {
    [load(simd, &row[0]), load(simd, &row[1]), load(simd, &row[2])]
}

#[inline(always)]
fn scaled<S: Simd>(values: [f32x16<S>; 3], by: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
    [values[0] * by[0], values[1] * by[1], values[2] * by[2]]
}

/// Where the rows of sample `sample` begin: samples before have DATA + 1, DATA − 2, … rows.
pub(super) const fn start(sample: usize) -> usize {
    sample * (DATA + 1) - 3 * sample * sample.saturating_sub(1) / 2
}

/// Solves sixteen symmetric positive definite systems by their factors LDLᵀ, of which LD takes the place of `systems`.
#[inline(always)]
pub(super) fn solve<S: Simd>(simd: S, systems: &mut Systems, weights: &mut [[f32; CHUNK]; DATA]) {
    // Of each sample, what its own three rows come to: below the diagonal of L, and the inverse of D.
    let zero = f32x16::splat(simd, 0.0);
    let mut factors = [([zero; 3], [zero; 3]); SAMPLES];
    for (sample, factor) in factors.iter_mut().enumerate() {
        let (done, mut rest) = systems.split_at_mut(start(sample + 1));
        let rows = &mut done[start(sample)..];
        let (a, b, c) = (row(simd, &rows[0]), row(simd, &rows[1]), row(simd, &rows[2]));
        // Only rounding brings a pivot below the nugget.
        let d0 = reciprocal(a[0].max(0.5 * NUGGET));
        let (l10, l20) = (b[0] * d0, c[0] * d0);
        let d1 = reciprocal(b[0].mul_add(-l10, b[1]).max(0.5 * NUGGET));
        let u21 = c[0].mul_add(-l10, c[1]);
        let l21 = u21 * d1;
        let d2 = reciprocal(u21.mul_add(-l21, c[0].mul_add(-l20, c[2])).max(0.5 * NUGGET));
        *factor = ([l10, l20, l21], [d0, d1, d2]);
        for values in &mut rows[3..] {
            let [u0, v1, v2] = row(simd, values);
            let u1 = u0.mul_add(-l10, v1);
            let u2 = u1.mul_add(-l21, u0.mul_add(-l20, v2));
            u1.store_array(&mut values[1]);
            u2.store_array(&mut values[2]);
        }
        // What is left of the samples after it.
        let mut from = &rows[3..];
        while let [first, second, third, ..] = from {
            let inverses = [-d0, -d1, -d2];
            let by = [
                scaled(row(simd, first), inverses),
                scaled(row(simd, second), inverses),
                scaled(row(simd, third), inverses),
            ];
            let (to, after) = rest.split_at_mut(from.len());
            for (to, from) in to.iter_mut().zip(from) {
                let from = row(simd, from);
                for (to, by) in to.iter_mut().zip(&by) {
                    let sum = from[0].mul_add(by[0], load(simd, to));
                    from[2].mul_add(by[2], from[1].mul_add(by[1], sum)).store_array(to);
                }
            }
            (rest, from) = (after, &from[3..]);
        }
    }
    // The last rows now are L⁻¹k: what the data explain is their sum of squares by D⁻¹, and from them come L⁻ᵀD⁻¹L⁻¹k.
    let mut explained = zero;
    for (sample, (_, [d0, d1, d2])) in factors.iter().enumerate() {
        let [u0, u1, u2] = row(simd, &systems[start(sample + 1) - 1]);
        explained = (u0 * u0).mul_add(*d0, explained);
        explained = (u1 * u1).mul_add(*d1, explained);
        explained = (u2 * u2).mul_add(*d2, explained);
    }
    let trust = ((explained - DOUBTFUL) * (1.0 / (CERTAIN - DOUBTFUL))).max(0.0).min(1.0);
    for (sample, ([l10, l20, l21], [d0, d1, d2])) in factors.into_iter().enumerate().rev() {
        let rows = &systems[start(sample)..start(sample + 1)];
        let Some((last, rows)) = rows.split_last() else { continue };
        let [mut sum_0, mut sum_1, mut sum_2] = row(simd, last);
        for (values, weight) in rows[3..].iter().zip(&weights[3 * sample + 3..]) {
            let weight = -load(simd, weight);
            let values = row(simd, values);
            sum_0 = values[0].mul_add(weight, sum_0);
            sum_1 = values[1].mul_add(weight, sum_1);
            sum_2 = values[2].mul_add(weight, sum_2);
        }
        let w2 = sum_2 * d2;
        let w1 = sum_1 * d1 - l21 * w2;
        let w0 = sum_0 * d0 - l10 * w1 - l20 * w2;
        for (weight, to) in [w0, w1, w2].iter().zip(&mut weights[3 * sample..]) {
            weight.store_array(to);
        }
    }
    for weight in weights {
        (load(simd, weight) * trust).store_array(weight);
    }
}
