//! Unit quaternions without their largest component.

/// The quaternion without its component `largest` in the file: the other three and the length of 1 determine it.
/// `others` are those three in order. If rounding made them longer than 1, the missing component is 0.
pub(super) fn with_largest(largest: usize, others: [f32; 3]) -> [f32; 4] {
    let squares: f32 = others.iter().map(|v| v * v).sum();
    let mut quaternion = [(1.0 - squares).max(0.0).sqrt(); 4];
    for (i, other) in others.into_iter().enumerate() {
        quaternion[i + usize::from(i >= largest)] = other;
    }
    quaternion
}

/// The inverse: index of the component with the largest magnitude, and the other three in order, of the same
/// rotation with that component positive. The three lie within ±√½.
pub(super) fn without_largest(quaternion: [f32; 4]) -> (usize, [f32; 3]) {
    let mut largest = 0;
    for i in 1..4 {
        if quaternion[i].abs() > quaternion[largest].abs() {
            largest = i;
        }
    }
    let sign = quaternion[largest].signum();
    (largest, std::array::from_fn(|i| sign * quaternion[i + usize::from(i >= largest)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quaternion_survives_losing_its_largest_component() {
        for q in
            [[0.5, -0.5, 0.5, -0.5_f32], [0.1, 0.7, -0.7, 0.1], [0.0, 0.0, 0.0, -1.0], [0.6, 0.0, -0.8, 0.0]]
        {
            let (largest, others) = without_largest(q);
            let back = with_largest(largest, others);
            let dot: f32 = q.iter().zip(back).map(|(a, b)| a * b).sum();
            assert!((dot.abs() - 1.0).abs() < 1e-6, "{q:?} came back as {back:?}");
        }
    }
}
