//! What is done with derivatives besides Adam's step.

use gs3_neural::arrays::Arrays;

/// Share of the average that a step keeps, once it has taken up speed.
const KEPT: f64 = 0.999;

/// Adds `addend` to `sum`, array by array.
pub fn add(sum: &mut Arrays, addend: &Arrays) {
    for (name, sum) in sum {
        if let Some(addend) = addend.get(name) {
            sum.values_mut().iter_mut().zip(addend.values()).for_each(|(sum, v)| *sum += v);
        }
    }
}

/// Multiplies all numbers by `factor`.
pub fn multiply(arrays: &mut Arrays, factor: f32) {
    arrays.values_mut().flat_map(|array| array.values_mut()).for_each(|v| *v *= factor);
}

/// The length of all arrays as one vector.
#[must_use]
pub fn length(arrays: &Arrays) -> f64 {
    let squares = |values: &[f32]| values.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>();
    arrays.values().map(|array| squares(array.values())).sum::<f64>().sqrt()
}

/// Moves `average` towards `weights` after step `step` (counted from 1): a running mean of all at first, later of about
/// the last thousand steps. It is better than any of them: their noise is gone.
pub fn average(average: &mut Arrays, weights: &Arrays, step: u64) {
    // The rule of TensorFlow's ExponentialMovingAverage: the start is forgotten soon.
    let kept = KEPT.min((1 + step) as f64 / (10 + step) as f64);
    mix(average, weights, (1.0 - kept) as f32);
}

/// Moves `arrays` towards `others` by `share` of the way.
pub fn mix(arrays: &mut Arrays, others: &Arrays, share: f32) {
    for (name, array) in arrays {
        if let Some(other) = others.get(name) {
            array.values_mut().iter_mut().zip(other.values()).for_each(|(a, b)| *a += share * (b - *a));
        }
    }
}
