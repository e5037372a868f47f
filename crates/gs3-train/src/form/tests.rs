use gs3_neural::Header;

use super::*;

/// The graph of `peer` and random weights in the form that it is trained in, biases included.
fn trained(peer: PublishedNetwork) -> (Graph, Form, Weights) {
    let subject = TrainedNetwork::Published(peer);
    let graph = subject.graph(2).unwrap_or_else(|e| panic!("{e}"));
    let form = Form::new(subject, &graph);
    let mut weights = form.initial(&graph, Weights::random(&graph, Header::of(&graph, 2), 1), 1);
    let mut random = Random::new(2);
    for (name, array) in &mut weights.arrays {
        if name.ends_with(".bias") || name.ends_with(".scale") {
            array.values_mut().fill_with(|| random.signed());
        }
    }
    form.check(&graph, &weights).unwrap_or_else(|e| panic!("{e}"));
    (graph, form, weights)
}

/// One pixel of `conv`; `at` gives channel i of the input pixel at tap t.
fn convolved(weight: &[f32], bias: f32, inputs: usize, at: impl Fn(usize, usize) -> f32) -> f32 {
    let taps = weight.len() / inputs;
    bias + (0..weight.len()).map(|k| weight[k] * at(k / taps, k % taps)).sum::<f32>()
}

#[test]
fn blocks_fold_to_the_convolution_that_they_are() {
    for (peer, layer, inputs, outputs) in
        [(PublishedNetwork::Ecbsr, "backbone.0", 3, 16), (PublishedNetwork::Rt4ksr, "tail.conv", 24, 24)]
    {
        let (graph, form, weights) = trained(peer);
        let folded = form.fold(&weights);
        folded.check(&graph).unwrap_or_else(|e| panic!("{e}"));
        let mut random = Random::new(3);
        let image: Vec<f32> = (0..inputs * TAPS).map(|_| random.signed()).collect();
        let at = |i: usize, t: usize| image[i * TAPS + t];
        let part = |name: &str| values(&weights.arrays, &format!("{layer}.{name}"));
        // Every branch as published, step by step, in the middle of the window.
        let one = |name: &str, o: usize, n: usize, t: usize, at: &dyn Fn(usize, usize) -> f32| {
            let bias = part(&format!("{name}.bias"))[o];
            convolved(&part(&format!("{name}.weight"))[o * n..][..n], bias, n, |i, _| at(i, t))
        };
        let three = |name: &str, o: usize, n: usize, at: &dyn Fn(usize, usize) -> f32| {
            let bias = part(&format!("{name}.bias"))[o];
            convolved(&part(&format!("{name}.weight"))[o * n * TAPS..][..n * TAPS], bias, n, at)
        };
        let m = WIDER * outputs;
        let wide = |c: usize, t: usize| one("expand", c, inputs, t, &at);
        for o in 0..outputs {
            let expected = match peer {
                PublishedNetwork::Ecbsr => {
                    let edge = |(name, mask): (&str, [f32; TAPS])| {
                        let first = |t: usize| {
                            let row = &part(&format!("{name}.weight"))[o * inputs..][..inputs];
                            (0..inputs).map(|i| row[i] * at(i, t)).sum::<f32>()
                        };
                        let sum: f32 = (0..TAPS).map(|t| mask[t] * first(t)).sum();
                        part(&format!("{name}.scale"))[o] * sum + part(&format!("{name}.bias"))[o]
                    };
                    three("conv", o, inputs, &at)
                        + three("squeeze", o, m, &wide)
                        + EDGES.into_iter().map(edge).sum::<f32>()
                }
                _ => {
                    let middle = |c: usize, _: usize| three("middle", c, m, &wide) + wide(c, TAPS / 2);
                    one("reduce", o, m, 0, &middle) + at(o, TAPS / 2)
                }
            };
            let weight =
                &values(&folded.arrays, &format!("{layer}.weight"))[o * inputs * TAPS..][..inputs * TAPS];
            let actual = convolved(weight, values(&folded.arrays, &format!("{layer}.bias"))[o], inputs, at);
            assert!(
                (actual - expected).abs() < 1e-4 * expected.abs().max(1.0),
                "{peer:?} {o}: {actual}, {expected}"
            );
        }
    }
}

#[test]
fn derivatives_go_back_through_the_fold() {
    for peer in [PublishedNetwork::Ecbsr, PublishedNetwork::Rt4ksr, PublishedNetwork::Ninasr] {
        let (graph, form, mut weights) = trained(peer);
        let mut random = Random::new(4);
        let factors: Arrays = graph
            .parameters()
            .into_iter()
            .map(|p| {
                let values = (0..p.shape.iter().product()).map(|_| random.signed()).collect();
                (p.name.clone(), Array::new(&p.name, &p.shape, values).unwrap_or_default())
            })
            .collect();
        let loss = |weights: &Weights| -> f64 {
            let arrays = form.fold(weights).arrays;
            assert_eq!(arrays.len(), factors.len());
            let dot = |(name, f): (&String, &Array)| -> f64 {
                values(&arrays, name).iter().zip(f.values()).map(|(w, f)| f64::from(w * f)).sum()
            };
            factors.iter().map(dot).sum()
        };
        let v = form.pull_back(&weights, factors.clone());
        assert!(v.keys().eq(weights.arrays.keys()), "{peer:?}");
        // Shares of the loss are products of at most three weights, and linear in each of them: large steps do no
        // harm.
        let step = 0.25;
        let names: Vec<String> = weights.arrays.keys().cloned().collect();
        for name in names {
            for _ in 0..2 {
                let k = (random.next_bits() % values(&weights.arrays, &name).len() as u64) as usize;
                let mut moved = |by: f32| {
                    if let Some(array) = weights.arrays.get_mut(&name) {
                        array.values_mut()[k] += by;
                    }
                    loss(&weights)
                };
                let slope = (moved(step) - moved(-2.0 * step)) / f64::from(2.0 * step);
                moved(step);
                let actual = f64::from(values(&v, &name)[k]);
                assert!(
                    (actual - slope).abs() < 1e-2 * slope.abs().max(1.0),
                    "{peer:?} {name} {k}: {actual}, {slope}"
                );
            }
        }
    }
}

/// The published windows, from what they are made of: smoothing across differences, and second differences of both
/// axes.
#[test]
fn edges_are_sobel_and_laplace() {
    let (smooth, slope) = ([1.0, 2.0, 1.0], [1.0, 0.0, -1.0]);
    let [(_, sobel_x), (_, sobel_y), (_, laplacian)] = EDGES;
    for t in 0..TAPS {
        let (y, x) = (t / 3, t % 3);
        assert_eq!((sobel_x[t], sobel_y[t]), (smooth[y] * slope[x], smooth[x] * slope[y]));
        let second = [1.0, -2.0, 1.0];
        assert_eq!(laplacian[t], if y == 1 { second[x] } else { 0.0 } + if x == 1 { second[y] } else { 0.0 });
    }
}
