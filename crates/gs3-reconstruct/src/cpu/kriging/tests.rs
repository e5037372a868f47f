#![allow(clippy::unwrap_used, reason = "tests")]

use fearless_simd::dispatch;

use super::system::{Around, ROWS, Systems, solve, start};
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
    let ([dx, dy], half) = ([0.9 * slope, 0.6 * slope], 0.5);
    [value, half * value, 1.0 - value, dx, half * dx, -dx, dy, half * dy, -dy]
}

/// Predicts pixels `wanted` of an image of `SIDE`² from `samples`, positions and noises.
fn kriged(samples: &[([f32; 2], f32, Sample)], wanted: &[[usize; 2]], mean: [f32; 4]) -> Vec<[f32; 4]> {
    let mut image = vec![mean; SIDE * SIDE];
    dispatch!(gs3_simd::level(), simd => {
        let mut neighborhoods = Neighborhoods::new(0.0);
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

/// The systems before they are solved.
fn filled(around: &Around<'_>) -> Systems {
    let mut systems = [[[0.0; CHUNK]; 3]; ROWS];
    dispatch!(gs3_simd::level(), simd => {
        for j in 0..SAMPLES {
            let of_samples = (j..SAMPLES).flat_map(|i| around.covariances(simd, i, j));
            let all = of_samples.chain([around.covariances_with_pixel(simd, j)]);
            for (values, to) in all.zip(&mut systems[start(j)..start(j + 1)]) {
                *to = values.map(|value| value.to_array());
            }
        }
    });
    systems
}

#[test]
fn sixteen_systems_are_solved_at_once() {
    let mut around = Around::new();
    let mut random = values(3);
    for k in 0..SAMPLES {
        for lane in 0..CHUNK {
            around.x[k][lane] = 2.0 * random.next().unwrap() - 1.0;
            around.y[k][lane] = 2.0 * random.next().unwrap() - 1.0;
            around.noise[k][lane] = random.next().unwrap();
            around.nugget[k][lane] = NUGGET;
            around.keys[k][lane] = 4.0 * random.next().unwrap();
        }
    }
    let (mut systems, mut weights) = ([[[0.0; CHUNK]; 3]; ROWS], [[0.0; CHUNK]; DATA]);
    dispatch!(gs3_simd::level(), simd => solve(simd, &around, &mut systems, &mut weights));
    let filled = filled(&around);
    let mut trusted = 0;
    for lane in 0..CHUNK {
        let entry = |r: usize, c: usize| {
            let (r, c) = (r.max(c), r.min(c));
            // Within a sample's own block only the lower triangle counts.
            let sample = c / 3;
            f64::from(filled[start(sample) + r - 3 * sample][c % 3][lane])
        };
        // K w is k, but for the trust that all weights were scaled by: the same for all rows.
        let product = |r: usize| (0..DATA).map(|c| entry(r, c) * f64::from(weights[c][lane])).sum::<f64>();
        let strongest = (0..DATA).max_by(|a, b| entry(DATA, *a).abs().total_cmp(&entry(DATA, *b).abs()));
        let trust = product(strongest.unwrap()) / entry(DATA, strongest.unwrap());
        assert!((-1e-3..1.001).contains(&trust), "lane {lane}: {trust}");
        for r in 0..DATA {
            let error = (product(r) - trust * entry(DATA, r)).abs();
            assert!(error < 2e-3, "lane {lane}, row {r}: {error}");
        }
        trusted += usize::from(trust > 0.5);
    }
    assert!(trusted >= CHUNK / 2, "weights of 0 would solve anything: {trusted}");
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
    // They share what the less noisy one errs by.
    (around.noise[0], around.noise[1]) = ([2.0; CHUNK], [0.5; CHUNK]);
    let systems = filled(&around);
    let k = |p: [f32; 2], q: [f32; 2]| {
        let d2 = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
        (1.0 + 0.5 * PER_NOISE) / (1.0 + 0.5 * d2)
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
        let expected = wave(*x as f32, *y as f32);
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

/// What samples of the past differ by counts, even where all of them are wrong by about the same: a single fresh
/// sample tells by how much.
#[test]
fn the_past_may_be_wrong_alike() {
    const WRONG: f32 = 0.1;
    let mut samples = scattered();
    let fresh = 8 * SIDE + 10;
    for (k, (_, noise, sample)) in samples.iter_mut().enumerate() {
        if k != fresh {
            *noise = 0.1;
            sample[..3].iter_mut().for_each(|color| *color += WRONG);
        }
    }
    let (expected, found) = (wave(9.0, 8.0), kriged(&samples, &[[9, 8]], [0.5; 4])[0]);
    // Were errors each sample's own, the many would outweigh the one: 0.042.
    let error = (0..3).fold(0.0_f32, |error, c| error.max((found[c] - expected[c]).abs()));
    assert!(error < 0.25 * WRONG, "{error}");
}

/// However many samples there are, those nearest count, and the order in which they came does not.
#[test]
fn each_sample_counts_once() {
    // Where there are few, a vector of those of one row has some of the next.
    let middle = SIDE as f32 / 2.0;
    let far = |at: &[f32; 2]| (at[0] - middle).hypot(at[1] - middle) > 4.0;
    let all = scattered();
    let near: Vec<_> = all.iter().copied().filter(|(at, ..)| !far(at)).collect();
    let wanted = [[SIDE / 2; 2]];
    let [of_all, of_near] = [&all, &near].map(|samples| kriged(samples, &wanted, [0.3; 4]));
    assert_eq!(of_all, of_near);
}

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
    let expected = wave(8.0, 8.0);
    assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 0.01), "{found:?} {expected:?}");
    crowd.reverse();
    let again = kriged(&crowd, &[[8, 8]], mean)[0];
    assert!((0..3).all(|c| (found[c] - again[c]).abs() < 1e-4), "{found:?} {again:?}");
}
