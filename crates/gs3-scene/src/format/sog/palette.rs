//! A palette for weighted vectors: the vectors themselves where few of them differ, else tree-structured vector quantisation.
//! Splitting in two again and again takes time proportional to the logarithm of the palette's size, where plain k-means takes its
//! size: a factor of 4,000 for 65,536 rows.

use std::collections::HashMap;

use rayon::prelude::*;

/// Rows that a palette may have: labels are 16 bits.
pub(super) const LARGEST_PALETTE: usize = 1 << 16;

/// Below this many vectors a task does both halves itself.
const PARALLEL_FROM: usize = 4096;

/// Rounds of 2-means after the split along the direction of largest variance.
const ROUNDS: usize = 2;

/// Rows of a palette and, for each vector, which row stands for it.
pub(super) struct Palette {
    /// `[rows, dimensions]`.
    pub(super) rows: Vec<f32>,
    /// `[N]`, in the order of the vectors given.
    pub(super) labels: Vec<u16>,
}

/// Vectors that a palette is for: those with the `indices` among vectors of `stride` values, without the first `offset` of each.
#[derive(Clone, Copy)]
pub(super) struct Vectors<'a> {
    pub(super) values: &'a [f32],
    pub(super) indices: &'a [u32],
    /// How much the error of each counts, positive; in the order of `indices`.
    pub(super) weights: &'a [f32],
    pub(super) stride: usize,
    pub(super) offset: usize,
}

impl Vectors<'_> {
    /// The vector at a place among the indices.
    fn get(&self, place: u32) -> &[f32] {
        let start = self.indices[place as usize] as usize * self.stride;
        &self.values[start + self.offset..start + self.stride]
    }

    fn weight(&self, place: u32) -> f64 {
        f64::from(self.weights[place as usize])
    }
}

impl Palette {
    /// Fits at most [`LARGEST_PALETTE`] rows. Equal vectors share a row, and up to as many different vectors are kept exactly.
    pub(super) fn fit(vectors: Vectors<'_>) -> Self {
        Self::exact(vectors).unwrap_or_else(|| Self::tree(vectors))
    }

    /// A row for each different vector, in the order of their first places; `None` if they are too many.
    fn exact(vectors: Vectors<'_>) -> Option<Self> {
        let mut distinct = Distinct::default();
        let mut rows = Vec::new();
        let mut labels = Vec::with_capacity(vectors.indices.len());
        for place in 0..vectors.indices.len() as u32 {
            let vector = vectors.get(place);
            let known = distinct.len();
            labels.push(distinct.label(vector)?);
            if distinct.len() > known {
                rows.extend_from_slice(vector);
            }
        }
        Some(Self { rows, labels })
    }

    /// At most [`LARGEST_PALETTE`] rows, each the weighted mean of like vectors.
    fn tree(vectors: Vectors<'_>) -> Self {
        let dimensions = vectors.stride - vectors.offset;
        let count = vectors.indices.len();
        let budget = count.min(LARGEST_PALETTE);
        let mut rows = vec![0.0; budget * dimensions];
        let mut places: Vec<u32> = (0..count as u32).collect();
        let mut of_places = vec![0; count];
        let node = Node { members: &mut places, labels: &mut of_places, rows: &mut rows, first_row: 0 };
        node.split(vectors, dimensions);
        let mut labels = vec![0; count];
        for (place, label) in places.iter().zip(of_places) {
            labels[*place as usize] = label;
        }
        Self { rows, labels }
    }

    /// The rows' values, each with the weight of all vectors that the row stands for; `weights` in the order of the labels.
    pub(super) fn weighted_values(&self, weights: &[f32], dimensions: usize) -> Vec<(f32, f32)> {
        let mut of_rows = vec![0.0f32; self.rows.len() / dimensions];
        for (label, weight) in self.labels.iter().zip(weights) {
            of_rows[usize::from(*label)] += weight;
        }
        // A row that stands for none is not read.
        let weight = |i: usize| of_rows[i / dimensions].max(f32::MIN_POSITIVE);
        self.rows.iter().enumerate().map(|(i, value)| (*value, weight(i))).collect()
    }
}

/// Different vectors, by their bits, and their places in a palette.
#[derive(Default)]
pub(super) struct Distinct<'a>(HashMap<&'a [u8], u16>);

impl<'a> Distinct<'a> {
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// The place of `vector`, which gets the next one if it is new; `None` if a palette is full.
    pub(super) fn label(&mut self, vector: &'a [f32]) -> Option<u16> {
        let bits = bytemuck::cast_slice(vector);
        if let Some(label) = self.0.get(bits) {
            return Some(*label);
        }
        let next = u16::try_from(self.0.len()).ok()?;
        self.0.insert(bits, next);
        Some(next)
    }
}

/// Vectors that share a part of the palette.
struct Node<'a> {
    members: &'a mut [u32],
    /// Of the members, in their order.
    labels: &'a mut [u16],
    rows: &'a mut [f32],
    first_row: usize,
}

impl Node<'_> {
    fn split(self, vectors: Vectors<'_>, dimensions: usize) {
        let Self { members, labels, rows, first_row } = self;
        let budget = rows.len() / dimensions;
        let Statistics { mean, variance, .. } = Statistics::of(vectors, dimensions, members);
        let halves = if budget > 1 { bisect(vectors, members, &mean, &variance) } else { None };
        let Some(middle) = halves else {
            rows[..dimensions].iter_mut().zip(&mean).for_each(|(row, mean)| *row = *mean as f32);
            labels.fill(first_row as u16);
            return;
        };
        let (left, right) = members.split_at_mut(middle);
        // Rows where the error is: the best allocation for many dimensions is in proportion to the squared
        // error.
        let error = |members: &[u32]| Statistics::of(vectors, dimensions, members).squared_error();
        let (left_error, right_error) = (error(left), error(right));
        let share = left_error / (left_error + right_error).max(f64::MIN_POSITIVE);
        let least = budget.saturating_sub(right.len()).max(1);
        let most = left.len().min(budget - 1).max(least);
        let left_budget = ((budget as f64 * share).round() as usize).clamp(least, most);
        let (left_labels, right_labels) = labels.split_at_mut(middle);
        let (left_rows, right_rows) = rows.split_at_mut(left_budget * dimensions);
        let parallel = left.len() + right.len() > PARALLEL_FROM;
        let left = Node { members: left, labels: left_labels, rows: left_rows, first_row };
        let right = Node {
            members: right,
            labels: right_labels,
            rows: right_rows,
            first_row: first_row + left_budget,
        };
        if parallel {
            rayon::join(|| left.split(vectors, dimensions), || right.split(vectors, dimensions));
        } else {
            left.split(vectors, dimensions);
            right.split(vectors, dimensions);
        }
    }
}

/// Weighted mean and variance of each dimension.
struct Statistics {
    mean: Vec<f64>,
    variance: Vec<f64>,
    /// Of all members.
    weight: f64,
}

impl Statistics {
    /// Large sets are summed in fixed blocks, so that the result is the same with any number of threads.
    fn of(vectors: Vectors<'_>, dimensions: usize, members: &[u32]) -> Self {
        let blocks: Vec<Vec<f64>> = members
            .par_chunks(PARALLEL_FROM)
            .map(|block| {
                let mut sums = vec![0.0; 2 * dimensions + 1];
                for member in block {
                    let weight = vectors.weight(*member);
                    let (first, rest) = sums.split_at_mut(dimensions);
                    for ((a, b), value) in first.iter_mut().zip(&mut *rest).zip(vectors.get(*member)) {
                        let weighted = weight * f64::from(*value);
                        *a += weighted;
                        *b += weighted * f64::from(*value);
                    }
                    rest[dimensions] += weight;
                }
                sums
            })
            .collect();
        let total = |k: usize| blocks.iter().map(|block| block[k]).sum::<f64>();
        let weight = total(2 * dimensions).max(f64::MIN_POSITIVE);
        let sum = |k: usize| total(k) / weight;
        let mean: Vec<f64> = (0..dimensions).map(sum).collect();
        let variance = (0..dimensions).map(|k| (sum(dimensions + k) - mean[k] * mean[k]).max(0.0)).collect();
        Self { mean, variance, weight }
    }

    fn squared_error(&self) -> f64 {
        self.variance.iter().sum::<f64>() * self.weight
    }
}

/// Reorders `members` so that two compact halves follow one another and gives the length of the first; `None`
/// if they are all the same.
fn bisect(vectors: Vectors<'_>, members: &mut [u32], mean: &[f64], variance: &[f64]) -> Option<usize> {
    let dimensions = mean.len();
    let widest = (0..dimensions).max_by(|a, b| variance[*a].total_cmp(&variance[*b]))?;
    // A column of the covariance matrix: one step of the power iteration towards the direction of largest
    // variance.
    let mut direction = vec![0.0f64; dimensions];
    for member in members.iter() {
        let vector = vectors.get(*member);
        let weight = vectors.weight(*member);
        let along = weight * (f64::from(vector[widest]) - mean[widest]);
        for k in 0..dimensions {
            direction[k] += along * (f64::from(vector[k]) - mean[k]);
        }
    }
    let mut normal: Vec<f32> = direction.iter().map(|v| *v as f32).collect();
    let mut threshold = direction.iter().zip(mean).map(|(d, m)| d * m).sum::<f64>() as f32;
    let mut middle = partition(vectors, members, &normal, threshold)?;
    for _ in 0..ROUNDS {
        let left = Statistics::of(vectors, dimensions, &members[..middle]).mean;
        let right = Statistics::of(vectors, dimensions, &members[middle..]).mean;
        // The plane half way between the two means.
        normal = left.iter().zip(&right).map(|(l, r)| (r - l) as f32).collect();
        threshold = left.iter().zip(&right).map(|(l, r)| (r - l) * f64::midpoint(*l, *r)).sum::<f64>() as f32;
        match partition(vectors, members, &normal, threshold) {
            Some(moved) => middle = moved,
            None => break,
        }
    }
    // A break above leaves the order of the members on one side of a plane: any cut of it will do.
    Some(middle)
}

/// Moves members below the plane to the front, keeping the order within both sides; `None`, and nothing
/// moved, if a side is empty.
fn partition(vectors: Vectors<'_>, members: &mut [u32], normal: &[f32], threshold: f32) -> Option<usize> {
    let below: Vec<bool> = members
        .par_iter()
        .with_min_len(PARALLEL_FROM)
        .map(|member| {
            let along: f32 = vectors.get(*member).iter().zip(normal).map(|(v, n)| v * n).sum();
            along < threshold
        })
        .collect();
    let middle = below.iter().filter(|below| **below).count();
    if middle == 0 || middle == members.len() {
        return None;
    }
    let side = |wanted: bool| members.iter().zip(&below).filter(move |(_, below)| **below == wanted);
    let ordered: Vec<u32> = side(true).chain(side(false)).map(|(member, _)| *member).collect();
    members.copy_from_slice(&ordered);
    Some(middle)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors of one dimension with weight 1.
    fn plain<'a>(values: &'a [f32], indices: &'a [u32], weights: &'a [f32]) -> Vectors<'a> {
        Vectors { values, indices, weights, stride: 1, offset: 0 }
    }

    #[test]
    fn as_many_vectors_as_a_palette_has_rows_are_kept_exactly() {
        // Each twice, and then one more.
        let count = 2 * LARGEST_PALETTE;
        let mut values: Vec<f32> = (0..count).map(|i| (i % LARGEST_PALETTE) as f32 * 0.1).collect();
        values.push(-1.0);
        let (indices, weights) = ((0..values.len() as u32).collect::<Vec<_>>(), vec![1.0; values.len()]);
        let vectors = plain(&values, &indices[..count], &weights[..count]);
        let palette = Palette::fit(vectors);
        assert_eq!(palette.rows.len(), LARGEST_PALETTE);
        assert!((0..count).all(|i| palette.rows[usize::from(palette.labels[i])] == values[i]));
        assert!(Palette::exact(plain(&values, &indices, &weights)).is_none());
    }

    #[test]
    fn different_vectors_get_rows_of_their_own_while_there_are_enough() {
        let values: Vec<f32> =
            (0..300).flat_map(|i| [f32::NAN, (i % 100) as f32, (i % 7) as f32 * 0.5]).collect();
        // Of these, the later two thirds in the opposite order.
        let chosen: Vec<u32> = (100..300).rev().collect();
        let vectors =
            Vectors { values: &values, indices: &chosen, weights: &[1.0; 200], stride: 3, offset: 1 };
        let palette = Palette::fit(vectors);
        assert_eq!(palette.labels.len(), 200);
        for (i, label) in chosen.iter().zip(&palette.labels) {
            let row = &palette.rows[usize::from(*label) * 2..][..2];
            assert!((row[0] - (i % 100) as f32).abs() < 1e-3, "vector {i} is {row:?}");
            assert!((row[1] - (i % 7) as f32 * 0.5).abs() < 1e-3, "vector {i} is {row:?}");
        }
    }
}
