//! Derivatives of all terms of the loss against finite differences.

use gs3_neural::Random;
use gs3_train::losses::{Interior, Laplacian, Moved, change, charbonnier, square, warp};

const SIZE: [usize; 2] = [9, 12];
const EPSILON: f32 = 0.1;

/// An error image, its fourth channel 0.
fn image(seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed);
    let number = |k: usize| if k % 4 == 3 { 0.0 } else { random.signed() };
    (0..SIZE[0] * SIZE[1] * 4).map(number).collect()
}

/// Compares `v`, the derivative of `f` at `e`, with central differences: `f` is summed in double precision from terms
/// of about 1 in single precision, so differences over 2e-2 are exact to 1e-4.
fn check(e: &[f32], v: &[f32], mut f: impl FnMut(&[f32]) -> f64) {
    const STEP: f32 = 1e-2;
    let mut largest: f64 = 0.0;
    for k in 0..e.len() {
        let mut at = |by: f32| {
            let mut e = e.to_vec();
            e[k] += by;
            f(&e)
        };
        let slope = (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP);
        // The third derivative of Charbonnier's loss is at most 1 / ε² · ½ of the step's square: 5e-3.
        assert!((slope - f64::from(v[k])).abs() < 6e-3 + 1e-3 * slope.abs(), "{k}: {} is not {slope}", v[k]);
        largest = largest.max(slope.abs());
    }
    assert!(largest > 0.5, "nothing was tested: {largest}");
}

fn interior() -> Interior {
    Interior::new(SIZE[0], SIZE[1], 2).unwrap()
}

#[test]
fn charbonnier_has_its_derivative() {
    let (e, mut v) = (image(1), vec![0.0; image(1).len()]);
    charbonnier(&interior(), &e, EPSILON, 1.0, &mut v);
    check(&e, &v, |e| charbonnier(&interior(), e, EPSILON, 0.0, &mut vec![0.0; e.len()]));
}

#[test]
fn change_has_its_derivatives() {
    let (before, after) = (image(2), image(3));
    let (mut v_before, mut v_after) = (vec![0.0; before.len()], vec![0.0; before.len()]);
    change(&interior(), [&before, &after], EPSILON, 1.0, [&mut v_before, &mut v_after]);
    let value = |before: &[f32], after: &[f32]| {
        let [mut a, mut b] = [vec![0.0; before.len()], vec![0.0; before.len()]];
        change(&interior(), [before, after], EPSILON, 0.0, [&mut a, &mut b])
    };
    check(&before, &v_before, |e| value(e, &after));
    check(&after, &v_after, |e| value(&before, e));
}

#[test]
fn laplacian_has_its_derivative() {
    // ∇² is a multiple of ½ plus 4 · 0.1 or minus it: a tenth from 0, where |∇²e| has no derivative, is farther than
    // any step takes it.
    let at = |k: usize, v: f32| match (k % 4, k / 4 % SIZE[1] + k / 4 / SIZE[1]) {
        (3, _) => 0.0,
        (_, place) => (4.0 * v).round() / 2.0 + 0.1 * (place % 2) as f32,
    };
    let e: Vec<f32> = image(4).iter().enumerate().map(|(k, v)| at(k, *v)).collect();
    let mut v = vec![0.0; e.len()];
    Laplacian::default().add(&interior(), &e, 1.0, &mut v);
    check(&e, &v, |e| Laplacian::default().add(&interior(), e, 0.0, &mut vec![0.0; e.len()]));
}

#[test]
fn values_are_those_of_the_formulas() {
    // One error of 0.6 within, one at the border that nothing sees.
    let mut e = vec![0.0; SIZE[0] * SIZE[1] * 4];
    e[(4 * SIZE[1] + 5) * 4 + 1] = 0.6;
    e[(SIZE[1] + 5) * 4] = 100.0;
    let (mut v, none) = (vec![0.0; e.len()], vec![0.0; e.len()]);
    let expected = f64::from((0.6_f32 * 0.6 + EPSILON * EPSILON).sqrt() - EPSILON);
    let close =
        |actual: f64, expected: f64| assert!((actual - expected).abs() < 1e-6, "{actual} is not {expected}");
    close(charbonnier(&interior(), &e, EPSILON, 1.0, &mut v), expected);
    let mut v_before = none.clone();
    close(change(&interior(), [&none, &e], EPSILON, 1.0, [&mut v_before, &mut v]), expected);
    // The pixel itself and its four neighbours; the border's error is a neighbour of the second row, which is seen.
    close(Laplacian::default().add(&interior(), &e, 1.0, &mut v), 8.0 * f64::from(0.6_f32) + 100.0);
    assert_eq!(interior().count(), 3 * 5 * 8);
    assert!(Interior::new(4, 12, 2).is_none(), "no pixel is left");
}

/// LR pixels of 2×2 that come from anywhere near, some from outside, one in four not seen.
fn moved<'a>(motion: &'a mut Vec<f32>, validity: &'a mut Vec<f32>) -> Moved<'a> {
    let mut random = Random::new(5);
    let pixels = SIZE[0].div_ceil(2) * SIZE[1] / 2;
    motion.extend((0..2 * pixels).map(|_| 1.5 * random.signed()));
    validity.extend((0..pixels).map(|k| if k % 4 == 0 { 0.0 } else { 0.5 + 0.5 * random.unit() }));
    Moved { scale: 2, motion, validity }
}

#[test]
fn warp_has_its_derivatives() {
    let (before, now) = (image(6), image(7));
    let (mut motion, mut validity) = (Vec::new(), Vec::new());
    let moved = moved(&mut motion, &mut validity);
    let (mut v_before, mut v_now) = (vec![0.0; now.len()], vec![0.0; now.len()]);
    warp(&interior(), moved, [&before, &now], EPSILON, 1.0, [&mut v_before, &mut v_now]);
    let value = |before: &[f32], now: &[f32]| {
        let [mut a, mut b] = [vec![0.0; now.len()], vec![0.0; now.len()]];
        warp(&interior(), moved, [before, now], EPSILON, 0.0, [&mut a, &mut b])
    };
    check(&before, &v_before, |e| value(e, &now));
    check(&now, &v_now, |e| value(&before, e));
}

/// An error that moves with what it is on costs nothing; where nothing was seen, nothing costs.
#[test]
fn errors_along_the_motion_cost_nothing() {
    let error = |frame: usize| -> Vec<f32> {
        let at = |k: usize| (k % 4 < 3).then(|| ((k / 4 % SIZE[1]) as f32 - 3.0 * frame as f32) * 0.1);
        (0..SIZE[0] * SIZE[1] * 4).map(|k| at(k).unwrap_or(0.0)).collect()
    };
    let pixels = SIZE[0].div_ceil(2) * SIZE[1] / 2;
    // 3 HR pixels to the right a frame.
    let motion: Vec<f32> = [-1.5, 0.0].repeat(pixels);
    let loss = |motion: &[f32], validity: f32| {
        let validity = vec![validity; pixels];
        let moved = Moved { scale: 2, motion, validity: &validity };
        let [mut a, mut b] = [vec![0.0; error(0).len()], vec![0.0; error(0).len()]];
        warp(&interior(), moved, [&error(0), &error(1)], EPSILON, 1.0, [&mut a, &mut b])
    };
    assert!(loss(&motion, 1.0).abs() < 1e-5, "{}", loss(&motion, 1.0));
    assert!(loss(&vec![0.0; 2 * pixels], 1.0) > 1.0);
    assert_eq!(loss(&vec![0.0; 2 * pixels], 0.0), 0.0);
}

#[test]
fn square_has_its_derivative() {
    let alpha: Vec<f32> = image(8).into_iter().step_by(4).collect();
    let mut v = vec![0.0; alpha.len()];
    square(&interior(), &alpha, 1.0, &mut v);
    check(&alpha, &v, |alpha| square(&interior(), alpha, 0.0, &mut vec![0.0; alpha.len()]));
}
