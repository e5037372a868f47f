//! Adam: its first steps by hand, its goal, its resumption.

use gs3_neural::arrays::{Array, Arrays};
use gs3_neural::{Adam, WeightError};

fn arrays(values: &[f32]) -> Arrays {
    let array = Array::new("a", &[values.len()], values.to_vec()).expect("as many");
    Arrays::from([("a".to_owned(), array)])
}

/// Derivatives of Σ k (w − 1)².
fn derivatives(weights: &Arrays) -> Arrays {
    let values = weights["a"].values().iter().enumerate();
    arrays(&values.map(|(k, w)| 2.0 * (k + 1) as f32 * (w - 1.0)).collect::<Vec<f32>>())
}

#[test]
fn the_first_steps_are_those_of_the_paper() {
    let mut weights = arrays(&[0.0]);
    let mut adam = Adam::new(&weights);
    // m = 0.1 · 2, s = 0.001 · 4, both divided by the same: 2 / √4.
    adam.step(&mut weights, &arrays(&[2.0]), 0.01).expect("it fits");
    assert!((weights["a"].values()[0] + 0.01).abs() < 1e-8);
    // m = (0.9 · 0.2 − 0.1) / 0.19, s = (0.999 · 0.004 + 0.001) / 0.001999.
    adam.step(&mut weights, &arrays(&[-1.0]), 0.01).expect("it fits");
    let expected = -0.01 - 0.01 * (0.08 / 0.19) / (0.004_996_f64 / 0.001_999).sqrt();
    assert!((f64::from(weights["a"].values()[0]) - expected).abs() < 1e-7);
    assert_eq!(adam.steps(), 2);
}

#[test]
fn a_bowl_has_its_bottom_found() {
    let mut weights = arrays(&[3.0, -2.0, 0.0]);
    let mut adam = Adam::new(&weights);
    for step in 0..2000 {
        let rate = 0.02 * (1.0 - step as f32 / 2000.0);
        let v = derivatives(&weights);
        adam.step(&mut weights, &v, rate).expect("it fits");
    }
    assert!(weights["a"].values().iter().all(|w| (w - 1.0).abs() < 1e-3), "{weights:?}");
}

#[test]
fn training_is_taken_up_again_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("adam.safetensors");
    let mut weights = arrays(&[3.0, -2.0, 0.1]);
    let mut adam = Adam::new(&weights);
    let run = |adam: &mut Adam, weights: &mut Arrays, steps: usize| {
        for _ in 0..steps {
            let v = derivatives(weights);
            adam.step(weights, &v, 1e-2).expect("it fits");
        }
    };
    run(&mut adam, &mut weights, 7);
    adam.save(&path).expect("written");
    let (mut again, mut weights_again) = (Adam::load(&path).expect("read"), weights.clone());
    assert_eq!(again, adam);
    run(&mut adam, &mut weights, 9);
    run(&mut again, &mut weights_again, 9);
    assert_eq!(weights, weights_again);
    assert_eq!(again, adam);
    let start = arrays(&[3.0, -2.0, 0.1]);
    let (mut fresh, mut weights_fresh) = (Adam::new(&start), start);
    run(&mut fresh, &mut weights_fresh, 16);
    assert_eq!(weights_fresh, weights, "an interruption changes nothing");
}

#[test]
fn other_weights_are_refused_and_nothing_moves() {
    let mut weights = arrays(&[1.0, 2.0]);
    let before = weights.clone();
    let mut adam = Adam::new(&weights);
    assert!(matches!(adam.step(&mut weights, &arrays(&[1.0]), 0.1), Err(WeightError::Shape { .. })));
    assert!(matches!(adam.step(&mut weights, &Arrays::new(), 0.1), Err(WeightError::Missing { .. })));
    assert!(matches!(Adam::default().step(&mut weights, &before, 0.1), Err(WeightError::Missing { .. })));
    assert_eq!((weights, adam.steps()), (before, 0));
}
