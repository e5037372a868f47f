//! Systems of equations of sixteen pixels, one in each lane.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::{DATA, FADE, FADE_LIMIT, FARTHEST, LENGTH, NUGGET, PER_NOISE, SAMPLES, TRUSTED, UNTRUSTED};
use crate::cpu::samples::{CHUNK, DX, DY, Sample};

/// The samples around sixteen pixels. If there are too few, samples at the pixel's place with a huge nugget fill the
/// system; they have no weight.
pub(super) struct Around<'a> {
    /// Variances of the samples' first-order predictions, and of the best sample left out.
    pub keys: [[f32; CHUNK]; SAMPLES + 1],
    /// Positions relative to the pixel, in lengths of the covariance.
    pub x: [[f32; CHUNK]; SAMPLES],
    pub y: [[f32; CHUNK]; SAMPLES],
    /// Variances of the samples' first-order predictions at their own places, in pixel⁴.
    pub noise: [[f32; CHUNK]; SAMPLES],
    /// Independent error variances of the data.
    pub nugget: [[f32; CHUNK]; SAMPLES],
    pub samples: [[Option<&'a Sample>; SAMPLES]; CHUNK],
}

/// Three vectors: a row of the three columns of a sample.
pub(super) type Row = [[f32; CHUNK]; 3];

/// Three rows in registers.
pub(super) type Rows<S> = [[f32x16<S>; 3]; 3];

/// Number of rows of all columns.
pub(super) const ROWS: usize = start(SAMPLES);

/// Sixteen systems: lower triangles. For each sample the rows from its own on, plus one more row for the pixel.
pub(super) type Systems = [Row; ROWS];

/// Nugget of a missing sample.
pub(super) const NOTHING: f32 = 1e6;

impl Around<'_> {
    pub const fn new() -> Self {
        Self {
            keys: [[FARTHEST; CHUNK]; SAMPLES + 1],
            x: [[0.0; CHUNK]; SAMPLES],
            y: [[0.0; CHUNK]; SAMPLES],
            noise: [[0.0; CHUNK]; SAMPLES],
            nugget: [[NOTHING; CHUNK]; SAMPLES],
            samples: [[None; SAMPLES]; CHUNK],
        }
    }

    /// Turns positions in pixels into lengths of the covariance.
    #[inline(always)]
    pub fn scale<S: Simd>(&mut self, simd: S) {
        for position in self.x.iter_mut().chain(&mut self.y) {
            (load(simd, position) / LENGTH).store_array(position);
        }
    }

    /// The covariances of the data of samples `i` and `j`: rows are value and derivatives of `i`, columns of `j`.
    /// Derivatives are per length of the covariance.
    #[inline(always)]
    pub fn covariances<S: Simd>(&self, simd: S, i: usize, j: usize) -> Rows<S> {
        let (ux, uy) = (
            load(simd, &self.x[i]) - load(simd, &self.x[j]),
            load(simd, &self.y[i]) - load(simd, &self.y[j]),
        );
        let (q, one) = (covariance(simd, ux, uy), f32x16::splat(simd, 1.0));
        // The image's covariance, plus the covariance of the error that both samples share.
        let grown = load(simd, &self.noise[i]).min(load(simd, &self.noise[j])).mul_add(PER_NOISE, one);
        let q2 = q * q * grown;
        let (qx, qy) = (q2 * ux, q2 * uy);
        let (bend_x, bend_y) = (q * qx * -2.0, q * qy * -2.0);
        let mut own = f32x16::splat(simd, 0.0);
        if i == j {
            let share = load(simd, &self.keys[i]) * (1.0 / load(simd, &self.keys[SAMPLES]));
            own = share * share * FADE / (FADE_LIMIT - share) + load(simd, &self.nugget[i]);
        }
        [
            [q.mul_add(grown, own), qx, qy],
            [-qx, bend_x.mul_add(ux, q2) + own, bend_x * uy],
            [-qy, bend_x * uy, bend_y.mul_add(uy, q2) + own],
        ]
    }

    /// The covariances of the pixels with the data of sample `j`.
    #[inline(always)]
    pub fn covariances_with_pixel<S: Simd>(&self, simd: S, j: usize) -> [f32x16<S>; 3] {
        let (x, y) = (load(simd, &self.x[j]), load(simd, &self.y[j]));
        let q = covariance(simd, x, y);
        let q2 = q * q;
        [q, -q2 * x, -q2 * y]
    }

    /// Changes `pixel`, which has the mean as its RGB, into the prediction from the samples of a lane.
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
fn store<S: Simd>(values: [f32x16<S>; 3], to: &mut Row) {
    for (value, to) in values.iter().zip(to) {
        value.store_array(to);
    }
}

/// Index of the first row of sample `sample`: samples before it have DATA + 1, DATA − 2, … rows.
pub(super) const fn start(sample: usize) -> usize {
    sample * (DATA + 1) - 3 * sample * sample.saturating_sub(1) / 2
}

/// The factored block of a sample's three columns in its own rows: L below the diagonal, and the inverse of D.
#[derive(Clone, Copy)]
struct Factor<S: Simd> {
    below: [f32x16<S>; 3],
    inverses: [f32x16<S>; 3],
}

impl<S: Simd> Factor<S> {
    #[inline(always)]
    fn of([a, b, c]: Rows<S>) -> Self {
        // Only rounding brings a pivot below the nugget.
        let d0 = reciprocal(a[0].max(0.5 * NUGGET));
        let (l10, l20) = (b[0] * d0, c[0] * d0);
        let d1 = reciprocal(b[0].mul_add(-l10, b[1]).max(0.5 * NUGGET));
        let u21 = c[0].mul_add(-l10, c[1]);
        let l21 = u21 * d1;
        let d2 = reciprocal(u21.mul_add(-l21, c[0].mul_add(-l20, c[2])).max(0.5 * NUGGET));
        Self { below: [l10, l20, l21], inverses: [d0, d1, d2] }
    }

    /// A row of LD below the sample's own.
    #[inline(always)]
    fn eliminate(&self, [u0, v1, v2]: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
        let [l10, l20, l21] = self.below;
        let u1 = u0.mul_add(-l10, v1);
        [u0, u1, u1.mul_add(-l21, u0.mul_add(-l20, v2))]
    }
}

/// A row minus the part that earlier columns explain. `of_row` are the row's numbers in an earlier sample's columns.
/// `by` are the rows of the columns' sample there, times −D⁻¹.
#[inline(always)]
fn reduced<S: Simd>(simd: S, left: [f32x16<S>; 3], of_row: &Row, by: &Rows<S>) -> [f32x16<S>; 3] {
    let u = row(simd, of_row);
    let mut sums = left;
    for (sum, by) in sums.iter_mut().zip(by) {
        *sum = u[2].mul_add(by[2], u[1].mul_add(by[1], u[0].mul_add(by[0], *sum)));
    }
    sums
}

/// Solves the systems of `around` by their factors LDLᵀ, and writes LD to `systems`. It goes column by column, and
/// each number goes from its covariance to its final value in registers, because some CPUs store a vector only every
/// other cycle.
#[inline(always)]
pub(super) fn solve<S: Simd>(
    simd: S,
    around: &Around<'_>,
    systems: &mut Systems,
    weights: &mut [[f32; CHUNK]; DATA],
) {
    let zero = f32x16::splat(simd, 0.0);
    let mut factors = [Factor { below: [zero; 3], inverses: [zero; 3] }; SAMPLES];
    // The rows of the sample that is being factored, in the columns before, times −D⁻¹.
    let mut by = [[[zero; 3]; 3]; SAMPLES];
    for j in 0..SAMPLES {
        let (done, rows) = systems.split_at_mut(start(j));
        for (k, by) in by[..j].iter_mut().enumerate() {
            let [d0, d1, d2] = factors[k].inverses;
            let of_sample = &done[start(k) + 3 * (j - k)..][..3];
            for (by, of_sample) in by.iter_mut().zip(of_sample) {
                let [u0, u1, u2] = row(simd, of_sample);
                *by = [u0 * -d0, u1 * -d1, u2 * -d2];
            }
        }
        for i in j..SAMPLES {
            let mut block = around.covariances(simd, i, j);
            for (k, by) in by[..j].iter().enumerate() {
                let of_sample = &done[start(k) + 3 * (i - k)..][..3];
                for (left, of_row) in block.iter_mut().zip(of_sample) {
                    *left = reduced(simd, *left, of_row, by);
                }
            }
            if i == j {
                factors[j] = Factor::of(block);
                continue;
            }
            for (left, to) in block.into_iter().zip(&mut rows[3 * (i - j)..]) {
                store(factors[j].eliminate(left), to);
            }
        }
        let mut last = around.covariances_with_pixel(simd, j);
        for (k, by) in by[..j].iter().enumerate() {
            last = reduced(simd, last, &done[start(k + 1) - 1], by);
        }
        store(factors[j].eliminate(last), &mut rows[start(j + 1) - start(j) - 1]);
    }
    // The last rows are now L⁻¹k. The variance that the data explain is their sum of squares by D⁻¹. From them come
    // L⁻ᵀD⁻¹L⁻¹k.
    let mut explained = zero;
    for (sample, factor) in factors.iter().enumerate() {
        let [d0, d1, d2] = factor.inverses;
        let [u0, u1, u2] = row(simd, &systems[start(sample + 1) - 1]);
        explained = (u0 * u0).mul_add(d0, explained);
        explained = (u1 * u1).mul_add(d1, explained);
        explained = (u2 * u2).mul_add(d2, explained);
    }
    let trust = ((explained - UNTRUSTED) * (1.0 / (TRUSTED - UNTRUSTED))).max(0.0).min(1.0);
    for (sample, factor) in factors.into_iter().enumerate().rev() {
        let Factor { below: [l10, l20, l21], inverses: [d0, d1, d2] } = factor;
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
