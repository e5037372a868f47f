//! 256 values that stand for many: one-dimensional k-means, weighted.

use rayon::prelude::*;

/// Values of a codebook: codes are bytes.
pub(super) const CODES: usize = 256;

/// Rounds of Lloyd's algorithm; after the good start below more change nothing visible.
const ROUNDS: usize = 16;

/// Bins of the histogram that places the first guess.
const BINS: usize = 4096;

/// Bits of a value that [`Codebook::fit_many`] tells apart.
const KEPT_BITS: u32 = 20;

/// 256 values in ascending order with small weighted squared distance to the values they are made from.
pub(super) struct Codebook(pub(super) [f32; CODES]);

impl Codebook {
    /// Fits to values, which are finite, with weights, which are positive. Up to 256 different values are kept exactly.
    pub(super) fn fit(mut weighted: Vec<(f32, f32)>) -> Self {
        weighted.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let values: Vec<f32> = weighted.iter().map(|(value, _)| *value).collect();
        if values.is_empty() {
            return Self([0.0; CODES]);
        }
        if let Some(exact) = few_values(&values) {
            return Self(exact);
        }
        // Of weights, and of values times weights, before each place.
        let (mut weights, mut sums) = (vec![0.0], vec![0.0]);
        let (mut weight_sum, mut sum) = (0.0, 0.0);
        for (value, weight) in weighted {
            weight_sum += f64::from(weight);
            sum += f64::from(value) * f64::from(weight);
            weights.push(weight_sum);
            sums.push(sum);
        }
        let mut codes = first_guess(&values, &weights);
        for _ in 0..ROUNDS {
            let mut start = 0;
            for i in 0..CODES {
                let end = match codes.get(i + 1) {
                    Some(next) => {
                        let middle = f64::midpoint(f64::from(codes[i]), f64::from(*next));
                        start + values[start..].partition_point(|value| f64::from(*value) < middle)
                    }
                    None => values.len(),
                };
                if weights[end] > weights[start] {
                    codes[i] = ((sums[end] - sums[start]) / (weights[end] - weights[start])) as f32;
                }
                start = end;
            }
            codes.sort_unstable_by(f32::total_cmp);
        }
        Self(codes)
    }

    /// As [`Self::fit`], with 25 MB however many values there are. Values that agree in the first [`KEPT_BITS`] bits, 11 of them
    /// of the mantissa, count as their mean: they differ by at most a 2,048th of themselves, and 256 codes over the range of a
    /// scene's values are farther apart.
    pub(super) fn fit_many(weighted: impl Iterator<Item = (f32, f32)>) -> Self {
        let mut bins = vec![[0.0_f64; 2]; 1 << KEPT_BITS];
        for (value, weight) in weighted {
            let [weights, sum] = &mut bins[(value.to_bits() >> (32 - KEPT_BITS)) as usize];
            *weights += f64::from(weight);
            *sum += f64::from(weight) * f64::from(value);
        }
        let filled = bins.into_iter().filter(|[weight, _]| *weight > 0.0);
        Self::fit(filled.map(|[weight, sum]| ((sum / weight) as f32, weight as f32)).collect())
    }

    /// Index of the nearest value.
    pub(super) fn encode(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|code| *code < value).min(255);
        let below = above.saturating_sub(1);
        let nearest =
            if (value - self.0[below]).abs() <= (self.0[above] - value).abs() { below } else { above };
        nearest as u8
    }
}

/// The different values of a sorted list if they are at most 256, the last repeated.
fn few_values(sorted: &[f32]) -> Option<[f32; CODES]> {
    let mut codes = [*sorted.last()?; CODES];
    let mut used = 0;
    let mut rest = sorted;
    while let Some(&value) = rest.first() {
        *codes.get_mut(used)? = value;
        used += 1;
        rest = &rest[rest.partition_point(|other| *other <= value)..];
    }
    Some(codes)
}

/// Density of codes proportional to the cube root of the density of weight. It minimises the squared distance for
/// many codes (Panter and Dite 1951). `before` has the weight before each of the sorted values; there is at least one
/// value.
fn first_guess(values: &[f32], before: &[f64]) -> [f32; CODES] {
    let (smallest, largest) = (f64::from(values[0]), f64::from(values[values.len() - 1]));
    let edge = |bin: usize| smallest + (largest - smallest) * bin as f64 / BINS as f64;
    let mut weights = vec![0.0; BINS];
    let mut start = 0;
    for (bin, weight) in weights.iter_mut().enumerate() {
        let end = start + values[start..].partition_point(|value| f64::from(*value) <= edge(bin + 1));
        *weight = (before[end] - before[start]).cbrt();
        start = end;
    }
    let total: f64 = weights.iter().sum();
    let mut codes = [largest as f32; CODES];
    let (mut bin, mut passed) = (0, 0.0);
    for (i, code) in codes.iter_mut().enumerate() {
        let wanted = total * (i as f64 + 0.5) / 256.0;
        while bin + 1 < BINS && passed + weights[bin] < wanted {
            passed += weights[bin];
            bin += 1;
        }
        let share = if weights[bin] > 0.0 { ((wanted - passed) / weights[bin]).min(1.0) } else { 0.5 };
        *code = (edge(bin) + (edge(bin + 1) - edge(bin)) * share) as f32;
    }
    codes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_kept_exactly() {
        let values = [3.0, -1.0, 3.0, 0.25, -1.0].map(|value| (value, 1.0));
        for book in [Codebook::fit(values.to_vec()), Codebook::fit_many(values.into_iter())] {
            for value in [3.0, -1.0, 0.25] {
                assert_eq!(book.0[usize::from(book.encode(value))], value);
            }
        }
    }

    #[test]
    fn many_values_come_back_closely_and_outliers_too() {
        // Dense near 0 with two far outliers: evenly spaced codes would be 0.8 apart.
        let mut values: Vec<f32> = (0..100_000).map(|i| (i as f32 / 100_000.0 - 0.5).powi(3) * 8.0).collect();
        values.extend([-100.0, 100.0]);
        let weighted = || values.iter().map(|value| (*value, 1.0));
        for book in [Codebook::fit(weighted().collect()), Codebook::fit_many(weighted())] {
            assert!(book.0.is_sorted());
            let errors = values.iter().map(|value| (value - book.0[usize::from(book.encode(*value))]).abs());
            let worst = errors.fold(0.0, f32::max);
            assert!(worst < 0.1, "worst error {worst}");
        }
    }

    /// Where the weight is, codes are dense.
    #[test]
    fn heavy_values_come_back_closer_than_light_ones() {
        let value = |i: usize| i as f32 / 10_000.0;
        let weighted = (0..10_000).map(|i| (value(i), if i < 1000 { 1.0 } else { 1e-4 }));
        let book = Codebook::fit(weighted.collect());
        let error = |i: usize| (value(i) - book.0[usize::from(book.encode(value(i)))]).abs();
        let worst = |range: std::ops::Range<usize>| range.map(error).fold(0.0, f32::max);
        assert!(worst(0..1000) < 0.3 / 256.0, "{}", worst(0..1000));
        assert!(worst(1000..10_000) > 1.0 / 256.0);
    }
}
