//! The engine computes what the reference says.

use gs3_neural::model::{PublishedNetwork, Tier, initial_weights, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, Engine, Graph, GraphBuilder, Header, Op, RunError, Weights, reference,
};

use crate::common::{images, named, single};
use crate::operations::operations;

/// Weights with biases, slopes and the like that differ from channel to channel.
fn weights(graph: &Graph) -> Weights {
    let mut weights = Weights::random(graph, Header::of(graph, 4), 1);
    for array in weights.arrays.values_mut().filter(|a| a.shape().len() == 1) {
        array.values_mut().iter_mut().enumerate().for_each(|(k, v)| *v = k as f32 * 0.01 - 0.1);
    }
    weights
}

/// Runs `graph` both ways and compares every output.
fn compare(graph: &Graph, weights: &Weights, lr: [usize; 2]) {
    let images = images(graph, lr, 3);
    let planes = reference::run(graph, weights, lr, &named(&images)).expect("the reference runs");
    let mut engine = Engine::new(graph, weights, lr).expect("an engine");
    // Twice: what the first frame leaves behind does not matter.
    for _ in 0..2 {
        for output in graph.outputs() {
            let expected = &planes[output.tensor.index()];
            let mut actual = vec![f32::NAN; expected.shape.len()];
            engine.run(&named(&images), &mut [(&output.name, &mut actual)]).expect("it runs");
            for (k, (a, e)) in actual.iter().zip(&expected.values).enumerate() {
                let error = (f64::from(*a) - e).abs();
                assert!(error <= 1e-4, "{} {lr:?} {} {k}: {a} {e}", graph.name(), output.name);
            }
        }
    }
}

#[test]
fn networks_compute_what_the_reference_says() {
    for tier in Tier::ALL {
        for graph in [super_sample(4, tier), interpolate(4, tier), super_sample(2, tier)] {
            let graph = graph.expect("a network");
            // Random heads: initial ones are zero and would hide what is before them.
            compare(&graph, &Weights::random(&graph, Header::of(&graph, 4), 5), [11, 27]);
        }
    }
    let graph = interpolate(4, Tier::Fast).expect("a network");
    compare(&graph, &initial_weights(&graph, Header::of(&graph, 4), 5), [1, 1]);
}

/// Rows of several strips, which overlap.
#[test]
fn wide_images_compute_what_the_reference_says() {
    for graph in [super_sample(4, Tier::Fast), super_sample(2, Tier::Balanced), interpolate(2, Tier::Fast)] {
        let graph = graph.expect("a network");
        compare(&graph, &Weights::random(&graph, Header::of(&graph, 4), 5), [4, 131]);
    }
}

/// Images of more rows than are kept of what passes of a group store for each other, on one thread and on several:
/// the same numbers, and those of the reference.
#[test]
fn high_images_compute_what_the_reference_says_on_any_number_of_threads() {
    for graph in [super_sample(2, Tier::Fast), interpolate(2, Tier::Fast), PublishedNetwork::Ecbsr.graph(2)] {
        let graph = graph.expect("a network");
        let (weights, lr) = (Weights::random(&graph, Header::of(&graph, 4), 5), [90, 14]);
        let images = images(&graph, lr, 3);
        let shapes = graph.shapes(lr).expect("a size it takes");
        let pool =
            |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let run = || {
            let mut engine = Engine::new(&graph, &weights, lr).expect("an engine");
            let output = &graph.outputs()[0];
            let mut image = vec![f32::NAN; shapes[output.tensor.index()].len()];
            engine.run(&named(&images), &mut [(&output.name, &mut image)]).expect("it runs");
            image
        };
        assert_eq!(pool(1).install(run), pool(3).install(run), "{}", graph.name());
        pool(1).install(|| compare(&graph, &weights, lr));
    }
}

/// Two that are the same, and more than a group writes.
#[test]
fn any_number_of_outputs_is_written() {
    let mut g = GraphBuilder::new("outputs", 1, Border::Zero);
    let x = g.input("x", 18, 1);
    let mut y = x;
    for k in 0..9 {
        y = g.layer(&format!("y.{k}"), Op::Scale { factor: 0.9 }, &[y]);
        g.output(&format!("y.{k}"), y);
    }
    let part = g.layer("part", Op::Slice { first: 16, count: 2 }, &[y]);
    let again = g.layer("again", Op::Activate(Activation::Tanh), &[part]);
    for (name, tensor) in [("x", x), ("part", part), ("again", again)] {
        g.output(name, tensor);
    }
    let graph = g.finish().expect("a graph");
    let (weights, lr) = (weights(&graph), [3, 50]);
    compare(&graph, &weights, lr);
    let images = images(&graph, lr, 3);
    let mut engine = Engine::new(&graph, &weights, lr).expect("an engine");
    let (mut a, mut b) = (vec![0.0; 3 * 50 * 2], vec![1.0; 3 * 50 * 2]);
    engine.run(&named(&images), &mut [("again", &mut a), ("again", &mut b)]).expect("it runs");
    assert_eq!(a, b);
    assert!(a.iter().any(|v| *v != 0.0));
}

#[test]
fn every_operation_computes_what_the_reference_says() {
    for (op, inputs) in operations() {
        for (channels, border) in [(4, Border::Zero), (36, Border::Replicate)] {
            let graph = single(op, channels, &inputs, border);
            compare(&graph, &weights(&graph), [5, 7]);
        }
    }
    let graph = single(Op::PixelUnshuffle { factor: 2 }, 5, &["a"], Border::Zero);
    compare(&graph, &weights(&graph), [4, 6]);
    for channels in [3, 48] {
        let graph = single(Op::Shift { color: [0.5, -0.2, 0.1] }, channels, &["a"], Border::Zero);
        compare(&graph, &weights(&graph), [5, 7]);
    }
}

#[test]
fn convolutions_of_any_size_compute_what_the_reference_says() {
    for activation in [
        Activation::Relu,
        Activation::LeakyRelu { slope: 0.2 },
        Activation::Gelu,
        Activation::Silu,
        Activation::Sigmoid,
        Activation::Tanh,
    ] {
        for (kernel, dilation, channels, outputs) in
            [(3, 1, 17, 33), (1, 1, 5, 48), (7, 3, 2, 1), (3, 2, 32, 80)]
        {
            for border in [Border::Zero, Border::Replicate] {
                for bias in [false, true] {
                    let conv = Conv2d {
                        bias,
                        ..Conv2d::new(kernel, outputs).dilation(dilation).activation(activation)
                    };
                    let graph = single(Op::Conv2d(conv), channels, &["a"], border);
                    compare(&graph, &weights(&graph), [5, 29]);
                }
            }
        }
    }
}

#[test]
fn a_single_output_of_several_inputs_is_what_the_reference_says() {
    // Inputs of odd numbers of channels, one of more than a block.
    for border in [Border::Zero, Border::Replicate] {
        let mut g = GraphBuilder::new("single", 1, border);
        let inputs = [g.input("a", 3, 1), g.input("b", 17, 1), g.input("c", 1, 1)];
        let all = g.layer("all", Op::Concat, &inputs);
        let y = g.conv("y", Conv2d::new(5, 1).activation(Activation::Sigmoid), &[all]);
        g.output("y", y);
        let graph = g.finish().expect("a graph");
        compare(&graph, &weights(&graph), [6, 51]);
    }
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let graph = super_sample(2, Tier::Fast).expect("a network");
    let weights = initial_weights(&graph, Header::of(&graph, 4), 1);
    let lr = [3, 5];
    let mut engine = Engine::new(&graph, &weights, lr).expect("an engine");
    let mut images = images(&graph, lr, 1);
    let mut color = vec![0.0; engine.shape("color").map_or(0, |s| s.len()) * 4];
    let result = engine.run(&named(&images), &mut [("colour", &mut color)]);
    assert!(matches!(result, Err(RunError::Unknown { name, .. }) if name == "colour"));
    let result = engine.run(&named(&images), &mut [("color", &mut color[1..])]);
    assert!(matches!(result, Err(RunError::Length { name, .. }) if name == "color"));
    images[0].1.pop();
    assert!(matches!(engine.run(&named(&images), &mut []), Err(RunError::Length { .. })));
    images.remove(0);
    assert!(matches!(engine.run(&named(&images), &mut []), Err(RunError::Missing { .. })));
    images.push(("else".to_owned(), Vec::new()));
    assert!(matches!(engine.run(&named(&images), &mut []), Err(RunError::Unknown { .. })));
}

/// Without anything learned, a previous frame or drift the analytic one stays, bit for bit; and so it does where it
/// is certain: what networks add is weighed by the uncertainty; the previous frame has no share there, and there is
/// no drift.
#[test]
fn where_nothing_is_learned_or_uncertain_the_analytic_frame_stays() {
    let lr = [5, 9];
    for graph in [super_sample(4, Tier::Fast), super_sample(2, Tier::Balanced)] {
        let graph = graph.expect("a network");
        let frame = |weights: &Weights, certain: bool| {
            let mut images = images(&graph, lr, 3);
            for (_, values) in
                images.iter_mut().filter(|(name, _)| ["share", "drift"].contains(&name.as_str()))
            {
                values.fill(0.0);
            }
            let history = images.iter_mut().find(|(name, _)| name == "history").expect("a history");
            if certain {
                history.1.chunks_exact_mut(4).for_each(|pixel| pixel[3] = 0.0);
            }
            let mut color = vec![0.0; history.1.len()];
            let expected = history.1.clone();
            let mut engine = Engine::new(&graph, weights, lr).expect("an engine");
            engine.run(&named(&images), &mut [("color", &mut color)]).expect("it runs");
            (color, expected)
        };
        let (color, expected) = frame(&initial_weights(&graph, Header::of(&graph, 4), 3), false);
        assert_eq!(color, expected);
        let learned = Weights::random(&graph, Header::of(&graph, 4), 3);
        let (color, expected) = frame(&learned, true);
        assert_eq!(color, expected);
        let (color, expected) = frame(&learned, false);
        assert_ne!(color, expected);
    }
}
