//! The networks as data: shapes, budgets, errors.

use gs3_neural::model::{PublishedNetwork, Tier, interpolate, super_sample};
use gs3_neural::{Border, Conv2d, GraphBuilder, GraphError, Op, Shape};

const LR: [usize; 2] = [270, 480];

/// Multiply-adds per LR pixel at ×4, super sampling and interpolation: what two cores with a peak of 235 GFLOP/s do
/// from 480×270 in 25 + 25 ms (fast) and 60 + 75 ms (balanced) at 85 % of it; high costs about twice as much again.
/// The graphs stay within a fifth.
#[test]
fn networks_keep_their_budgets() {
    for (tier, super_sampling, interpolation) in
        [(Tier::Fast, 20e3, 19e3), (Tier::Balanced, 46e3, 58e3), (Tier::High, 140e3, 120e3)]
    {
        for (graph, budget) in
            [(super_sample(4, tier), super_sampling), (interpolate(4, tier), interpolation)]
        {
            let graph = graph.expect("a network");
            let work = graph.multiply_adds_per_pixel(LR).expect("a size it takes");
            let learned: usize = graph.parameters().iter().map(|p| p.shape.iter().product::<usize>()).sum();
            println!(
                "{} {}: {work:.0} multiply-adds per LR pixel, {learned} parameters",
                graph.name(),
                tier.name()
            );
            assert!(work > 0.8 * budget && work < 1.2 * budget, "{} {tier:?}: {work}", graph.name());
        }
    }
}

/// Parameters, and multiply-adds per HR pixel at ×4, as published for RGB; of NinaSR those of its attention, 13, come
/// on top.
#[test]
fn published_networks_have_their_published_sizes() {
    for (peer, parameters, work) in [
        (PublishedNetwork::Ecbsr, 16_768, 1_035),
        (PublishedNetwork::Rt4ksr, 70_560, 1_093),
        (PublishedNetwork::Ninasr, 1_030_192, 60_835),
    ] {
        let graph = peer.graph(4).expect("a network");
        let learned: usize = graph.parameters().iter().map(|p| p.shape.iter().product::<usize>()).sum();
        assert_eq!(learned, parameters, "{peer:?}");
        let actual = graph.multiply_adds_per_pixel([256, 480]).expect("a size it takes") / 16.0;
        assert!((actual - f64::from(work)).abs() < 1.0, "{peer:?}: {actual}");
    }
    // Blocks of 2×2 pixels need even sides.
    assert!(matches!(
        PublishedNetwork::Rt4ksr.graph(4).expect("a network").shapes([5, 8]),
        Err(GraphError::Shape { layer, .. }) if layer == "blocks"
    ));
}

#[test]
fn networks_give_high_resolution_frames_of_any_size() {
    for scale in [2, 4] {
        for lr in [LR, [1, 1], [5, 7]] {
            for graph in [super_sample(scale, Tier::Fast), interpolate(scale, Tier::Fast)] {
                let graph = graph.expect("a network");
                let shapes = graph.shapes(lr).expect("a size it takes");
                let color = graph.outputs().iter().find(|o| o.name == "color").expect("a color");
                let expected = Shape { height: scale * lr[0], width: scale * lr[1], channels: 4 };
                assert_eq!(shapes[color.tensor.index()], expected);
                let hidden = graph.outputs().iter().find(|o| o.name == "hidden").expect("a state");
                let (given, _) = graph.inputs().find(|(_, layer)| layer.name == "hidden").expect("a state");
                assert_eq!(
                    shapes[hidden.tensor.index()],
                    shapes[given.index()],
                    "a state fits the next frame"
                );
            }
        }
    }
}

#[test]
fn mistakes_name_the_layer_and_both_sides() {
    let mut g = GraphBuilder::new("wrong", 1, Border::Zero);
    let [a, b] = [g.input("a", 3, 1), g.input("b", 4, 1)];
    let sum = g.layer("sum", Op::Add, &[a, b]);
    g.layer("later", Op::PixelShuffle { factor: 2 }, &[sum]);
    let error = g.finish().expect_err("shapes differ");
    assert_eq!(error.to_string(), "layer sum: expected two inputs of 64×64×3, found 64×64×3, 64×64×4");

    let mut g = GraphBuilder::new("wrong", 1, Border::Zero);
    let a = g.input("a", 3, 1);
    g.layer("shuffle", Op::PixelShuffle { factor: 2 }, &[a]);
    assert!(matches!(g.finish(), Err(GraphError::Shape { layer, .. }) if layer == "shuffle"));

    let mut g = GraphBuilder::new("wrong", 1, Border::Zero);
    let a = g.input("a", 3, 1);
    g.conv("conv", Conv2d::new(2, 4), &[a]);
    assert!(matches!(g.finish(), Err(GraphError::Shape { layer, .. }) if layer == "conv"));

    let mut g = GraphBuilder::new("wrong", 1, Border::Zero);
    g.input("a", 3, 1);
    g.input("a", 3, 1);
    assert_eq!(g.finish(), Err(GraphError::Duplicate { layer: "a".to_owned() }));
}

#[test]
fn sizes_that_no_image_has_are_refused() {
    let graph = super_sample(4, Tier::Fast).expect("a network");
    for lr in [[0, 5], [5, 1 << 40], [20_000, 20_000]] {
        assert!(graph.shapes(lr).is_err(), "{lr:?}");
    }
    assert!(super_sample(0, Tier::Fast).is_err());
    assert!(interpolate(1 << 40, Tier::Fast).is_err());
}
