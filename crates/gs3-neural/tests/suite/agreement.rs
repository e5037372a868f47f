//! What interprets a graph agrees on the same inputs: reference, CPU engine and the trainer's forward pass. ONNX
//! Runtime is held to the three in `onnx`.

use gs3_neural::model::{PublishedNetwork, Tier, interpolate, super_sample};
use gs3_neural::{Arithmetic, Differentiator, Engine, Graph, Header, Random, Weights, reference};

/// The largest difference that single precision explains, of numbers of about 1: some thirty layers, each a sum of some
/// hundred products.
const TOLERANCE: f64 = 1e-4;

/// All that the crate names: both networks in every tier and scale, and the published ones.
fn graphs() -> Vec<(Graph, u32)> {
    let mut graphs = Vec::new();
    for scale in [2, 4] {
        for tier in Tier::ALL {
            graphs.push((super_sample(scale, tier).unwrap(), scale as u32));
            graphs.push((interpolate(scale, tier).unwrap(), scale as u32));
        }
        graphs.extend(PublishedNetwork::ALL.map(|peer| (peer.graph(scale).unwrap(), scale as u32)));
    }
    graphs
}

/// Random weights, biases included: initial last layers are zero and would hide what is before them.
fn weights(graph: &Graph, scale: u32) -> Weights {
    let mut weights = Weights::random(graph, Header::of(graph, scale), 5);
    let mut random = Random::new(6);
    for array in weights.arrays.values_mut().filter(|array| array.shape().len() == 1) {
        array.values_mut().iter_mut().for_each(|v| *v += 0.1 * random.signed());
    }
    weights
}

/// Random inputs of `graph`, in `[-1, 1]`, by name.
fn images(graph: &Graph, lr: [usize; 2]) -> Vec<(&str, Vec<f32>)> {
    let (shapes, mut random) = (graph.shapes(lr).unwrap(), Random::new(3));
    let mut image = |len: usize| (0..len).map(|_| random.signed()).collect();
    graph.inputs().map(|(t, layer)| (layer.name.as_str(), image(shapes[t.index()].len()))).collect()
}

/// The largest difference of an output from `expected`.
fn difference(actual: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(actual.len(), expected.len());
    let differences = actual.iter().zip(expected).map(|(a, e)| (f64::from(*a) - e).abs());
    // A number that is none differs most.
    differences.fold(0.0, |most, d| if d <= most { most } else { d })
}

#[test]
fn reference_engine_and_trainer_agree_on_all_networks() {
    for (graph, scale) in graphs() {
        // Even sides, which all networks take, and no multiple of what kernels compute together.
        let (lr, weights) = ([10, 26], weights(&graph, scale));
        let images = images(&graph, lr);
        let images: Vec<(&str, &[f32])> = images.iter().map(|(name, image)| (*name, &image[..])).collect();

        let planes = reference::run(&graph, &weights, lr, &images).unwrap();
        let mut engine = Engine::new(&graph, &weights, lr).unwrap();
        let trainer = Differentiator::new(&graph, lr, &[]).unwrap();
        let mut tape = trainer.tape();
        trainer.forward(&trainer.pack(&weights).unwrap(), &images, &mut tape).unwrap();
        for output in graph.outputs() {
            let expected = &planes[output.tensor.index()].values;
            let mut actual = vec![f32::NAN; expected.len()];
            engine.run(&images, &mut [(&output.name, &mut actual)]).unwrap();
            let of_engine = difference(&actual, expected);
            actual.fill(f32::NAN);
            trainer.output(&tape, &output.name, &mut actual).unwrap();
            let of_trainer = difference(&actual, expected);
            let name = format!("{} x{scale} {}", graph.name(), output.name);
            println!("{name}: engine {of_engine:.1e}, trainer {of_trainer:.1e}");
            assert!(of_engine <= TOLERANCE, "{name}: engine {of_engine}");
            assert!(of_trainer <= TOLERANCE, "{name}: trainer {of_trainer}");
        }
    }
}

/// Products of numbers that are rounded to 8 bits: half a unit in the last place is 2⁻⁹ of each, errors of many
/// products partly cancel, and layers add them up.
const BF16_TOLERANCE: f64 = 2e-2;

#[test]
fn the_engine_in_bf16_agrees_with_the_reference() {
    for (graph, scale) in graphs() {
        // As wide as a run of the kernel and more, so that it is used where the machine has it.
        let (lr, weights) = ([6, 62], weights(&graph, scale));
        let images = images(&graph, lr);
        let images: Vec<(&str, &[f32])> = images.iter().map(|(name, image)| (*name, &image[..])).collect();
        let planes = reference::run(&graph, &weights, lr, &images).unwrap();
        let mut engine = Engine::with_arithmetic(&graph, &weights, lr, Arithmetic::Bf16).unwrap();
        for output in graph.outputs() {
            let expected = &planes[output.tensor.index()].values;
            // Relative to what the output holds: random networks give numbers of any size.
            let largest = expected.iter().fold(1.0_f64, |most, v| most.max(v.abs()));
            let mut actual = vec![f32::NAN; expected.len()];
            engine.run(&images, &mut [(&output.name, &mut actual)]).unwrap();
            let error = difference(&actual, expected) / largest;
            println!("{} x{scale} {}: {error:.1e}", graph.name(), output.name);
            assert!(error <= BF16_TOLERANCE, "{} x{scale} {}: {error}", graph.name(), output.name);
        }
    }
}
