//! Plans, without a device.

use std::collections::BTreeSet;

use super::*;
use crate::gpu::MatrixUnit;
use crate::graph::{Border, Conv2d, GraphBuilder};
use crate::model::{Tier, interpolate, super_sample};
use crate::weights::Header;

fn weights(graph: &Graph) -> Weights {
    Weights::random(graph, Header::of(graph, 4), 1)
}

fn networks(tier: Tier) -> [Graph; 2] {
    [super_sample(4, tier), interpolate(4, tier)].map(|graph| graph.unwrap())
}

/// Every read of a buffer finds the right data, no buffer is read and written at once, and every kernel is valid and
/// within the limits that every device has.
#[test]
fn plans_are_consistent_up_to_the_largest_frames() {
    let [single, half] = [Precision::Single, Precision::Half].map(GpuEngineSettings::new);
    let [small, large] = [(8, 8), (16, 32)].map(|(side, subgroup)| {
        let matrices = Some(MatrixUnit { side, subgroup });
        GpuEngineSettings { matrices, ..half }
    });
    for (tier, settings, lr) in [
        (Tier::Fast, single, [1, 1]),
        (Tier::Fast, half, [270, 480]),
        (Tier::Balanced, single, [135, 240]),
        (Tier::Balanced, half, [540, 1024]),
        (Tier::High, single, [1080, 1920]),
        (Tier::High, half, [1080, 1920]),
        (Tier::Fast, small, [270, 480]),
        (Tier::Balanced, large, [540, 1024]),
        (Tier::High, large, [1080, 1920]),
    ] {
        for graph in networks(tier) {
            let plan = Plan::new(&graph, &weights(&graph), lr, &settings).unwrap();
            let mut sources = BTreeSet::new();
            let mut written = BTreeSet::new();
            for step in &plan.steps {
                let key = |stored: &Stored| format!("{stored:?}");
                assert!(
                    step.reads.len() <= PARTS.len() && !step.reads.contains(&step.writes),
                    "{}",
                    step.label
                );
                for read in step.reads.iter().filter(|read| !matches!(read, Stored::Input(_))) {
                    assert!(written.contains(&key(read)), "{} reads what nobody wrote", step.label);
                }
                written.insert(key(&step.writes));
                assert!(step.groups.iter().all(|count| (1..=65_535).contains(count)), "{step:?}");
                assert!(step.weights.end <= plan.weights.len() as u64 && step.weights.start % 256 == 0);
                if sources.insert(&step.source) {
                    gs3_compute::validate(&step.label, &[&step.source]).unwrap();
                }
            }
            for output in 0..plan.outputs.len() {
                assert!(written.contains(&format!("{:?}", Stored::Output(output))), "{}", graph.name());
            }
            // Far fewer buffers than results: they are used again.
            assert!(plan.slots.len() * 2 < plan.steps.len(), "{} {}", plan.slots.len(), plan.steps.len());
        }
    }
}

#[test]
fn numbers_of_the_shaders_are_explained() {
    assert_eq!(gs3_test_support::check_literals(concat!(env!("CARGO_MANIFEST_DIR"), "/src/gpu")), 7);
}

/// What the largest frame needs: 7680×4320 at ×4, high tier.
#[test]
fn the_largest_frame_fits_a_device() {
    for graph in networks(Tier::High) {
        let settings = GpuEngineSettings::new(Precision::Half);
        let plan = Plan::new(&graph, &weights(&graph), [1080, 1920], &settings).unwrap();
        let most = plan.slots.iter().max().unwrap();
        assert!(*most <= 1 << 30, "{} bytes in one buffer", most);
        assert!(plan.slots.iter().sum::<u64>() <= 3 << 30, "{:?}", plan.slots);
    }
}

#[test]
fn states_in_blocks_are_not_copied() {
    let graph = super_sample(4, Tier::Fast).unwrap();
    let all = GpuEngineSettings::new(Precision::Single);
    let state = [("hidden", ImageFormat::Blocks)];
    let outputs = [("color", ImageFormat::Pixels), state[0]];
    let blocks = GpuEngineSettings { inputs: &state, outputs: Some(&outputs), ..all };
    let steps = |settings| Plan::new(&graph, &weights(&graph), [4, 4], settings).unwrap().steps.len();
    // Images given are read where they are, too; only what is shown is made once more.
    assert_eq!(steps(&all) - steps(&blocks), 1);
}

#[test]
fn more_parts_than_a_kernel_binds_are_refused() {
    let mut g = GraphBuilder::new("wide", 1, Border::Zero);
    let parts: Vec<_> = (0..7).map(|k| g.input(&format!("a{k}"), 1, 1)).collect();
    let sum = g.conv("sum", Conv2d::new(1, 1), &parts);
    g.output("sum", sum);
    let graph = g.finish().unwrap();
    let result = Plan::new(&graph, &weights(&graph), [1, 1], &GpuEngineSettings::new(Precision::Single));
    let too_many = GpuError::TooLarge { what: "inputs of layer sum".to_owned(), max: 6, actual: 7 };
    assert!(matches!(result, Err(GpuRunError::Gpu(error)) if error == too_many));
}

/// What frames on a device ask for.
const COLOR_AND_STATE: [(&str, ImageFormat); 2] =
    [("color", ImageFormat::HalfPixels), ("hidden", ImageFormat::Blocks)];

/// Reads and writes limit a network on a GPU: there are few kernels, and each does all the work possible on the data
/// it has read. Without fusion, super sampling was 42 kernels and 6,510 B an LR pixel, and interpolation 53 and
/// 6,860.
#[test]
fn networks_are_few_kernels_that_move_few_bytes() {
    let lr = [540, 1024];
    for (tier, of_super_sample, of_interpolate) in [
        (Tier::Fast, (9, 2_360), (18, 2_590)),
        (Tier::Balanced, (9, 2_610), (18, 3_080)),
        (Tier::High, (10, 3_380), (18, 3_900)),
    ] {
        for (graph, images, (kernels, bytes)) in [
            (super_sample(4, tier).unwrap(), ["history", "previous"], of_super_sample),
            (interpolate(4, tier).unwrap(), ["before", "after"], of_interpolate),
        ] {
            let [a, b] = images.map(|name| (name, ImageFormat::HalfPixels));
            let settings = GpuEngineSettings {
                inputs: &[a, b, COLOR_AND_STATE[1]],
                outputs: Some(&COLOR_AND_STATE),
                ..GpuEngineSettings::new(Precision::Half)
            };
            let plan = Plan::new(&graph, &weights(&graph), lr, &settings).unwrap();
            let moved = plan.steps.iter().map(|step| step.bytes).sum::<u64>() as usize / (lr[0] * lr[1]);
            assert_eq!(plan.steps.len(), kernels, "{} {}", graph.name(), tier.name());
            assert!((bytes - 100..=bytes).contains(&moved), "{} {}: {moved}", graph.name(), tier.name());
        }
    }
}

/// Pixel-by-pixel work on a convolution's result is done in its kernel, convolutions of the same parts are one
/// kernel, and nothing needed is left out: here one step, with a second result that another kernel reads.
#[test]
fn convolutions_of_the_same_parts_are_one_kernel_with_what_follows_them() {
    let mut g = GraphBuilder::new("fused", 1, Border::Zero);
    let [a, b] = ["a", "b"].map(|name| g.input(name, 4, 1));
    let first = g.conv("first", Conv2d::new(3, 4), &[a]);
    let second = g.conv("second", Conv2d::new(3, 8), &[a]);
    let scaled = g.layer("scaled", Op::Multiply, &[first, b]);
    let summed = g.layer("summed", Op::Add, &[scaled, b]);
    let last = g.conv("last", Conv2d::new(5, 4), &[summed, second]);
    // This one must wait for `last`, so it cannot be one with the others.
    let late = g.conv("late", Conv2d::new(3, 4), &[last]);
    g.output("late", late);
    let graph = g.finish().unwrap();
    let plan =
        Plan::new(&graph, &weights(&graph), [8, 8], &GpuEngineSettings::new(Precision::Single)).unwrap();
    let labels: Vec<&str> = plan.steps.iter().map(|step| step.label.as_str()).collect();
    assert_eq!(labels, ["first, second", "last", "late", "late.export"]);
    assert_eq!(plan.steps[0].reads, [Stored::Input(0), Stored::Input(1)]);
    assert_eq!(plan.steps[1].reads, [plan.steps[0].writes]);
}
