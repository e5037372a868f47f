//! Pixels that first-order predictions leave uncertain, by gradient-enhanced kriging.
//!
//! A mean of first-order predictions weighs every sample by its own distance alone: samples that tell the same are counted
//! twice, and where colours change within a pixel or two, gradients carry too far. The best linear prediction of a pixel from
//! the values and the gradients of the samples around it follows from how colours of pixels vary together: kriging
//! (Matheron 1963), with gradients as further data (Morris, Mitchell & Ylvisaker 1993). For data d with covariances K among
//! each other and k with the pixel it is kᵀK⁻¹d, here of what d differs from the mean by.
//!
//! It is a small dense system per pixel, so it is kept for those pixels where the mean errs visibly. Sixteen pixels are
//! solved at once, one in each lane.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::samples::{CHUNK, Sample};

/// Samples that a pixel is predicted from, at most: of those around it the ones whose first-order predictions are best.
/// (Empirical: 6 lose 0.2 to 0.4 dB, 12 gain 0.1; time grows with the third power.)
pub(crate) const SAMPLES: usize = 8;

/// Values and derivatives of a pixel's samples.
const DATA: usize = 3 * SAMPLES;

/// Length of the covariance, pixels: a rational quadratic (Rasmussen & Williams 2006, 4.19) with α = 1,
/// `1 / (1 + δ² / (2 LENGTH²))`, a mixture of Gaussians of all widths as images are of detail. (Empirical: 1 to 2 are alike.)
pub(crate) const LENGTH: f32 = 1.5;

/// Variance of exact data, as a share of the image's: what the covariance does not know of. It also keeps systems well
/// conditioned: a pivot is not below it but by rounding.
pub(crate) const NUGGET: f32 = 1e-3;

/// Variance of a datum, as a share of the image's, per pixel⁴ of the sample's noise. By this covariance second derivatives have
/// the variance 6 / LENGTH⁴, so a first-order prediction at distance δ errs with 1.5 / LENGTH⁴ δ⁴: 0.3 per pixel⁴. Half of it is
/// a little better. (Empirical: 0.05 to 0.5 are alike.)
pub(crate) const PER_NOISE: f32 = 0.15;

/// A pixel is worth it if the correction for curvature changes it by more than this: one and a half steps of 8 bits. (Half as
/// much takes twice as many pixels for 0.1 to 0.2 dB.)
pub(crate) const WORTH: f32 = 0.006;

/// Samples whose first-order predictions have this variance, pixel⁴, or more do not count: that of one two pixels away.
pub(crate) const FARTHEST: f32 = 16.0;

/// Variance, as a share of the image's, that samples gain towards that of the best one left out: as s² / (1 − s), where s is
/// their own as a share of it. So none comes or goes at once.
pub(crate) const FADE: f32 = 0.003;

/// Up to the first share of a pixel's variance that its data explain, the mean stays as it is, and from the second on they are
/// trusted fully: where samples are few, the mean, which knows the current frame's surface as well, is the better one.
pub(crate) const DOUBTFUL: f32 = 0.65;
pub(crate) const CERTAIN: f32 = 0.9;

/// Where samples so near may lie: runs of cells, first and last column and the row, relative to the pixel's.
const CELLS: [([isize; 2], isize); 5] =
    [([-1, 1], -2), ([-2, 2], -1), ([-2, 2], 0), ([-2, 2], 1), ([-1, 1], 2)];

/// No sample.
const NONE: u32 = u32::MAX;

/// A sample in a tile.
#[derive(Clone, Copy, Debug)]
struct Landed<'a> {
    /// Position in the tile's memory, pixel centres at whole numbers.
    at: [f32; 2],
    /// Variance of its first-order prediction where it is, pixel⁴.
    noise: f32,
    /// The pixel that it lies in, in the tile's memory.
    cell: u32,
    sample: &'a Sample,
}

/// The samples of a tile, by the pixels that they lie in, and the pixels that are worth kriging.
#[derive(Debug, Default)]
pub(crate) struct Neighborhoods<'a> {
    /// Pixels from one row to the next.
    stride: usize,
    /// The samples as they came.
    arrived: Vec<Landed<'a>>,
    /// Of each cell, once they are in order, its first sample's place; before, the next cell's number of samples.
    starts: Vec<u32>,
    /// The samples in the order of their cells.
    landed: Vec<Landed<'a>>,
    /// Pixels of the tile's memory, and the places that their colours have in the image.
    pixels: Vec<([u16; 2], usize)>,
}

/// The samples around sixteen pixels. Where there are too few, others in the pixel's place count for nothing by their noise.
struct Around<'a> {
    /// Variances of their first-order predictions, and of the best one left out.
    keys: [[f32; CHUNK]; SAMPLES + 1],
    /// Positions relative to the pixel, in lengths of the covariance.
    x: [[f32; CHUNK]; SAMPLES],
    y: [[f32; CHUNK]; SAMPLES],
    /// Variances of the data.
    noise: [[f32; CHUNK]; SAMPLES],
    samples: [[Option<&'a Sample>; SAMPLES]; CHUNK],
}

/// Three vectors: a row of the three columns of a sample.
type Row = [[f32; CHUNK]; 3];

/// Rows of all columns.
const ROWS: usize = start(SAMPLES);

/// Sixteen systems: lower triangles, sample by sample the rows from its own on, and as one row more the pixel's covariances.
type Systems = [Row; ROWS];

/// Variance of what is not there.
const NOTHING: f32 = 1e6;

impl<'a> Neighborhoods<'a> {
    /// Begins a tile of `rows` rows of memory `stride` pixels apart.
    pub fn begin(&mut self, stride: usize, rows: usize) {
        self.stride = stride;
        self.starts.clear();
        self.starts.resize(stride * rows + 1, 0);
        self.arrived.clear();
        self.pixels.clear();
    }

    /// Takes a sample at `at` in the tile's memory.
    #[inline(always)]
    pub fn take(&mut self, at: [f32; 2], noise: f32, sample: &'a Sample) {
        let (x, y) = ((at[0] + 0.5) as usize, (at[1] + 0.5) as usize);
        let cell = y * self.stride + x;
        if let Some(count) = self.starts.get_mut(cell + 1) {
            *count += 1;
            // Tiles are small.
            self.arrived.push(Landed { at, noise, cell: cell as u32, sample });
        }
    }

    /// Will krige the pixel at `x`, `y` in the tile's memory, whose colour is in `place` of an image.
    #[inline(always)]
    pub fn want(&mut self, [x, y]: [usize; 2], place: usize) {
        // Tiles are small.
        self.pixels.push(([x as u16, y as u16], place));
    }

    /// Puts the samples in the order of their cells.
    fn put_in_order(&mut self) {
        let mut before = 0;
        for start in &mut self.starts {
            // The place of the first sample of the cell before, which becomes that of its end as they take their places.
            before += std::mem::replace(start, before);
        }
        self.landed.clear();
        self.landed.extend_from_slice(&self.arrived);
        for landed in &self.arrived {
            let end = &mut self.starts[landed.cell as usize + 1];
            self.landed[*end as usize] = *landed;
            *end += 1;
        }
    }

    /// Predicts all pixels that are wanted; `image` has what their mean is.
    #[inline(always)]
    pub fn krige<S: Simd>(&mut self, simd: S, image: &mut [[f32; 4]]) {
        if self.pixels.is_empty() {
            return;
        }
        self.put_in_order();
        let (mut candidates, mut around) = (Candidates::new(), Around::new());
        let mut systems = [[[0.0; CHUNK]; 3]; ROWS];
        let mut weights = [[0.0; CHUNK]; DATA];
        for pixels in self.pixels.chunks(CHUNK) {
            let mut most = 0;
            for (lane, (pixel, _)) in pixels.iter().enumerate() {
                most = most.max(self.look_around(*pixel, lane, &mut candidates));
            }
            candidates.least(simd, most, &mut around.keys);
            for (lane, (pixel, _)) in pixels.iter().enumerate() {
                self.choose(lane, *pixel, &candidates, &mut around);
            }
            around.fill_systems(simd, &mut systems);
            solve(simd, &mut systems, &mut weights);
            for (lane, (_, place)) in pixels.iter().enumerate() {
                if let Some(pixel) = image.get_mut(*place) {
                    around.predict(lane, &weights, pixel);
                }
            }
        }
    }

    /// Lists the samples around `pixel` in a lane of `candidates`; how many.
    #[inline(always)]
    fn look_around(&self, pixel: [u16; 2], lane: usize, candidates: &mut Candidates) -> usize {
        let center = [f32::from(pixel[0]), f32::from(pixel[1])];
        let middle = usize::from(pixel[1]) * self.stride + usize::from(pixel[0]);
        let mut count = 0;
        for (columns, row) in CELLS {
            // Beyond the tile's memory there are no samples.
            let first = (middle as isize + row * self.stride as isize + columns[0]) as usize;
            let end = first.wrapping_add((columns[1] - columns[0] + 1) as usize);
            let (Some(first), Some(end)) = (self.starts.get(first), self.starts.get(end)) else { continue };
            for (at, landed) in (*first..).zip(&self.landed[*first as usize..*end as usize]) {
                let (dx, dy) = (landed.at[0] - center[0], landed.at[1] - center[1]);
                let d2 = dx * dx + dy * dy;
                let variance = d2 * d2 + landed.noise;
                if variance < FARTHEST {
                    count = candidates.add(lane, count, variance, at);
                }
            }
        }
        count
    }

    /// Takes the best of the candidates.
    #[inline(always)]
    fn choose(&self, lane: usize, pixel: [u16; 2], candidates: &Candidates, around: &mut Around<'a>) {
        let center = [f32::from(pixel[0]), f32::from(pixel[1])];
        for k in 0..SAMPLES {
            let key = around.keys[k][lane];
            let sample = candidates.samples[lane][key.to_bits() as usize % SEEN];
            let landed = self.landed.get(sample as usize).filter(|_| key < FARTHEST);
            let [dx, dy, noise] = match landed {
                Some(Landed { at: [x, y], noise, .. }) => {
                    [x - center[0], y - center[1], NUGGET + PER_NOISE * noise]
                }
                None => [0.0, 0.0, NOTHING],
            };
            (around.x[k][lane], around.y[k][lane]) = (dx / LENGTH, dy / LENGTH);
            around.noise[k][lane] = noise;
            around.samples[lane][k] = landed.map(|landed| landed.sample);
        }
    }
}

/// Room for the samples around a pixel, but where the camera flees from the scene: a power of two.
const SEEN: usize = 32;

/// The samples around sixteen pixels. A key is the variance of a sample's first-order prediction, whose last bits are its place
/// in the list.
struct Candidates {
    keys: [[f32; CHUNK]; SEEN],
    samples: [[u32; SEEN]; CHUNK],
}

impl Candidates {
    const fn new() -> Self {
        Self { keys: [[FARTHEST; CHUNK]; SEEN], samples: [[NONE; SEEN]; CHUNK] }
    }

    /// Adds a sample to `count` others, in place of the worst if there is no room; how many there are.
    #[inline(always)]
    fn add(&mut self, lane: usize, count: usize, variance: f32, sample: u32) -> usize {
        let mut place = count;
        if count == SEEN {
            let of = |k: usize| self.keys[k][lane];
            place = (1..SEEN).fold(0, |worst, k| if of(k) > of(worst) { k } else { worst });
            if variance >= of(place) {
                return count;
            }
        }
        self.keys[place][lane] = f32::from_bits(variance.to_bits() & !(SEEN as u32 - 1) | place as u32);
        self.samples[lane][place] = sample;
        count.max(place + 1)
    }

    /// The least keys of the first `count`, in order, and forgets all.
    #[inline(always)]
    fn least<S: Simd>(&mut self, simd: S, count: usize, least: &mut [[f32; CHUNK]; SAMPLES + 1]) {
        let none = f32x16::splat(simd, FARTHEST);
        let mut best = [none; SAMPLES + 1];
        for keys in &mut self.keys[..count] {
            let mut key = load(simd, keys);
            none.store_array(keys);
            for best in &mut best {
                let less = best.min(key);
                key = best.max(key);
                *best = less;
            }
        }
        for (best, to) in best.iter().zip(least) {
            best.store_array(to);
        }
    }
}

impl Around<'_> {
    const fn new() -> Self {
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
    fn fill_systems<S: Simd>(&self, simd: S, systems: &mut Systems) {
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
    fn predict(&self, lane: usize, weights: &[[f32; CHUNK]; DATA], pixel: &mut [f32; 4]) {
        let mut sum = [0.0_f32; 3];
        for (sample, weights) in self.samples[lane].iter().zip(weights.as_chunks::<3>().0) {
            let Some(Sample { color, dx, dy }) = sample else { continue };
            let [value, along_x, along_y] = [weights[0][lane], weights[1][lane], weights[2][lane]];
            for (c, sum) in sum.iter_mut().enumerate() {
                *sum += value * (color[c] - pixel[c]) + LENGTH * (along_x * dx[c] + along_y * dy[c]);
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
fn load<S: Simd>(simd: S, values: &[f32; CHUNK]) -> f32x16<S> {
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
const fn start(sample: usize) -> usize {
    sample * (DATA + 1) - 3 * sample * sample.saturating_sub(1) / 2
}

/// Solves sixteen symmetric positive definite systems by their factors LDLᵀ, of which LD takes the place of `systems`.
#[inline(always)]
fn solve<S: Simd>(simd: S, systems: &mut Systems, weights: &mut [[f32; CHUNK]; DATA]) {
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use fearless_simd::{Level, dispatch};

    use super::*;

    /// Deterministic values in [0, 1).
    fn values(seed: u32) -> impl Iterator<Item = f32> {
        let mut state = seed.wrapping_mul(2_654_435_761) | 1;
        std::iter::repeat_with(move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        })
    }

    /// A wave with its gradient, per pixel.
    fn wave(x: f32, y: f32) -> Sample {
        let phase = 0.9 * x + 0.6 * y;
        let (value, slope) = (0.5 + 0.4 * phase.sin(), 0.4 * phase.cos());
        Sample {
            color: [value, 0.5 * value, 1.0 - value, 1.0],
            dx: [0.9 * slope, 0.45 * slope, -0.9 * slope, 0.0],
            dy: [0.6 * slope, 0.3 * slope, -0.6 * slope, 0.0],
        }
    }

    /// Predicts pixels `wanted` of an image of `SIDE`² from `samples`, positions and noises.
    fn kriged(samples: &[([f32; 2], f32, Sample)], wanted: &[[usize; 2]], mean: [f32; 4]) -> Vec<[f32; 4]> {
        let mut image = vec![mean; SIDE * SIDE];
        dispatch!(Level::new(), simd => {
            let mut neighborhoods = Neighborhoods::default();
            neighborhoods.begin(SIDE, SIDE);
            for (at, noise, sample) in samples {
                neighborhoods.take(*at, *noise, sample);
            }
            for [x, y] in wanted {
                neighborhoods.want([*x, *y], y * SIDE + x);
            }
            neighborhoods.krige(simd, &mut image);
        });
        wanted.iter().map(|[x, y]| image[y * SIDE + x]).collect()
    }

    const SIDE: usize = 24;

    /// One sample a pixel, somewhere in it.
    fn scattered() -> Vec<([f32; 2], f32, Sample)> {
        let mut random = values(7);
        let cells = (0..SIDE * SIDE).map(|k| [(k % SIDE) as f32, (k / SIDE) as f32]);
        cells
            .map(|[x, y]| {
                let mut beside = || random.next().unwrap() - 0.5;
                let at = [x + beside(), y + beside()].map(|v: f32| v.max(0.0));
                (at, 0.0, wave(at[0], at[1]))
            })
            .collect()
    }

    #[test]
    fn sixteen_systems_are_solved_at_once() {
        let mut around = Around::new();
        let mut random = values(3);
        for k in 0..SAMPLES {
            for lane in 0..CHUNK {
                around.x[k][lane] = 2.0 * random.next().unwrap() - 1.0;
                around.y[k][lane] = 2.0 * random.next().unwrap() - 1.0;
                around.noise[k][lane] = NUGGET + 0.1 * random.next().unwrap();
                around.keys[k][lane] = 4.0 * random.next().unwrap();
            }
        }
        let (mut systems, mut weights) = ([[[0.0; CHUNK]; 3]; ROWS], [[0.0; CHUNK]; DATA]);
        let mut filled = systems;
        dispatch!(Level::new(), simd => {
            around.fill_systems(simd, &mut systems);
            filled = systems;
            solve(simd, &mut systems, &mut weights);
        });
        for lane in 0..CHUNK {
            let entry = |r: usize, c: usize| {
                let (r, c) = (r.max(c), r.min(c));
                // Within a sample's own block only the lower triangle counts.
                let sample = c / 3;
                f64::from(filled[start(sample) + r - 3 * sample][c % 3][lane])
            };
            // K w is k, but for the trust that all weights were scaled by: the same for all rows.
            let product =
                |r: usize| (0..DATA).map(|c| entry(r, c) * f64::from(weights[c][lane])).sum::<f64>();
            let strongest = (0..DATA).max_by(|a, b| entry(DATA, *a).abs().total_cmp(&entry(DATA, *b).abs()));
            let trust = product(strongest.unwrap()) / entry(DATA, strongest.unwrap());
            assert!((-1e-3..1.001).contains(&trust), "lane {lane}: {trust}");
            for r in 0..DATA {
                let error = (product(r) - trust * entry(DATA, r)).abs();
                assert!(error < 2e-3, "lane {lane}, row {r}: {error}");
            }
        }
    }

    /// The covariances of derivatives are the derivatives of the covariance.
    #[test]
    fn covariances_of_gradients_are_exact() {
        let mut around = Around::new();
        let h = 0.01_f32;
        // Two samples, and the same moved a little either way along x and y.
        let (a, b) = ([0.3_f32, -0.2], [-0.5_f32, 0.45]);
        for k in 0..SAMPLES {
            (around.x[k], around.y[k]) = ([a[0]; CHUNK], [a[1]; CHUNK]);
        }
        (around.x[1], around.y[1]) = ([b[0]; CHUNK], [b[1]; CHUNK]);
        let mut systems = [[[0.0; CHUNK]; 3]; ROWS];
        dispatch!(Level::new(), simd => around.fill_systems(simd, &mut systems));
        let k = |p: [f32; 2], q: [f32; 2]| {
            let d2 = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
            1.0 / (1.0 + 0.5 * d2)
        };
        let along = |p: [f32; 2], axis: usize, by: f32| {
            let mut p = p;
            p[axis] += by;
            p
        };
        // Rows 3 to 5 are the second sample's; columns 0 to 2 the first's.
        for (r, row) in systems[3..6].iter().enumerate() {
            for (c, values) in row.iter().enumerate() {
                let of_b = |q: [f32; 2]| match r {
                    0 => k(b, q),
                    axis => (k(along(b, axis - 1, h), q) - k(along(b, axis - 1, -h), q)) / (2.0 * h),
                };
                let expected = match c {
                    0 => of_b(a),
                    axis => (of_b(along(a, axis - 1, h)) - of_b(along(a, axis - 1, -h))) / (2.0 * h),
                };
                assert!((values[0] - expected).abs() < 5e-3, "{r} {c}: {} {expected}", values[0]);
            }
        }
    }

    #[test]
    fn a_wave_is_found_between_its_samples() {
        let samples = scattered();
        let wanted: Vec<[usize; 2]> = (4..20).flat_map(|y| (4..20).map(move |x| [x, y])).collect();
        let found = kriged(&samples, &wanted, [0.5, 0.25, 0.5, 0.7]);
        let mut worst = 0.0_f32;
        for ([x, y], found) in wanted.iter().zip(&found) {
            let expected = wave(*x as f32, *y as f32).color;
            worst = (0..3).fold(worst, |worst, c| worst.max((found[c] - expected[c]).abs()));
            assert_eq!(found[3], 0.7, "the uncertainty stays");
        }
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn few_or_noisy_samples_leave_the_mean() {
        let mean = [0.3, 0.2, 0.1, 0.5];
        let far = [([8.0 + 1.9, 8.0], 0.0, wave(1.0, 2.0))];
        assert_eq!(kriged(&far, &[[8, 8]], mean), [mean], "one, far away");
        assert_eq!(kriged(&[], &[[8, 8], [0, 0], [23, 23]], mean), [mean; 3]);
        let noisy: Vec<_> = scattered().into_iter().map(|(at, _, sample)| (at, 15.0, sample)).collect();
        assert_eq!(kriged(&noisy, &[[8, 8]], mean), [mean]);
    }

    /// However many samples there are, those nearest count, and the order in which they came does not.
    #[test]
    fn crowds_are_no_matter() {
        let mean = [0.5, 0.25, 0.5, 0.5];
        let mut random = values(11);
        let mut crowd: Vec<([f32; 2], f32, Sample)> = Vec::new();
        for _ in 0..400 {
            let at = [6.5 + 3.0 * random.next().unwrap(), 6.5 + 3.0 * random.next().unwrap()];
            // Beyond half a pixel all are wrong.
            let is_near = (at[0] - 8.0).hypot(at[1] - 8.0) < 0.5;
            crowd.push((at, 0.0, if is_near { wave(at[0], at[1]) } else { Sample::default() }));
        }
        let found = kriged(&crowd, &[[8, 8]], mean)[0];
        let expected = wave(8.0, 8.0).color;
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 0.01), "{found:?} {expected:?}");
        crowd.reverse();
        let again = kriged(&crowd, &[[8, 8]], mean)[0];
        assert!((0..3).all(|c| (found[c] - again[c]).abs() < 1e-4), "{found:?} {again:?}");
    }
}
