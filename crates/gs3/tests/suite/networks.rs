//! Networks in the pipeline: what they start from, what they keep, what they refuse.

use std::sync::Arc;

use gs3::learned::{LearnedSuperSampler, SuperSampleFeatures};
use gs3::neural::model::{Tier, initial_weights, interpolate, super_sample};
use gs3::neural::{Arithmetic, Graph, Header, Weights};
use gs3::raster::{Culling, Outputs, RasterSettings, Rasterizer};
use gs3::reconstruct::Neighbor;
use gs3::scene::{Camera, CameraPath, GBuffer, Image, Planes, demo};
use gs3::{FramePipeline, Kriging, Mode, Networks, PipelineSettings, Refine, ResetReason, Scale};
use gs3_test_support::psnr;

use crate::scene;

const SCALE: u32 = 4;

fn path() -> CameraPath {
    demo::path().resized(160, 96).unwrap()
}

fn header(graph: &Graph) -> Header {
    Header { tier: "fast".to_owned(), ..Header::of(graph, SCALE) }
}

/// Both networks, with weights that `make` makes.
fn networks(make: impl Fn(&Graph, Header) -> Weights) -> Networks {
    let mut networks = Networks::default();
    for graph in [super_sample(4, Tier::Fast).unwrap(), interpolate(4, Tier::Fast).unwrap()] {
        networks.add(make(&graph, header(&graph))).unwrap();
    }
    networks
}

/// Networks that change frames, though not much.
fn random() -> Networks {
    networks(|graph, header| {
        let mut weights = Weights::random(graph, header, 5);
        weights.arrays.values_mut().flat_map(|a| a.values_mut()).for_each(|w| *w *= 0.5);
        weights
    })
}

fn pipeline(networks: &Networks, in_between: u32) -> FramePipeline {
    pipeline_with(Kriging::Off, networks, in_between)
}

fn pipeline_with(kriging: Kriging, networks: &Networks, in_between: u32) -> FramePipeline {
    let settings = PipelineSettings {
        scale: Scale::Fixed(SCALE),
        in_between,
        kriging,
        refine: Refine::Off,
        ..Default::default()
    };
    FramePipeline::with_networks(scene(), settings, networks).unwrap()
}

fn frames(pipeline: &mut FramePipeline, cameras: &[Camera]) -> Vec<Image> {
    let shown = |camera| pipeline.render(camera).unwrap().iter().cloned().collect::<Vec<_>>();
    cameras.iter().flat_map(shown).collect()
}

/// Largest difference of colours.
fn difference(a: &Image, b: &Image) -> f32 {
    let pairs = a.pixels().iter().zip(b.pixels());
    pairs.flat_map(|(a, b)| (0..3).map(move |c| (a[c] - b[c]).abs())).fold(0.0, f32::max)
}

/// Untrained, super sampling averages the current and the previous frame, which have different errors, and
/// interpolation equals interpolation without learning.
#[test]
fn training_starts_above_the_pipeline_without_learning() {
    let path = path();
    let cameras = &path.cameras()[..8];
    let untrained = networks(|graph, header| initial_weights(graph, header, 1));
    let interpolation_only = Networks { super_sample: None, ..untrained.clone() };
    let expected = frames(&mut pipeline(&Networks::default(), 1), cameras);
    let actual = frames(&mut pipeline(&interpolation_only, 1), cameras);
    for (k, (a, b)) in expected.iter().zip(&actual).enumerate() {
        // Pixels of in-between frames are blended after they were gathered, not while: sums round differently.
        let limit = if k % 2 == 1 { 1e-6 } else { 0.0 };
        assert!(difference(a, b) <= limit, "frame {k}: {}", difference(a, b));
    }
    // With networks, frames are kriged independent of the settings.
    let kriged = frames(&mut pipeline_with(Kriging::Coarse, &Networks::default(), 1), cameras);
    let actual = frames(&mut pipeline(&untrained, 1), cameras);
    assert!(actual[0] == kriged[0] && actual[0] != expected[0], "there is no previous frame yet");
    let settings = PipelineSettings { mode: Mode::Native, refine: Refine::Off, ..Default::default() };
    let truth = frames(&mut FramePipeline::new(scene(), settings).unwrap(), cameras);
    // Rendered frames with a frame before; the in-between frames lie between them.
    let error = |images: &[Image]| -> f32 {
        let rendered = images.iter().step_by(2).zip(&truth).skip(1);
        let pairs = rendered.flat_map(|(image, truth)| image.pixels().iter().zip(truth.pixels()));
        pairs.map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>()).sum()
    };
    let (with, without) = (error(&actual), error(&kriged));
    assert!(with < 0.95 * without, "squared error {with}, without the previous frame {without}");
}

#[test]
fn how_finely_frames_are_kriged_follows_from_the_tier() {
    let path = path();
    let cameras = &path.cameras()[..1];
    // Without a frame before, the network is not heard yet.
    let first =
        |kriging, networks: &Networks| frames(&mut pipeline_with(kriging, networks, 1), cameras).remove(0);
    let kriged = [Kriging::Coarse, Kriging::On, Kriging::Fine].map(|way| first(way, &Networks::default()));
    assert!(kriged[0] != kriged[1] && kriged[1] != kriged[2]);
    for (tier, expected) in [Tier::Fast, Tier::Balanced, Tier::High].into_iter().zip(&kriged) {
        let graph = super_sample(4, tier).unwrap();
        let header = Header { tier: tier.name().to_owned(), ..header(&graph) };
        let mut networks = Networks::default();
        networks.add(initial_weights(&graph, header, 1)).unwrap();
        assert!(first(Kriging::Off, &networks) == *expected, "below tier {}", tier.name());
        assert!(first(Kriging::Fine, &networks) == kriged[2], "who asks for more gets it");
    }
}

#[test]
fn a_resting_camera_keeps_its_exact_image_whatever_was_learned() {
    let camera = path().cameras()[7];
    let cameras = vec![camera; 17];
    let (exact, refined) = (
        frames(&mut pipeline(&Networks::default(), 1), &cameras),
        frames(&mut pipeline(&random(), 1), &cameras),
    );
    assert!(difference(&exact[0], &refined[0]) > 1e-3, "the first frame is refined");
    // The last frame, and the one between it and the one before.
    for k in [31, 32] {
        let departs = difference(&exact[k], &refined[k]);
        assert!(departs < 1e-6, "frame {k}: {departs}");
    }
}

/// Of a previous frame seen from the same place, the samples say how they differ from it at their pixels, as far as
/// it is visible there; of none, nothing.
#[test]
fn samples_tell_how_the_previous_frame_errs() {
    let camera = path().cameras()[0];
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let settings =
        RasterSettings { jitter: [0.375, -0.125], dilation: 0.02, ..RasterSettings::new(Outputs::GBuffer) };
    let mut gbuffer = GBuffer::default();
    let mut rasterizer = Rasterizer::new(scene(), Culling::default());
    rasterizer.rasterize(&camera.low_resolution(SCALE), &settings, &mut gbuffer).unwrap();
    let mut image = Image::default();
    image.resize(width, height);
    let ramp = |x: usize, y: usize| [x as f32 / width as f32, y as f32 / height as f32, 0.5];
    for (k, pixel) in image.pixels_mut().iter_mut().enumerate() {
        let [r, g, b] = ramp(k % width, k / width);
        *pixel = [r, g, b, 0.1];
    }
    let now = Neighbor { camera: &camera, image: &image, gbuffer: &gbuffer, gradients: None };
    let innovation = vec![[0.0; 4]; gbuffer.width() * gbuffer.height()];
    let mut features = SuperSampleFeatures::new(SCALE).unwrap();
    let mut of = |previous| {
        features.set(now, &innovation, previous).unwrap();
        let named = features.named(&image);
        let (_, values) = named.iter().find(|(name, _)| *name == "previous_innovation").unwrap();
        values.as_chunks::<3>().0.to_vec()
    };
    assert!(of(None).iter().all(|values| *values == [0.0; 3]));
    let mut visible = 0;
    for (k, actual) in of(Some(now)).iter().enumerate() {
        let (i, j) = (k % gbuffer.width(), k / gbuffer.width());
        // The sample lies on the centre of the last of its block's pixels along x, of the second along y.
        let [r, g, b] = ramp(4 * i + 3, 4 * j + 1);
        let [dr, dg, db] = [(0, r), (1, g), (2, b)].map(|(c, v)| gbuffer.color.plane(c)[k] - v);
        let length = |[a, b, c]: [f32; 3]| (a * a + b * b + c * c).sqrt();
        let visibility = length(*actual) / length([dr, dg, db]);
        for (actual, expected) in actual.iter().zip([dr, dg, db]) {
            assert!((actual - visibility * expected).abs() < 1e-4, "({i}, {j}): {actual}, {expected}");
        }
        assert!(visibility < 1.001, "({i}, {j}): {visibility}");
        visible += usize::from(visibility > 0.9);
    }
    assert!(visible * 4 > gbuffer.width() * gbuffer.height(), "{visible} samples");
}

/// In bf16, where the machine has it, frames are nearly the same. (Rows of less than 48 LR pixels stay in f32.)
#[test]
fn arithmetic_is_a_choice() {
    let path = demo::path().resized(320, 64).unwrap();
    let rounded = Networks { arithmetic: Arithmetic::Bf16, ..random() };
    let exact = Networks { arithmetic: Arithmetic::F32, ..rounded.clone() };
    let [exact, rounded] =
        [exact, rounded].map(|networks| frames(&mut pipeline(&networks, 1), &path.cameras()[..4]));
    let most = exact.iter().zip(&rounded).map(|(a, b)| difference(a, b)).fold(0.0, f32::max);
    assert!(most < 2e-2, "{most}");
    #[cfg(target_arch = "x86_64")]
    assert_eq!(most > 0.0, std::is_x86_feature_detected!("avx512bf16"), "{most}");
}

#[test]
fn the_state_is_carried_on_and_forgotten_with_the_history() {
    let path = path();
    let random = random();
    let fresh = frames(&mut pipeline(&random, 1), &path.cameras()[3..4]);
    let mut moving = pipeline(&random, 1);
    let _ = frames(&mut moving, &path.cameras()[..3]);
    moving.reset(ResetReason::SceneChange);
    assert!(frames(&mut moving, &path.cameras()[3..4]).last() == fresh.last());
    // Two frames on, with and without the state of the first.
    let settings = PipelineSettings { mode: Mode::SuperSample, refine: Refine::Off, ..Default::default() };
    let weights = random.super_sample.clone().unwrap();
    let mut forgetful = (*weights).clone();
    // z = σ(…) of the gate that takes in the new state: always 1.
    forgetful.arrays.get_mut("recurrent.update.bias").unwrap().values_mut().fill(100.0);
    forgetful.arrays.get_mut("recurrent.candidate.weight").unwrap().values_mut().fill(0.0);
    let last = |weights: Arc<Weights>| {
        let networks = Networks { super_sample: Some(weights), ..Default::default() };
        let mut pipeline = FramePipeline::with_networks(scene(), settings, &networks).unwrap();
        frames(&mut pipeline, &path.cameras()[..2]).pop().unwrap()
    };
    assert!(last(weights) != last(Arc::new(forgetful)));
}

/// Sizes that are no whole number of blocks: the last row and column are repeated while the network runs.
#[test]
fn any_size_is_refined() {
    for (width, height) in [(97, 55), (3, 2), (160, 90)] {
        let path = demo::path().resized(width, height).unwrap();
        let shown = frames(&mut pipeline(&random(), 1), &path.cameras()[..3]);
        assert_eq!(shown.len(), 5);
        for image in &shown {
            assert_eq!((image.width(), image.height()), (width as usize, height as usize));
            assert!(image.pixels().iter().flatten().all(|v| v.is_finite()));
        }
    }
}

/// The inverse of a denormal number is none: it would spread through the state, and stay.
#[test]
fn depths_as_near_as_can_be_spread_nothing() {
    let camera = path().cameras()[0];
    let mut learned =
        LearnedSuperSampler::new(random().super_sample.unwrap(), SCALE, Arithmetic::F32).unwrap();
    let (mut gbuffer, image) = (GBuffer::zeroed(40, 24), Image::new(160, 96));
    let innovation = vec![[0.0; 4]; 40 * 24];
    let depth = &mut gbuffer.geometry.as_mut().unwrap().depth_median;
    depth.plane_mut(0).fill(3.0);
    depth.plane_mut(0)[100] = 1e-40;
    let (mut out, mut last) = (Image::default(), Image::default());
    for k in 0..3 {
        let before = Neighbor { camera: &camera, image: &last, gbuffer: &gbuffer, gradients: None };
        let now = Neighbor { camera: &camera, image: &image, gbuffer: &gbuffer, gradients: None };
        learned.refine(now, &innovation, (k > 0).then_some(before), &mut out).unwrap();
        assert!(out.pixels().as_flattened().iter().all(|v| v.is_finite()), "{k}");
        std::mem::swap(&mut out, &mut last);
    }
}

/// G-buffers of other renderers: what networks read besides is checked before anything is fed to them.
#[test]
fn frames_that_networks_cannot_read_are_typed_errors() {
    let camera = path().cameras()[0];
    let good = GBuffer::zeroed(40, 24);
    let mut image = Image::new(160, 96);
    let weights = random().super_sample.unwrap();
    let mut learned = LearnedSuperSampler::new(weights, SCALE, Arithmetic::F32).unwrap();
    let innovation = vec![[0.0; 4]; 40 * 24];
    let mut refine = |gbuffer: &GBuffer, image: &Image| {
        let now = Neighbor { camera: &camera, image, gbuffer, gradients: None };
        learned.refine(now, &innovation, None, &mut Image::default()).err().map(|error| error.to_string())
    };
    assert_eq!(refine(&good, &image), None);
    let mut wrong = good.clone();
    wrong.alpha = Planes::default();
    let expected = "G-buffer alpha: expected 40x24 pixels, found 0x0";
    assert_eq!(refine(&wrong, &image).as_deref(), Some(expected));
    let mut wrong = good.clone();
    wrong.geometry.as_mut().unwrap().normal.plane_mut(2)[100] = f32::NAN;
    let expected = "G-buffer normals: expected finite numbers, found NaN or infinity";
    assert_eq!(refine(&wrong, &image).as_deref(), Some(expected));
    let mut wrong = good.clone();
    wrong.geometry.as_mut().unwrap().depth_median = Planes::new(39, 24);
    let expected = "G-buffer depth: expected 40x24 pixels, found 39x24";
    assert_eq!(refine(&wrong, &image).as_deref(), Some(expected));
    image = Image::new(0, 0);
    assert_eq!(refine(&good, &image).as_deref(), Some("image: expected 160x96 pixels, found 0x0"));
}

#[test]
fn two_and_three_frames_are_made_between_rendered_ones() {
    let path = path();
    for networks in [Networks::default(), random()] {
        for in_between in [2, 3] {
            let shown = frames(&mut pipeline(&networks, in_between), &path.cameras()[..3]);
            assert_eq!(shown.len(), 1 + 2 * (in_between as usize + 1));
            assert!(shown.iter().flat_map(|image| image.pixels()).flatten().all(|v| v.is_finite()));
            assert!(
                shown.windows(2).all(|pair| difference(&pair[0], &pair[1]) > 1e-3),
                "each moment its own"
            );
        }
    }
    let mut three = pipeline(&Networks::default(), 3);
    let error = three.render_with_poses(&path.cameras()[0], &path.cameras()[..2]).unwrap_err().to_string();
    assert_eq!(error, "cameras between two frames: expected none or 3, found 2");
    let settings = PipelineSettings { in_between: 4, refine: Refine::Off, ..Default::default() };
    let error = FramePipeline::new(scene(), settings).err().unwrap().to_string();
    assert_eq!(error, "in-between frames: expected 1 to 3 frames for each rendered one, found 4");
}

#[test]
fn networks_keep_their_scale_for_frames_of_all_sizes() {
    let large = demo::path().resized(2720, 1360).unwrap().cameras()[0];
    for (scale, expected) in [(Scale::Auto, [2, 4]), (Scale::Fixed(2), [2, 2])] {
        let shipped = [2, 4].map(|scale| Networks::shipped(scale, Tier::Balanced).unwrap());
        for (networks, expected) in shipped.iter().zip(expected) {
            assert_eq!(scale.with(networks).at(large.size()), expected);
        }
        // Modes without networks are as coarse, so that they can be compared.
        for mode in [Mode::Bicubic, Mode::SuperSample, Mode::Full] {
            let settings = PipelineSettings { mode, scale, ..Default::default() };
            let pipeline = FramePipeline::with_networks(scene(), settings, &shipped[0]).unwrap();
            assert_eq!(pipeline.scale_of(&large), 2, "{mode:?}");
        }
    }
    let alone = FramePipeline::new(scene(), PipelineSettings::default()).unwrap();
    assert_eq!(alone.scale_of(&large), 6);
}

#[test]
fn weights_that_do_not_fit_are_refused() {
    let graph = super_sample(4, Tier::Fast).unwrap();
    let weights = initial_weights(&graph, header(&graph), 1);
    let refusal = |weights: Weights| {
        let networks = Networks { super_sample: Some(Arc::new(weights)), ..Default::default() };
        let settings = PipelineSettings { scale: Scale::Fixed(4), ..Default::default() };
        FramePipeline::with_networks(scene(), settings, &networks).err().unwrap().to_string()
    };
    let with = |change: fn(&mut Header)| {
        let mut weights = weights.clone();
        change(&mut weights.header);
        refusal(weights)
    };
    assert_eq!(with(|h| h.scale = 2), "weights: expected those for scale 4, found those for scale 2");
    assert_eq!(
        with(|h| h.network = "interpolate".to_owned()),
        "weights: expected those of super_sample, found those of interpolate"
    );
    assert_eq!(
        with(|h| h.tier = "best".to_owned()),
        "header, tier: expected one of fast, balanced, high, found best"
    );
    assert!(with(|h| h.version = 1).starts_with("header, version: expected"));
    assert!(with(|h| h.tier = "high".to_owned()).contains("history.conv.weight: expected f32"));
    let mut twice = Networks::default();
    twice.add(weights.clone()).unwrap();
    let error = twice.add(weights).unwrap_err().to_string();
    assert_eq!(error, "weights: expected at most one file for super_sample, found two");
}

/// The weights that come with the library belong to a network of this version, and gain on the pipeline without
/// learning, on a scene that is generated and frames that are not among their training clips.
#[test]
fn shipped_weights_gain() {
    let path = demo::path().resized(480, 272).unwrap();
    let (cameras, scene) = (&path.cameras()[40..50], scene());
    let pipeline = |mode, scale, networks: &Networks| {
        let settings =
            PipelineSettings { mode, scale: Scale::Fixed(scale), refine: Refine::Off, ..Default::default() };
        let mut pipeline = FramePipeline::with_networks(scene.clone(), settings, networks).unwrap();
        frames(&mut pipeline, if mode == Mode::Native { &cameras[9..] } else { cameras }).pop().unwrap()
    };
    let truth = pipeline(Mode::Native, SCALE, &Networks::default());
    for (scale, tier) in [(4, Tier::Fast), (4, Tier::Balanced), (4, Tier::High), (2, Tier::Balanced)] {
        let analytic = psnr(&pipeline(Mode::SuperSample, scale, &Networks::default()), &truth);
        let shipped = Networks::shipped(scale, tier).unwrap();
        let header = &shipped.super_sample.as_ref().unwrap().header;
        assert_eq!((header.scale, header.tier.as_str()), (scale, tier.name()));
        let learned = psnr(&pipeline(Mode::SuperSample, scale, &shipped), &truth);
        let what = format!("x{scale}: analytic {analytic:.2} dB, {} {learned:.2} dB", tier.name());
        println!("{what}");
        assert!(learned > analytic + 0.2, "{what}");
    }
    // In-between frames, on the same frames on both sides: means of the last four.
    let middles: Vec<Camera> = (46..50).map(|k| path.at(f64::from(k) - 0.5)).collect();
    let unrefined = PipelineSettings { refine: Refine::Off, in_between: 1, ..Default::default() };
    let native = PipelineSettings { mode: Mode::Native, ..unrefined };
    let mut native = FramePipeline::new(scene.clone(), native).unwrap();
    let truths = frames(&mut native, &middles);
    for tier in [Tier::Fast, Tier::Balanced] {
        let shipped = Networks::shipped(4, tier).unwrap();
        let header = &shipped.interpolate.as_ref().unwrap().header;
        assert_eq!((header.scale, header.tier.as_str()), (4, tier.name()));
        let between = |networks: &Networks| {
            let mut pipeline = FramePipeline::with_networks(scene.clone(), unrefined, networks).unwrap();
            let (before, last) = cameras.split_at(cameras.len() - middles.len());
            before.iter().for_each(|camera| _ = pipeline.render(camera).unwrap());
            let shown = last.iter().zip(&middles).zip(&truths).map(|((camera, middle), truth)| {
                let shown = pipeline.render_with_poses(camera, std::slice::from_ref(middle)).unwrap();
                psnr(shown.in_between[0].unwrap(), truth)
            });
            shown.sum::<f64>() / middles.len() as f64
        };
        let warped = between(&Networks { interpolate: None, ..shipped.clone() });
        let learned = between(&shipped);
        let what = format!("between: warped {warped:.3} dB, {} {learned:.3} dB", tier.name());
        println!("{what}");
        assert!(learned > warped + 0.02, "{what}");
    }
    let error = Networks::shipped(3, Tier::High).err().unwrap().to_string();
    assert_eq!(
        error,
        "tier high at scale 3: expected one of balanced ×2, fast ×4, balanced ×4, high ×4, which come with this version"
    );
}
