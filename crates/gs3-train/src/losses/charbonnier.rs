//! Charbonnier losses: of errors, and of their change from frame to frame.

use std::ops::Range;

use super::Interior;

/// Numbers summed in single precision before they go to a sum in double precision.
pub(super) const LANES: usize = 16;

/// √(e² + ε²) − ε (Charbonnier et al. 1994; less ε, so that it vanishes with e) and its derivative.
#[inline(always)]
pub(super) fn smooth_abs(e: f32, epsilon: f32) -> (f32, f32) {
    let root = (e * e + epsilon * epsilon).sqrt();
    (root - epsilon, e / root)
}

/// The sum of √(e² + ε²) − ε over the interior of error image `e`. Adds `factor` times its derivative to `v`.
pub fn charbonnier(interior: &Interior, e: &[f32], epsilon: f32, factor: f32, v: &mut [f32]) -> f64 {
    let row = |span: Range<usize>| {
        let mut sums = [0.0_f32; LANES];
        let (es, vs) = (e[span.clone()].chunks(LANES), v[span].chunks_mut(LANES));
        for (e, v) in es.zip(vs) {
            for ((e, v), sum) in e.iter().zip(v).zip(&mut sums) {
                let (value, slope) = smooth_abs(*e, epsilon);
                *sum += value;
                *v += factor * slope;
            }
        }
        sums.iter().map(|v| f64::from(*v)).sum::<f64>()
    };
    interior.spans(0).map(row).sum()
}

/// The same of the change from error image `before` to `after`: what flickers costs, what stays does not (the sense of
/// tPSNR).
pub fn change(
    interior: &Interior,
    [before, after]: [&[f32]; 2],
    epsilon: f32,
    factor: f32,
    [v_before, v_after]: [&mut [f32]; 2],
) -> f64 {
    let row = |span: Range<usize>| {
        let mut sums = [0.0_f32; LANES];
        let es = before[span.clone()].chunks(LANES).zip(after[span.clone()].chunks(LANES));
        let vs = v_before[span.clone()].chunks_mut(LANES).zip(v_after[span].chunks_mut(LANES));
        for ((before, after), (v_before, v_after)) in es.zip(vs) {
            let es = before.iter().zip(after);
            for (((before, after), (v_before, v_after)), sum) in
                es.zip(v_before.iter_mut().zip(v_after)).zip(&mut sums)
            {
                let (value, slope) = smooth_abs(after - before, epsilon);
                *sum += value;
                *v_after += factor * slope;
                *v_before -= factor * slope;
            }
        }
        sums.iter().map(|v| f64::from(*v)).sum::<f64>()
    };
    interior.spans(0).map(row).sum()
}
