//! The GPU rasterizer against the CPU's: the same planes within rounding, on any adapter at hand.

use std::sync::{Arc, OnceLock};

use glam::{DVec2, DVec3};
use gs3_compute::{Gpu, GpuError, GpuSettings, device_for_tests};
use gs3_raster::{
    Culling, GpuGBuffer, GpuRasterError, GpuRasterizer, LowResolution, Outputs, RasterError, RasterSettings,
    Rasterizer, ScenePrecision, Window, matched_dilation,
};
use gs3_scene::gaussians::MAX_SH;
use gs3_scene::{Camera, GBuffer, Image, Margin, OpacityMode, Scene};

use crate::compare::{EVERYTHING, assert_identical, oracle, pairs};
use crate::oracle::TRANSMITTANCE_BAND;
use crate::real_scenes;
use crate::scenes::{Random, RandomScene, Spec, camera_at_origin, gaussians, posed, tilted_pose};

/// The adapter of this machine, or a word that there is none.
pub fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| device_for_tests(&GpuSettings::default())).clone()
}

pub fn cpu_frame(
    scene: &Arc<Scene>,
    culling: Culling,
    camera: &Camera,
    settings: &RasterSettings,
) -> GBuffer {
    let mut gbuffer = GBuffer::default();
    Rasterizer::new(Arc::clone(scene), culling)
        .rasterize(camera, settings, &mut gbuffer)
        .expect("valid settings");
    gbuffer
}

pub fn gpu_frame(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    culling: Culling,
    precision: ScenePrecision,
    camera: &Camera,
    settings: &RasterSettings,
) -> GBuffer {
    let mut gbuffer = GBuffer::default();
    let mut rasterizer =
        GpuRasterizer::new(gpu, Arc::clone(scene), culling, precision).unwrap_or_else(|e| panic!("{e}"));
    rasterizer.rasterize_to(camera, settings, &mut gbuffer).unwrap_or_else(|e| panic!("{e}"));
    gbuffer
}

/// Asserts that every plane is within `floor` dB of the CPU's, its largest value being the signal. Of a plane that is
/// not, 1 value in 100,000, those farthest off, is left out if `is_step` says of its plane and pixel that the
/// formulas have a step there, which rounding may cross.
pub fn assert_close(
    actual: &GBuffer,
    expected: &GBuffer,
    mut is_step: impl FnMut(&str, usize) -> bool,
    floor: f64,
    what: &str,
) {
    let pixels = expected.alpha.data().len();
    let (actual_planes, expected_planes) = (pairs(actual), pairs(expected));
    assert_eq!(actual_planes.len(), expected_planes.len(), "planes");
    for (a, e) in actual_planes.iter().zip(&expected_planes) {
        assert_eq!(a.actual.len(), e.actual.len());
        assert!(a.actual.iter().all(|v| v.is_finite()), "{what}: {} is not finite", a.name);
        let square = |i: usize| (f64::from(a.actual[i]) - f64::from(e.actual[i])).powi(2);
        let largest = e.actual.iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
        let mut far: Vec<usize> = (0..e.actual.len()).collect();
        far.sort_by(|i, j| square(*i).total_cmp(&square(*j)));
        let mut sum: f64 = far.iter().map(|i| square(*i)).sum();
        let most = far.len().div_ceil(100_000);
        let mut left_out = 0;
        let ratio = loop {
            let kept = (far.len() - left_out) as f64;
            let ratio =
                if sum == 0.0 { f64::INFINITY } else { 10.0 * (largest * largest * kept / sum).log10() };
            let worst = far[far.len() - 1 - left_out];
            if ratio >= floor || left_out == most || !is_step(a.name, worst % pixels) {
                break ratio;
            }
            left_out += 1;
            sum = far[..far.len() - left_out].iter().map(|i| square(*i)).sum();
        };
        eprintln!("{what}: {} {ratio:.1} dB, {left_out} left out", a.name);
        assert!(ratio >= floor, "{what}: {}: expected at least {floor} dB, found {ratio:.1}", a.name);
    }
    assert_eq!(actual.jitter, expected.jitter);
}

/// Asserts that the same pixels are hit but for 1 in 10,000.
pub fn assert_same_hits(actual: &GBuffer, expected: &GBuffer, what: &str) {
    let pairs = actual.alpha.data().iter().zip(expected.alpha.data());
    let different = pairs.filter(|(a, e)| (**a > 0.0) != (**e > 0.0)).count();
    assert!(
        different * 10_000 <= actual.alpha.data().len(),
        "{what}: {different} pixels are hit by one only"
    );
}

/// Everything that changes a frame, each value of it at least once.
#[test]
fn random_scenes_match_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let cullings = [Culling::Aabb3Sigma, Culling::Adr, Culling::SnugBox, Culling::AccuTile, Culling::Exact];
    for seed in 0..15_usize {
        let [width, height] = [[1, 1], [33, 47], [130, 70], [300, 9], [256, 144]][seed % 5];
        let camera = posed(&camera_at_origin(width, height, DVec2::new(0.05, 0.1)), tilted_pose());
        let recipe = RandomScene {
            seed: seed as u64,
            count: 400,
            sh_degree: (seed % 5) as u8,
            opacity_mode: if seed % 2 == 0 { OpacityMode::Default } else { OpacityMode::Antialiased },
            sigma: [[0.1, 40.0], [0.05, 2.0]][seed % 2],
            anisotropy: [2.0, 30.0, 300.0][seed % 3],
        };
        let scene = Arc::new(recipe.build(&camera));
        let settings = RasterSettings {
            outputs: [Outputs::GBufferMixed, Outputs::GBuffer, Outputs::Color][seed % 3],
            dilation: [0.3, matched_dilation(4)][seed / 2 % 2],
            jitter: [[0.0, 0.0], [0.21, -0.37]][seed % 2],
            margin: [Margin::NONE, Margin { left: 5, top: 0, right: 32, bottom: 1 }][seed / 2 % 2],
            background: [[0.0; 3], [0.2, 0.7, 1.0]][seed / 3 % 2],
            ..EVERYTHING
        };
        let culling = cullings[seed / 3];
        let what = format!("seed {seed}, {width}x{height}, {culling:?}");
        let expected = cpu_frame(&scene, culling, &camera, &settings);
        let exact = gpu_frame(&gpu, &scene, culling, ScenePrecision::F32, &camera, &settings);
        let never = |_: &str, _| false;
        assert_close(&exact, &expected, never, 70.0, &what);
        assert_same_hits(&exact, &expected, &what);
        let packed = gpu_frame(&gpu, &scene, culling, ScenePrecision::F16, &camera, &settings);
        assert_close(&packed, &expected, never, 55.0, &format!("{what}, f16"));
    }
}

/// A window is a part of the image, but for the rounding of positions: 70 dB, as between machines.
#[test]
fn windows_are_parts_of_the_image() {
    let Some(gpu) = gpu() else { return };
    let camera = camera_at_origin(203, 117, DVec2::new(0.05, -0.1));
    let recipe = RandomScene { count: 500, sigma: [0.1, 25.0], anisotropy: 30.0, ..RandomScene::BASE };
    let settings = RasterSettings::new(Outputs::Color);
    let mut rasterizer = GpuRasterizer::new(
        &gpu,
        Arc::new(recipe.build(&camera)),
        Culling::AccuTile,
        ScenePrecision::default(),
    )
    .unwrap_or_else(|e| panic!("{e}"));
    let (mut whole, mut part) = (Image::default(), Image::default());
    rasterizer.rasterize_image(&camera, &settings, &mut whole).unwrap_or_else(|e| panic!("{e}"));
    for (left, top, width, height) in [(0, 0, 64, 48), (64, 48, 64, 48), (101, 3, 102, 50)] {
        let window = Window { left, top, width, height };
        rasterizer.rasterize_window(&camera, window, &settings, &mut part).unwrap_or_else(|e| panic!("{e}"));
        let mut sum = 0.0;
        for y in 0..height as usize {
            let expected = &whole.row(y + top as usize)[left as usize..][..width as usize];
            let pairs = part.row(y).as_flattened().iter().zip(expected.as_flattened());
            sum += pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        }
        let psnr = 10.0 * (f64::from(4 * width * height) / sum).log10();
        assert!(psnr > 70.0, "{window:?}: {psnr} dB");
    }
    let window = Window { left: 200, top: 0, width: 4, height: 1 };
    let error = rasterizer.rasterize_window(&camera, window, &settings, &mut part);
    assert!(matches!(error, Err(GpuRasterError::Settings(RasterError::Window { .. }))), "{error:?}");
}

/// A picture copied out of its margin equals the CPU's, with either rasterizer and any old contents of the planes.
#[test]
fn pictures_are_copied_out_of_any_margin() {
    let Some(gpu) = gpu() else { return };
    let camera = camera_at_origin(130, 70, DVec2::new(0.05, 0.1));
    let scenes = [1, 2].map(|seed| {
        Arc::new(RandomScene { seed, count: 400, sigma: [0.1, 20.0], ..RandomScene::BASE }.build(&camera))
    });
    let [mut first, mut second] = scenes.each_ref().map(|scene| {
        GpuRasterizer::new(&gpu, Arc::clone(scene), Culling::AccuTile, ScenePrecision::F32).expect("room")
    });
    let settings = RasterSettings { outputs: Outputs::GBuffer, ..EVERYTHING };
    let (mut padded, mut picture) = (GpuGBuffer::default(), GpuGBuffer::default());
    let margins = [
        Margin { left: 32, top: 1, ..Margin::NONE },
        Margin { left: 3, top: 9, right: 2, bottom: 30 },
        Margin::NONE,
    ];
    for margin in margins {
        for (rasterizer, scene) in [(&mut first, &scenes[0]), (&mut second, &scenes[1])] {
            let settings = RasterSettings { margin, ..settings };
            let mut recorder = gpu.recorder(None);
            let frame = LowResolution { camera: &camera, scale: 1, has_blocks: false };
            rasterizer
                .record_padded(&mut recorder, frame, &settings, &mut padded, &mut picture)
                .expect("room");
            recorder.submit().expect("a device");
            let mut frame = GBuffer::default();
            picture.read(&gpu, &mut frame).expect("a device");
            let mut expected = GBuffer::default();
            cpu_frame(scene, Culling::AccuTile, &camera, &settings).crop(&mut expected);
            assert_close(&frame, &expected, |_, _| false, 70.0, &format!("{margin:?}"));
        }
    }
}

/// Lossless culling methods give the same bits on one device. The same frame rendered again also has the same bits,
/// after any frames in between.
#[test]
fn frames_repeat_and_exact_methods_agree_bit_for_bit() {
    let Some(gpu) = gpu() else { return };
    let camera = posed(&camera_at_origin(130, 70, DVec2::new(0.05, 0.1)), tilted_pose());
    let other = camera_at_origin(33, 47, DVec2::ZERO);
    let recipe = RandomScene { count: 400, sigma: [0.1, 40.0], anisotropy: 30.0, ..RandomScene::BASE };
    let scene = Arc::new(recipe.build(&camera));
    let mut first: Option<GBuffer> = None;
    for culling in [Culling::SnugBox, Culling::AccuTile, Culling::Exact] {
        let mut rasterizer =
            GpuRasterizer::new(&gpu, Arc::clone(&scene), culling, ScenePrecision::F16).expect("room");
        let mut gbuffers = [GpuGBuffer::default(), GpuGBuffer::default()];
        let mut frame = GBuffer::default();
        // Two G-buffers in turn, as a pipeline keeps the frame before; another size, other outputs in between.
        for (camera, outputs, out) in [
            (&camera, Outputs::GBufferMixed, 0),
            (&other, Outputs::GBufferMixed, 1),
            (&camera, Outputs::Color, 1),
            (&camera, Outputs::GBufferMixed, 1),
        ] {
            let settings = RasterSettings { outputs, ..EVERYTHING };
            rasterizer.rasterize(camera, &settings, &mut gbuffers[out]).expect("room");
        }
        for out in &gbuffers {
            out.read(&gpu, &mut frame).expect("a device");
            assert_identical(first.get_or_insert_with(|| frame.clone()), &frame, &format!("{culling:?}"));
        }
        let mut image = Image::default();
        rasterizer.rasterize_image(&camera, &EVERYTHING, &mut image).expect("room");
        for (p, pixel) in image.pixels().iter().enumerate() {
            let color = [0, 1, 2].map(|k| frame.color.plane(k)[p]);
            assert_eq!(*pixel, [color[0], color[1], color[2], frame.alpha.data()[p]]);
        }
    }
}

/// Low-resolution frames of the demo and of captures. A single pixel of 480×270 with a depth jump makes 51 dB. So one
/// pixel on a step of the oracle's depth may be left out, except for a path's first camera. A pixel is on the step of
/// the median depth if its transmittance is ½ within a tenth of the oracle's own band, or within the whole band with
/// f16 splats.
#[test]
fn real_scenes_match_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let settings = RasterSettings {
        outputs: Outputs::GBuffer,
        dilation: matched_dilation(4),
        jitter: [0.125, -0.375],
        ..EVERYTHING
    };
    // Thin and thick: a statue of 100,000 splats, and leaves and grass of 3.4 million.
    let more = real_scenes::captures(&[
        ("narcissus", "statues/narcissus.sog", "narcissus_orbit.json"),
        ("hqgarden", "hqgarden", "hqgarden_pan.json"),
    ]);
    for (name, scene, cameras) in real_scenes::paths().into_iter().chain(more) {
        let cameras = cameras.iter().map(|c| c.resized(480, 270).expect("a size")).collect::<Vec<_>>();
        let expected = cameras.iter().map(|c| cpu_frame(&scene, Culling::AccuTile, c, &settings));
        let expected: Vec<GBuffer> = expected.collect();
        for (precision, band, floor) in [(ScenePrecision::F32, 0.1, 70.0), (ScenePrecision::F16, 1.0, 55.0)] {
            let mut rasterizer =
                GpuRasterizer::new(&gpu, Arc::clone(&scene), Culling::AccuTile, precision).expect("room");
            for (k, (camera, expected)) in cameras.iter().zip(&expected).enumerate() {
                let mut actual = GBuffer::default();
                rasterizer.rasterize_to(camera, &settings, &mut actual).expect("room");
                let what = format!("{name}, camera {k}, {precision:?}");
                let mut steps = None;
                let is_step = |plane: &str, p: usize| {
                    let oracle = steps.get_or_insert_with(|| oracle(&scene, camera, &settings));
                    let cut_offs = oracle.pixel(p % 480, p / 480).cut_offs;
                    eprintln!("{what}: {plane}, pixel {p}: {cut_offs:?}");
                    k > 0
                        && (cut_offs.any()
                            || plane == "depth_median" && cut_offs.to_median <= band * TRANSMITTANCE_BAND)
                };
                assert_close(&actual, expected, is_step, floor, &what);
                assert_same_hits(&actual, expected, &what);
            }
        }
    }
}

/// No value that a scene can hold makes any output NaN or infinite.
#[test]
fn poisoned_scenes_give_finite_output() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random(7);
    let mut pick = |values: &[f64]| values[random.bits() as usize % values.len()];
    const COORDINATES: &[f64] = &[-0.7, -0.1, 0.0, 0.3, 1.1, 1e-12, 1e6, -1e6, 1e30];
    const DEPTHS: &[f64] = &[0.199_99, 0.2, 0.200_01, 0.7, 3.0, 9.0, 0.0, -1.0, 1e6, 1e30];
    const SCALES: &[f64] = &[1e-3, 0.02, 0.5, 0.0, 1e-12, 1e-30, 1e3, 1e6, 1e18, 1e30];
    let specs: Vec<Spec> = (0..3000)
        .map(|i| Spec {
            mean: DVec3::new(pick(COORDINATES), pick(COORDINATES), pick(DEPTHS)),
            scale: DVec3::from_array(std::array::from_fn(|_| pick(SCALES))),
            rotation: Random(i).rotation(),
            opacity: pick(&[0.0, 1.0 / 255.0, 0.004, 0.1, 0.7, 1.0]),
            sh: (0..3 * 16).map(|_| pick(&[-1.0, 0.0, 0.4, 2.0, MAX_SH.into(), (-MAX_SH).into()])).collect(),
        })
        .collect();
    let camera = camera_at_origin(61, 47, DVec2::ZERO);
    for (mode, precision) in
        [(OpacityMode::Default, ScenePrecision::F16), (OpacityMode::Antialiased, ScenePrecision::F32)]
    {
        let scene = Arc::new(Scene::new(gaussians(&specs, 3), mode).expect("finite"));
        let mut rasterizer = GpuRasterizer::new(&gpu, scene, Culling::AccuTile, precision).expect("room");
        for dilation in [0.3, 0.0] {
            let mut frame = GBuffer::default();
            let settings = RasterSettings { dilation, ..EVERYTHING };
            rasterizer.rasterize_to(&camera, &settings, &mut frame).expect("room");
            assert!(frame.alpha.data().iter().any(|a| *a > 0.5), "nothing in view");
            for pair in pairs(&frame) {
                let bad = pair.actual.iter().position(|v| !v.is_finite());
                assert_eq!(bad, None, "{precision:?}, dilation {dilation}: {} is not finite", pair.name);
            }
        }
    }
}

#[test]
fn bad_settings_and_lost_devices_are_typed_errors() {
    // A device of its own, which it gives back.
    let Some(gpu) = device_for_tests(&GpuSettings::default()) else { return };
    let camera = camera_at_origin(16, 16, DVec2::ZERO);
    let scene = Arc::new(RandomScene::BASE.build(&camera));
    let mut rasterizer =
        GpuRasterizer::new(&gpu, Arc::clone(&scene), Culling::AccuTile, ScenePrecision::F16).expect("room");
    let mut frame = GBuffer::default();
    let refused =
        rasterizer.rasterize_to(&camera, &RasterSettings { dilation: -1.0, ..EVERYTHING }, &mut frame);
    let expected = GpuRasterError::Settings(RasterError::Dilation { actual: -1.0 });
    assert_eq!(refused, Err(expected));
    assert_eq!(frame, GBuffer::default());
    gpu.destroy();
    let lost = |result: Result<(), GpuRasterError>| {
        assert!(matches!(result, Err(GpuRasterError::Gpu(GpuError::DeviceLost { .. }))), "{result:?}");
    };
    lost(rasterizer.rasterize_to(&camera, &EVERYTHING, &mut frame));
    lost(GpuRasterizer::new(&gpu, scene, Culling::AccuTile, ScenePrecision::F16).map(|_| ()));
}
