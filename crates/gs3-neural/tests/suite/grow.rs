//! Networks grown from smaller ones compute the same.

use gs3_neural::model::{Tier, grown, interpolate, super_sample};
use gs3_neural::{Graph, GraphError, Header, Random, Weights, reference};

const LR: [usize; 2] = [6, 5];

fn header(graph: &Graph, tier: Tier) -> Header {
    Header { tier: tier.name().to_owned(), ..Header::of(graph, 4) }
}

/// Random inputs, in `[-1, 1]`; those of a smaller network are the first channels of a larger one's.
fn images(graph: &Graph) -> Vec<(&str, Vec<f32>)> {
    let shapes = graph.shapes(LR).unwrap();
    let image = |name: &str, len: usize, channels: usize| -> Vec<f32> {
        let number =
            |k: usize| Random::new((k / channels * 1000 + k % channels + name.len()) as u64).signed();
        (0..len).map(number).collect()
    };
    let shape = |t: gs3_neural::Tensor| shapes[t.index()];
    graph
        .inputs()
        .map(|(t, layer)| (layer.name.as_str(), image(&layer.name, shape(t).len(), shape(t).channels)))
        .collect()
}

#[test]
fn a_grown_network_gives_what_the_smaller_one_gave() {
    for [small, large] in
        [[Tier::Fast, Tier::Balanced], [Tier::Balanced, Tier::High], [Tier::Fast, Tier::High]]
    {
        assert_grows(super_sample, [small, large], 1e-9);
        // What reads means over more channels is multiplied by 1.5 or 2 and rounded to f32.
        assert_grows(interpolate, [small, large], 1e-7);
    }
}

fn assert_grows(
    network: fn(usize, Tier) -> Result<Graph, GraphError>,
    [small, large]: [Tier; 2],
    tolerance: f64,
) {
    let graphs = [small, large].map(|tier| network(4, tier).unwrap());
    let weights = Weights::random(&graphs[0], header(&graphs[0], small), 5);
    let more = grown(&graphs[0], &weights, &graphs[1], header(&graphs[1], large), 6).unwrap();
    more.check(&graphs[1]).unwrap();
    let mut results = Vec::new();
    for (graph, weights) in graphs.iter().zip([&weights, &more]) {
        let images = images(graph);
        let images: Vec<(&str, &[f32])> = images.iter().map(|(name, image)| (*name, &image[..])).collect();
        let planes = reference::run(graph, weights, LR, &images).unwrap();
        let of = |name: &str| {
            let output = graph.outputs().iter().find(|output| output.name == name).unwrap();
            planes[output.tensor.index()].clone()
        };
        results.push([of("color"), of("hidden")]);
    }
    let ([color, hidden], [more_color, more_hidden]) = (&results[0], &results[1]);
    for (a, b) in color.values.iter().zip(&more_color.values) {
        assert!((a - b).abs() < tolerance, "{small:?} to {large:?}: {a}, {b}");
    }
    let [channels, more_channels] = [hidden, more_hidden].map(|plane| plane.shape.channels);
    let pixels = hidden.values.chunks(channels).zip(more_hidden.values.chunks(more_channels));
    for (a, b) in pixels.flat_map(|(a, b)| a.iter().zip(b)) {
        assert!((a - b).abs() < tolerance, "{small:?} to {large:?}, hidden: {a}, {b}");
    }
    // What is new does not stay at nothing: something of it is not zero.
    if more_channels > channels {
        let new = more_hidden.values.chunks(more_channels).map(|pixel| pixel[channels].abs());
        assert!(new.fold(0.0, f64::max) > 1e-3);
    }
}

#[test]
fn networks_that_cannot_grow_say_where() {
    // Those of different kinds: what super sampling does first with its image, interpolation does not do.
    let small = super_sample(4, Tier::Fast).unwrap();
    let large = interpolate(4, Tier::Balanced).unwrap();
    let weights = Weights::random(&small, header(&small, Tier::Fast), 5);
    let error = grown(&small, &weights, &large, header(&large, Tier::Balanced), 6).err();
    assert!(matches!(&error, Some(GraphError::Shape { layer, .. }) if layer == "before"), "{error:?}");
    // Nor can one shrink.
    let [small, large] = [Tier::High, Tier::Fast].map(|tier| super_sample(4, tier).unwrap());
    let weights = Weights::random(&small, header(&small, Tier::High), 5);
    assert!(grown(&small, &weights, &large, header(&large, Tier::Fast), 6).is_err());
}
