//! Whole frames on a GPU against the CPU's frames, on any adapter at hand.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use gs3::compute::{Allocations, Gpu, GpuSettings, OptionalFeatures, device_for_tests, skip_without_gpu};
use gs3::neural::model::{Tier, interpolate};
use gs3::neural::{Arithmetic, Header, Weights};
use gs3::reconstruct::{Interpolator, Kriging, Neighbor, SuperSampler};
use gs3::scene::camera_path::{CameraPath, pose_between};
use gs3::scene::{Camera, GBuffer, Image, Scene, capture, demo};
use gs3::{FramePipeline, Mode, Networks, PipelineError, PipelineSettings, Refine, ResetReason, Stage};
use gs3_test_support::{largest_difference_but, part_of_demo, psnr};

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");

/// The adapter of this machine, or a word that there is none.
pub fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| opened(OptionalFeatures::All)).clone()
}

fn opened(features: OptionalFeatures) -> Option<Gpu> {
    device_for_tests(&GpuSettings { features, ..GpuSettings::default() })
}

/// The same, and it without subgroups and half precision.
fn gpu_and_its_least() -> Option<[Gpu; 2]> {
    Some([gpu()?, opened(OptionalFeatures::None)?])
}

/// A part of the demo: devices in software take most of a frame for projection.
fn demo_part() -> Arc<Scene> {
    static PART: OnceLock<Arc<Scene>> = OnceLock::new();
    Arc::clone(PART.get_or_init(|| Arc::new(part_of_demo(8))))
}

/// The demo, and a trained scene where it is at hand.
fn scenes(width: u32, height: u32) -> Vec<(&'static str, Arc<Scene>, CameraPath)> {
    let demo = ("demo", demo_part(), demo::path().resized(width, height).unwrap());
    let file = Path::new(SHARED).join("scenes/playbot");
    let path = Path::new(SHARED).join("paths/playbot_orbit.json");
    if !(file.exists() && path.exists()) {
        eprintln!("skipped: {} is absent", file.display());
        return vec![demo];
    }
    let path = capture::load(&path).unwrap().resized(width, height).unwrap();
    vec![demo, ("playbot", Arc::new(gs3::open(&file).unwrap()), path)]
}

fn pipeline(gpu: Option<&Gpu>, scene: &Arc<Scene>, mode: Mode, in_between: u32) -> FramePipeline {
    let settings = PipelineSettings { mode, in_between, refine: Refine::Off, ..Default::default() };
    let mut pipeline = FramePipeline::new(Arc::clone(scene), settings).unwrap();
    if let Some(gpu) = gpu {
        pipeline.render_on(gpu).unwrap();
    }
    pipeline
}

/// The same frames, reconstructed by the processor from the device's G-buffers.
struct Reference {
    sampler: SuperSampler,
    interpolator: Interpolator,
    last: Option<(Camera, GBuffer, Image)>,
}

impl Reference {
    fn render(&mut self, camera: &Camera, gbuffer: &GBuffer, times: &[f64]) -> Vec<Image> {
        let mut image = Image::default();
        self.sampler.super_sample(camera, gbuffer, &mut image).unwrap();
        let mut shown = Vec::new();
        if let Some((last, last_gbuffer, last_image)) = &self.last {
            for t in times {
                let before =
                    Neighbor { camera: last, image: last_image, gbuffer: last_gbuffer, gradients: None };
                let after = Neighbor { camera, image: &image, gbuffer, gradients: None };
                let at = pose_between(last, camera, *t);
                let mut between = Image::default();
                self.interpolator.interpolate(before, after, *t as f32, &at, &mut between).unwrap();
                shown.push(between);
            }
        }
        shown.push(image.clone());
        self.last = Some((*camera, gbuffer.clone(), image));
        shown
    }
}

/// Of the same G-buffers, every frame shown is the CPU's but for rounding, over more frames than the history holds.
#[test]
fn frames_of_a_moving_camera_match_the_cpu() {
    let Some(gpu) = gpu() else { return };
    for (name, scene, path) in scenes(298, 170) {
        let mut frames = pipeline(Some(&gpu), &scene, Mode::Full, 2);
        let mut reference = Reference {
            sampler: SuperSampler::new(4, Kriging::Off).unwrap(),
            interpolator: Interpolator::new(4).unwrap(),
            last: None,
        };
        let (mut rendered, mut between) = (f64::INFINITY, f64::INFINITY);
        for camera in &path.cameras()[..18] {
            let shown: Vec<Image> = frames.render(camera).unwrap().iter().cloned().collect();
            frames.fetch_gbuffer().unwrap();
            let expected = reference.render(camera, frames.gbuffer(), &[1.0 / 3.0, 2.0 / 3.0]);
            assert_eq!(shown.len(), expected.len());
            let last = expected.len() - 1;
            rendered = rendered.min(psnr(&shown[last], &expected[last]));
            let others = shown.iter().zip(&expected).take(last);
            between = others.fold(between, |least, (a, e)| least.min(psnr(a, e)));
        }
        let what = format!("{name}: rendered {rendered:.1} dB at worst, between {between:.1} dB");
        eprintln!("{what}");
        assert!(rendered >= 60.0 && between >= 60.0, "{what}");
        let times = frames.times();
        assert!(
            Stage::ALL.iter().all(|stage| times.get(*stage).is_some() || *stage == Stage::Refine),
            "{times:?}"
        );
    }
}

/// The share of the pixels that may lie on a step of the formulas: a visibility or a rigid patch that rounding decides.
/// (Empirical: with Mesa's lavapipe none is needed.)
const FLIPPED: f64 = 1e-3;

/// All of it, rasterization included: what the packed scene's rounding leaves.
#[test]
fn whole_frames_match_the_cpu_pipeline() {
    let Some(gpu) = gpu() else { return };
    for (name, scene, path) in scenes(256, 144) {
        let [mut on_gpu, mut on_cpu] = [Some(&gpu), None].map(|gpu| pipeline(gpu, &scene, Mode::Full, 1));
        let [mut wide_on_gpu, mut wide_on_cpu] = [Some(&gpu), None].map(|gpu| {
            let settings = PipelineSettings { overscan: true, refine: Refine::Off, ..Default::default() };
            let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings).unwrap();
            gpu.map_or(Ok(()), |gpu| pipeline.render_on(gpu)).unwrap();
            pipeline
        });
        let (mut worst_wide, mut effect) = (f64::INFINITY, f64::INFINITY);
        let (mut worst, mut largest) = (f64::INFINITY, 0.0_f32);
        for camera in &path.cameras()[..5] {
            let expected: Vec<Image> = on_cpu.render(camera).unwrap().iter().cloned().collect();
            let shown = on_gpu.render(camera).unwrap();
            assert_eq!(shown.iter().count(), expected.len());
            worst = shown.iter().zip(&expected).fold(worst, |least, (a, e)| least.min(psnr(a, e)));
            largest = shown
                .iter()
                .zip(&expected)
                .fold(largest, |most, (a, e)| most.max(largest_difference_but(a, e, FLIPPED)));
            let wide: Vec<Image> = wide_on_cpu.render(camera).unwrap().iter().cloned().collect();
            let shown = wide_on_gpu.render(camera).unwrap();
            worst_wide = shown.iter().zip(&wide).fold(worst_wide, |least, (a, e)| least.min(psnr(a, e)));
            effect = wide.iter().zip(&expected).fold(effect, |least, (a, e)| least.min(psnr(a, e)));
        }
        let what = format!(
            "{name}: {worst:.1} dB at worst, {largest} but for flips, with overscan {worst_wide:.1} dB, which changes {effect:.1} dB"
        );
        eprintln!("{what}");
        // A step of 8-bit displays for single pixels; for the mean a quarter of such a step, 60 dB. With Mesa's lavapipe
        // 75.9 dB and 0.0005 were found.
        assert!(worst >= 60.0 && worst_wide >= 60.0 && effect < worst_wide, "{what}");
        assert!(largest <= 1.0 / 255.0, "{what}");
    }
}

#[test]
fn a_resting_camera_becomes_native() {
    let Some(gpu) = gpu() else { return };
    let (_, scene, path) = scenes(256, 144).remove(0);
    let camera = path.cameras()[17];
    let native = pipeline(None, &scene, Mode::Native, 1).render(&camera).unwrap().current.clone();
    let mut resting = pipeline(Some(&gpu), &scene, Mode::SuperSample, 1);
    let first = psnr(resting.render(&camera).unwrap().current, &native);
    for _ in 1..16 {
        resting.render(&camera).unwrap();
    }
    let last = psnr(resting.render(&camera).unwrap().current, &native);
    assert!(last >= 50.0 && last > first + 15.0, "{first} dB, then {last} dB");
}

#[test]
fn history_ends_at_cuts_resets_new_sizes_and_new_scenes() {
    let Some(gpu) = gpu() else { return };
    let (_, scene, path) = scenes(256, 144).remove(0);
    let on_gpu = |mode| pipeline(Some(&gpu), &scene, mode, 1);
    let fresh = |camera: &Camera| on_gpu(Mode::SuperSample).render(camera).unwrap().current.clone();
    let (near, next) = (path.cameras()[0], path.cameras()[1]);
    let turned = {
        let pose = glam::DAffine3::from_rotation_y(std::f64::consts::PI) * near.view_from_world();
        Camera::new(pose, near.intrinsics()).unwrap()
    };
    let mut p = on_gpu(Mode::Full);
    p.render(&near).unwrap();
    let shown = p.render(&turned).unwrap();
    assert!(shown.current == &fresh(&turned));
    assert!(shown.in_between[0] == Some(&fresh(&near)), "the previous frame is held over a cut");

    let with_history = |reset: Option<ResetReason>| {
        let mut p = on_gpu(Mode::SuperSample);
        p.render(&near).unwrap();
        if let Some(reason) = reset {
            p.reset(reason);
        }
        p.render(&next).unwrap().current.clone()
    };
    let anew = fresh(&next);
    assert!(with_history(None) != anew, "a small motion keeps the history");
    assert!(with_history(Some(ResetReason::SceneChange)) == anew);

    let larger = next.resized(261, 147).unwrap();
    let mut p = on_gpu(Mode::Full);
    p.render(&near).unwrap();
    let shown = p.render(&larger).unwrap();
    assert!(shown.in_between == [None; 3] && shown.current == &fresh(&larger));
    // A frame of a larger scale.
    let large = next.resized(2720, 1360).unwrap();
    let shown = p.render(&large).unwrap();
    assert!(shown.in_between == [None; 3] && shown.current == &fresh(&large));
    assert_eq!(p.scale(), 6);
    // And back: what was there before the larger frames is no history either.
    let shown = p.render(&next).unwrap();
    assert!(shown.in_between == [None; 3] && shown.current == &anew);

    p.render(&near).unwrap();
    p.set_scene(Arc::clone(&scene)).unwrap();
    assert!(p.render(&next).unwrap().current == &anew);
}

/// With the network that comes with the library, over more frames than its first: its hidden state and the frame
/// before reach it as on the CPU, in half precision and in single. Other sizes than whole blocks go by the CPU.
#[test]
fn the_network_refines_as_on_the_cpu() {
    let Some(gpus) = gpu_and_its_least() else { return };
    let networks = Networks::shipped(4, Tier::Balanced).unwrap();
    for (name, scene, path) in scenes(256, 144) {
        let settings =
            PipelineSettings { mode: Mode::SuperSample, refine: Refine::Off, ..Default::default() };
        let make = || FramePipeline::with_networks(Arc::clone(&scene), settings, &networks).unwrap();
        let mut on_cpu = make();
        let mut analytic = pipeline(Some(&gpus[0]), &scene, Mode::SuperSample, 1);
        let mut effect = 0.0;
        let cameras = &path.cameras()[..6];
        let expected: Vec<Image> =
            cameras.iter().map(|camera| on_cpu.render(camera).unwrap().current.clone()).collect();
        for (camera, expected) in cameras.iter().zip(&expected) {
            effect = psnr(analytic.render(camera).unwrap().current, expected);
        }
        let odd = path.cameras()[6].resized(255, 144).unwrap();
        let expected_odd = on_cpu.render(&odd).unwrap().current.clone();
        for gpu in &gpus {
            let mut on_gpu = make();
            on_gpu.render_on(gpu).unwrap();
            assert!(on_gpu.is_on_device(&cameras[0]) && !on_gpu.is_on_device(&odd));
            let mut worst = f64::INFINITY;
            for (camera, expected) in cameras.iter().zip(&expected) {
                worst = worst.min(psnr(on_gpu.render(camera).unwrap().current, expected));
            }
            let f16 = gpu.capabilities().shader_f16;
            eprintln!("{name}, f16 {f16:?}: {worst:.1} dB at worst, without the network {effect:.1} dB");
            assert!(worst >= 55.0 && effect < worst - 6.0, "{name}: {worst:.1} dB, without {effect:.1} dB");
            assert!(psnr(on_gpu.render(&odd).unwrap().current, &expected_odd) > 50.0);
        }
    }
}

/// Random weights change much: features, both neighbours, their share and the hidden state reach the network as on
/// the CPU, over in-between frames that follow each other within a frame and across frames, and after a reset.
#[test]
fn frames_between_are_refined_as_on_the_cpu() {
    let Some([gpu, least]) = gpu_and_its_least() else { return };
    let graph = interpolate(4, Tier::Fast).unwrap();
    let header = Header { tier: "fast".to_owned(), ..Header::of(&graph, 4) };
    // Where the state counts most, in the second half of what the residual is made from, it is seen to be right. Of a
    // trained scene, packed, a few depths differ, and motion with them: there it counts as usual.
    let networks = |state: f32| {
        let mut weights = Weights::random(&graph, header.clone(), 5);
        weights.arrays.values_mut().flat_map(|a| a.values_mut()).for_each(|w| *w *= 0.5);
        let (features, inputs) =
            (Tier::Fast.channels(), Tier::Fast.channels() + Tier::Fast.hidden_channels());
        let head = weights.arrays.get_mut("head.color.weight").unwrap();
        head.values_mut().chunks_mut(inputs).flat_map(|row| &mut row[features..]).for_each(|w| *w *= state);
        // Processors with AMX or AVX-512 BF16 would round to bf16, which devices do not.
        Networks { interpolate: Some(Arc::new(weights)), arithmetic: Arithmetic::F32, ..Networks::default() }
    };
    for (name, scene, path) in scenes(256, 144) {
        let (state, floor) = if name == "demo" { (16.0, 60.0) } else { (1.0, 48.0) };
        let networks = networks(state);
        for in_between in [1, 2] {
            let settings =
                PipelineSettings { mode: Mode::Full, in_between, refine: Refine::Off, ..Default::default() };
            let make = || FramePipeline::with_networks(Arc::clone(&scene), settings, &networks).unwrap();
            let (mut on_cpu, mut on_gpu) = (make(), make());
            // Half precision of one in-between frame, single of two.
            on_gpu.render_on(if in_between == 1 { &gpu } else { &least }).unwrap();
            assert!(on_gpu.is_on_device(&path.cameras()[0]));
            let mut warped = pipeline(None, &scene, Mode::Full, in_between);
            let (mut worst, mut effect) = (f64::INFINITY, 0.0_f64);
            for (k, camera) in path.cameras()[..7].iter().enumerate() {
                if k == 4 {
                    on_cpu.reset(ResetReason::SceneChange);
                    on_gpu.reset(ResetReason::SceneChange);
                }
                let expected: Vec<Image> = on_cpu.render(camera).unwrap().iter().cloned().collect();
                let shown = on_gpu.render(camera).unwrap();
                assert_eq!(shown.iter().count(), expected.len());
                worst = shown.iter().zip(&expected).fold(worst, |least, (a, e)| least.min(psnr(a, e)));
                let without: Vec<Image> = warped.render(camera).unwrap().iter().cloned().collect();
                if k == 3 {
                    effect = psnr(&without[0], &expected[0]);
                }
            }
            let what = format!(
                "{name}, {in_between} between: {worst:.1} dB at worst, without the network {effect:.1} dB"
            );
            eprintln!("{what}");
            assert!(worst >= floor && effect < worst - 10.0, "{what}");
        }
    }
}

/// After its first frames a camera's frames make nothing on the device, and each is one submission, with networks and a
/// margin, too: kernels are compiled and bound, buffers made, before that. Native frames, f32, are read back by
/// another.
#[test]
fn later_frames_make_nothing_and_are_one_submission_each() {
    let Some(gpu) = opened(OptionalFeatures::All) else { return };
    let scene = demo_part();
    let path = demo::path().resized(160, 88).unwrap();
    let networks = Networks::shipped(4, Tier::Fast).unwrap();
    for (mode, refine, submissions) in [
        (Mode::Native, Refine::Off, 2),
        (Mode::SuperSample, Refine::Off, 1),
        (Mode::Full, Refine::Off, 1),
        (Mode::Full, Refine::Auto, 1),
    ] {
        let settings = PipelineSettings { mode, refine, ..Default::default() };
        // Frames of a network have no exact blocks.
        let networks = if refine == Refine::Off { networks.clone() } else { Networks::default() };
        let mut frames = FramePipeline::with_networks(Arc::clone(&scene), settings, &networks).unwrap();
        frames.render_on(&gpu).unwrap();
        let mut before = gpu.allocations();
        for (k, camera) in path.cameras()[..20].iter().enumerate() {
            frames.render(camera).unwrap();
            let made = gpu.allocations();
            if k >= 4 {
                let expected = Allocations { submissions: before.submissions + submissions, ..before };
                assert_eq!(made, expected, "{mode:?}, {refine}, frame {k}");
            }
            before = made;
        }
    }
}

/// What a program shows from device memory is what comes back otherwise, and does not come back. The device is its own,
/// opened for its own needs.
#[test]
fn frames_may_stay_on_the_device_of_the_program() {
    use gs3::compute::wgpu;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let Some(adapter) = adapters.into_iter().next() else {
        return skip_without_gpu("the instance lists none");
    };
    let (device, queue) =
        pollster::block_on(adapter.request_device(&Gpu::wanted(&adapter, OptionalFeatures::All))).unwrap();
    let gpu = Gpu::of(&adapter, device, queue).unwrap();
    let scene = demo_part();
    let path = demo::path().resized(160, 88).unwrap();
    let networks = Networks::shipped(4, Tier::Fast).unwrap();
    let settings =
        PipelineSettings { mode: Mode::Full, refine: Refine::Off, in_between: 1, ..Default::default() };
    let pipeline = || FramePipeline::with_networks(Arc::clone(&scene), settings, &networks).unwrap();
    let [mut here, mut there] = [pipeline(), pipeline()];
    let refused = there.render_to_device(&path.cameras()[0], &[]).unwrap_err();
    assert!(matches!(refused, PipelineError::NotOnDevice), "{refused}");
    for pipeline in [&mut here, &mut there] {
        pipeline.render_on(&gpu).unwrap();
    }
    let read = |image: &gs3::reconstruct::gpu::GpuImage| {
        let mut out = Image::default();
        image.read(&gpu, &mut out).unwrap();
        out
    };
    // A cut in the middle, and a frame that comes back in between.
    for k in [0, 1, 2, 30, 31, 32] {
        let camera = &path.cameras()[k];
        if k == 30 {
            for pipeline in [&mut here, &mut there] {
                pipeline.reset(ResetReason::CameraCut);
            }
        }
        let presented = here.render(camera).unwrap();
        if k == 2 {
            assert_eq!(there.render(camera).unwrap().current, presented.current);
            continue;
        }
        let stays = there.render_to_device(camera, &[]).unwrap();
        let is_first = [0, 30].contains(&k);
        assert_eq!(stays.in_between.len(), usize::from(!is_first), "{k}");
        assert!(read(stays.current) == *presented.current, "{k}");
        if let [between] = stays.in_between {
            assert!(read(between) == *presented.in_between[0].unwrap(), "{k}");
        }
        let reset = match k {
            0 => Some(ResetReason::FirstFrame),
            30 => Some(ResetReason::CameraCut),
            _ => None,
        };
        assert_eq!((there.last_reset(), here.last_reset()), (reset, reset), "{k}");
        assert_eq!((there.last_image().width(), there.presented().current.height()), (0, 0));
    }
}
