//! The GPU engine computes the reference's results, on any adapter.

use gs3_compute::{Buffer, Gpu, GpuSettings, OptionalFeatures, Slice, Use, device_for_tests};
use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, GpuEngine, GpuEngineSettings, GpuRunError, GpuTensorImage, Graph,
    GraphBuilder, Header, ImageFormat, MatrixUnit, Op, Precision, RunError, Weights, reference,
};

use crate::common::{images, named, single};

/// The device of this machine, if it has one.
fn device(features: OptionalFeatures) -> Option<Gpu> {
    device_for_tests(&GpuSettings { features, ..GpuSettings::default() })
}

/// In which ways a device computes, and how far from the reference it may be, of numbers about 1.
fn ways(gpu: &Gpu) -> Vec<(GpuEngineSettings<'static>, f64)> {
    let half = gpu.capabilities().shader_f16;
    let unit = MatrixUnit::of(gpu.capabilities());
    if unit.is_none() {
        eprintln!("skipped: no products of matrices");
    }
    let single = (GpuEngineSettings::new(Precision::Single), 1e-4);
    let half = half.then(|| (GpuEngineSettings::new(Precision::Half), 2e-2));
    let matrices = half.filter(|_| unit.is_some()).map(|(half, tolerance)| {
        let settings = GpuEngineSettings { matrices: unit, ..half };
        (settings, tolerance)
    });
    [single].into_iter().chain(half).chain(matrices).collect()
}

/// Buffers by name.
type Buffers = Vec<(String, Buffer)>;

fn slices(buffers: &Buffers) -> Vec<(&str, Slice<'_>)> {
    buffers.iter().map(|(name, buffer)| (name.as_str(), buffer.slice())).collect()
}

fn uploaded(gpu: &Gpu, images: &[(String, Vec<f32>)]) -> Buffers {
    images
        .iter()
        .map(|(name, image)| (name.clone(), gpu.buffer_with(name, Use::Storage, image).unwrap()))
        .collect()
}

/// Buffers in which what is not written stands out.
fn outputs(gpu: &Gpu, engine: &GpuEngine) -> Buffers {
    let buffer = |image: &GpuTensorImage| {
        let values = vec![f32::NAN; image.bytes as usize / 4];
        (image.name.clone(), gpu.buffer_with(&image.name, Use::Storage, &values).unwrap())
    };
    engine.outputs().iter().map(buffer).collect()
}

fn find<'a>(images: &'a [GpuTensorImage], name: &str) -> &'a GpuTensorImage {
    images.iter().find(|image| image.name == name).unwrap()
}

fn compare(gpu: &Gpu, graph: &Graph, weights: &Weights, lr: [usize; 2]) {
    let images = images(graph, lr, 3);
    let planes = reference::run(graph, weights, lr, &named(&images)).unwrap();
    for (way, tolerance) in ways(gpu) {
        let engine = GpuEngine::new(gpu, graph, weights, lr, &way).unwrap();
        let (from, to) = (uploaded(gpu, &images), outputs(gpu, &engine));
        let bound = engine.bind(gpu, &slices(&from), &slices(&to)).unwrap();
        let mut recorder = gpu.recorder(None);
        // Twice: what the first run leaves behind does not matter.
        bound.record(&mut recorder);
        bound.record(&mut recorder);
        recorder.submit().unwrap();
        for output in graph.outputs() {
            let expected = &planes[output.tensor.index()];
            let name = &output.name;
            assert_eq!(find(engine.outputs(), name).shape, expected.shape);
            let buffer = &to.iter().find(|(n, _)| n == name).unwrap().1;
            let actual = gpu.read::<f32>(&buffer.part(0, expected.shape.len() as u64 * 4)).unwrap();
            for (k, (a, e)) in actual.iter().zip(&expected.values).enumerate() {
                let error = (f64::from(*a) - e).abs();
                // Large numbers have large roundings.
                let allowed = tolerance * e.abs().max(1.0);
                assert!(error <= allowed, "{} {way:?} {lr:?} {name} {k}: {a} {e}", graph.name());
            }
        }
    }
}

#[test]
fn networks_compute_what_the_reference_says() {
    // Wider windows and more blocks come with larger tiers.
    for (tier, features) in [
        (Tier::Fast, OptionalFeatures::None),
        (Tier::Balanced, OptionalFeatures::Experimental),
        (Tier::High, OptionalFeatures::Experimental),
    ] {
        let Some(gpu) = device(features) else { continue };
        for graph in [super_sample(4, tier), interpolate(4, tier)] {
            let graph = graph.unwrap();
            // Random heads: initial ones are zero and would hide what is before them.
            compare(&gpu, &graph, &Weights::random(&graph, Header::of(&graph, 4), 5), [11, 27]);
        }
    }
}

#[test]
fn every_operation_computes_what_the_reference_says() {
    let Some(gpu) = device(OptionalFeatures::Experimental) else { return };
    let upsample = |factor| Op::Upsample { factor };
    let ops: Vec<(Op, Vec<&str>)> = vec![
        (Op::PixelShuffle { factor: 2 }, vec!["a"]),
        (Op::PixelShuffle { factor: 2 }, vec!["a", "b"]),
        (upsample(3), vec!["a"]),
        (upsample(2), vec!["a", "f"]),
        (Op::MaxPool2, vec!["a"]),
        (Op::Concat, vec!["a", "f", "a", "b"]),
        (Op::Concat, vec!["a", "b"]),
        (Op::Slice { first: 1, count: 2 }, vec!["a"]),
        (Op::Slice { first: 4, count: 3 }, vec!["a"]),
        (Op::Add, vec!["a", "b"]),
        (Op::Multiply, vec!["a", "b"]),
        (Op::Multiply, vec!["a", "f"]),
        (Op::Mix, vec!["a", "b", "f"]),
        (Op::Mix, vec!["a", "b", "b"]),
        (Op::ChannelMean, vec!["a"]),
        (Op::ChannelMax, vec!["a"]),
        (Op::Warp, vec!["a", "flow"]),
    ];
    for (k, (op, inputs)) in ops.into_iter().enumerate() {
        // Shuffles need multiples of four; the others meet blocks that are not full.
        let channels = if matches!(op, Op::PixelShuffle { .. }) { 12 } else { 7 + k % 2 };
        let graph = single(op, channels, &inputs, Border::Zero);
        compare(&gpu, &graph, &Weights::random(&graph, Header::of(&graph, 4), 1), [5, 7]);
    }
    let graph = single(Op::PixelUnshuffle { factor: 2 }, 5, &["a"], Border::Replicate);
    compare(&gpu, &graph, &Weights::random(&graph, Header::of(&graph, 4), 1), [4, 6]);
}

#[test]
fn convolutions_of_any_size_compute_what_the_reference_says() {
    let Some(gpu) = device(OptionalFeatures::Experimental) else { return };
    let sizes = [(3, 1, 17, 33), (1, 1, 5, 48), (7, 3, 2, 1), (3, 2, 9, 80), (5, 1, 3, 20), (1, 1, 70, 6)];
    let activations = [
        Activation::Relu,
        Activation::LeakyRelu { slope: 0.2 },
        Activation::Gelu,
        Activation::Silu,
        Activation::Sigmoid,
        Activation::Tanh,
    ];
    for (k, ((kernel, dilation, channels, outputs), activation)) in
        sizes.into_iter().zip(activations).enumerate()
    {
        let border = if k % 2 == 0 { Border::Zero } else { Border::Replicate };
        let bias = k % 3 != 0;
        let conv = Conv2d { bias, ..Conv2d::new(kernel, outputs).dilation(dilation).activation(activation) };
        let mut g = GraphBuilder::new("conv", 1, border);
        let a = g.input("a", channels, 1);
        let b = g.input("b", 6, 1);
        // Two parts; the first ends within a block.
        let result = g.conv("result", conv, &[a, b]);
        g.output("result", result);
        let graph = g.finish().unwrap();
        let mut weights = Weights::random(&graph, Header::of(&graph, 4), 1);
        // Biases start as zero.
        for array in weights.arrays.values_mut().filter(|a| a.shape().len() == 1) {
            array.values_mut().iter_mut().enumerate().for_each(|(k, v)| *v = k as f32 * 0.01 - 0.1);
        }
        compare(&gpu, &graph, &weights, [19, 37]);
    }
}

/// A state goes from one run to the next without being copied, and outputs that are not requested are not computed.
#[test]
fn states_stay_on_the_device() {
    let Some(gpu) = device(OptionalFeatures::Experimental) else { return };
    let graph = super_sample(2, Tier::Fast).unwrap();
    let weights = Weights::random(&graph, Header::of(&graph, 4), 5);
    let lr = [6, 9];
    let mut images = images(&graph, lr, 3);
    for (way, tolerance) in ways(&gpu) {
        let state = ("hidden", ImageFormat::Blocks);
        let wanted = [state, ("color", ImageFormat::Pixels)];
        let settings = GpuEngineSettings { inputs: &[state], outputs: Some(&wanted), ..way };
        let engine = GpuEngine::new(&gpu, &graph, &weights, lr, &settings).unwrap();
        let buffer = |image: &GpuTensorImage| gpu.buffer(&image.name, Use::Storage, image.bytes).unwrap();
        let states = [engine.inputs(), engine.outputs()].map(|images| buffer(find(images, "hidden")));
        let color = buffer(find(engine.outputs(), "color"));
        let mut from = uploaded(&gpu, &images);
        from.retain(|(name, _)| name != "hidden");
        let bind = |before: &Buffer, after: &Buffer| {
            let mut from = slices(&from);
            from.push(("hidden", before.slice()));
            engine.bind(&gpu, &from, &[("hidden", after.into()), ("color", (&color).into())]).unwrap()
        };
        let mut recorder = gpu.recorder(None);
        // Buffers start as zeros, and so does the state.
        bind(&states[0], &states[1]).record(&mut recorder);
        bind(&states[1], &states[0]).record(&mut recorder);
        recorder.submit().unwrap();
        let actual = gpu.read::<f32>(&color.slice()).unwrap();

        let tensor = |name: &str| graph.outputs().iter().find(|o| o.name == name).unwrap().tensor.index();
        let mut expected = Vec::new();
        for step in 0..2 {
            let hidden = images.iter_mut().find(|(name, _)| name == "hidden").unwrap();
            if step == 0 {
                hidden.1.fill(0.0);
            }
            let planes = reference::run(&graph, &weights, lr, &named(&images)).unwrap();
            let hidden = images.iter_mut().find(|(name, _)| name == "hidden").unwrap();
            hidden.1 = planes[tensor("hidden")].values.iter().map(|v| *v as f32).collect();
            expected = planes[tensor("color")].values.clone();
        }
        for (a, e) in actual.iter().zip(&expected) {
            assert!((f64::from(*a) - e).abs() <= tolerance, "{way:?}: {a} {e}");
        }

        let all = way;
        let some = GpuEngineSettings { outputs: Some(&[state]), ..all };
        let engines = [all, some].map(|s| GpuEngine::new(&gpu, &graph, &weights, lr, &s).unwrap());
        assert_eq!(engines.each_ref().map(|engine| engine.outputs().len()), [2, 1]);
        assert!(engines[1].arena_bytes() <= engines[0].arena_bytes());
    }
}

/// Images of half precision, with any arithmetic of the device; also with an odd number of numbers.
#[test]
fn images_may_be_of_half_precision() {
    let Some(gpu) = device(OptionalFeatures::Experimental) else { return };
    for (is_shuffled, [height, width]) in [(true, [8_usize, 6]), (false, [5, 3])] {
        let mut g = GraphBuilder::new("half", 1, Border::Zero);
        let image = if is_shuffled {
            let a = g.input("a", 3, 2);
            let blocks = g.layer("blocks", Op::PixelUnshuffle { factor: 2 }, &[a]);
            g.layer("image", Op::PixelShuffle { factor: 2 }, &[blocks])
        } else {
            let a = g.input("a", 3, 1);
            g.layer("image", Op::Activate(Activation::Relu), &[a])
        };
        g.output("image", image);
        let graph = g.finish().unwrap();
        let weights = Weights::random(&graph, Header::of(&graph, 4), 1);
        let lr = if is_shuffled { [height / 2, width / 2] } else { [height, width] };
        let count = height * width * 3;
        // One more than there are where they are odd, as buffers are of whole words.
        let values: Vec<half::f16> =
            (0..count.next_multiple_of(2)).map(|k| half::f16::from_f32(k as f32 * 0.25)).collect();
        for (way, _) in ways(&gpu) {
            let settings = GpuEngineSettings {
                inputs: &[("a", ImageFormat::HalfPixels)],
                outputs: Some(&[("image", ImageFormat::HalfPixels)]),
                ..way
            };
            let engine = GpuEngine::new(&gpu, &graph, &weights, lr, &settings).unwrap();
            let from = gpu.buffer_with("a", Use::Storage, &values).unwrap();
            let to = gpu.buffer("image", Use::Storage, engine.outputs()[0].bytes).unwrap();
            let bound = engine.bind(&gpu, &[("a", from.slice())], &[("image", to.slice())]).unwrap();
            let mut recorder = gpu.recorder(None);
            bound.record(&mut recorder);
            recorder.submit().unwrap();
            assert_eq!(gpu.read::<half::f16>(&to.slice()).unwrap()[..count], values[..count]);
        }
    }
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let Some(gpu) = device(OptionalFeatures::None) else { return };
    let mut g = GraphBuilder::new("single", 1, Border::Zero);
    let a = g.input("a", 3, 1);
    let b = g.layer("b", Op::Activate(Activation::Relu), &[a]);
    g.output("b", b);
    let graph = g.finish().unwrap();
    let weights = Weights::random(&graph, Header::of(&graph, 4), 1);
    let new = |settings: &GpuEngineSettings<'_>| GpuEngine::new(&gpu, &graph, &weights, [8, 8], settings);
    let settings = GpuEngineSettings::new(Precision::Single);
    let engine = new(&settings).unwrap();
    let [long, short] = [768, 752].map(|bytes| gpu.buffer("image", Use::Storage, bytes).unwrap());
    let bind =
        |from: &[(&str, Slice<'_>)], to: &[(&str, Slice<'_>)]| engine.bind(&gpu, from, to).unwrap_err();
    let error = bind(&[("a", long.slice()), ("c", long.slice())], &[("b", long.slice())]);
    assert!(matches!(error, GpuRunError::Run(RunError::Unknown { name, .. }) if name == "c"));
    let error = bind(&[("a", long.slice())], &[]);
    assert!(matches!(error, GpuRunError::Run(RunError::Missing { name, .. }) if name == "b"));
    let error = bind(&[("a", long.slice())], &[("b", short.slice())]);
    assert!(matches!(error, GpuRunError::Bytes { expected: 768, actual: 752, .. }));
    let blocks = [("a", ImageFormat::Blocks)];
    let error = new(&GpuEngineSettings { outputs: Some(&blocks), ..settings }).unwrap_err();
    assert!(
        matches!(error, GpuRunError::Run(RunError::Unknown { name, expected }) if name == "a" && expected == "b")
    );
    let blocks = [("b", ImageFormat::Blocks)];
    let error = new(&GpuEngineSettings { inputs: &blocks, ..settings }).unwrap_err();
    assert!(
        matches!(error, GpuRunError::Run(RunError::Unknown { name, expected }) if name == "b" && expected == "a")
    );
    // The device was opened without half precision.
    assert!(matches!(new(&GpuEngineSettings::new(Precision::Half)), Err(GpuRunError::Gpu(_))));
}
