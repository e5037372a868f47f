//! Per-Gaussian statistics against a naive double-precision evaluation, against differences of images, and properties
//! that hold for every scene.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use gs3_raster::{Culling, Importance, Outputs, RasterError, RasterSettings, Rasterizer};
use gs3_scene::{Camera, OpacityMode, Scene};

use crate::compare::{EXACT_CULLING, oracle, render_image};
use crate::oracle::{ALPHA_MAX, ALPHA_MIN, Oracle, Splat, TRANSMITTANCE_MIN};
use crate::scenes::{RandomScene, Spec, camera_at_origin, posed, scene, smooth_scene, tilted_pose};

fn settings() -> RasterSettings {
    RasterSettings { jitter: [0.2, -0.3], background: [0.7, 0.2, 0.4], ..RasterSettings::new(Outputs::Color) }
}

fn measure(scene: &Scene, culling: Culling, camera: &Camera, settings: &RasterSettings) -> Importance {
    let mut importance = Importance::zeroed(scene.gaussians().len());
    Rasterizer::new(Arc::new(scene.clone()), culling)
        .importance(camera, settings, &mut importance)
        .expect("valid settings");
    importance
}

/// g at pixel `(i, j)`.
fn falloff(splat: &Splat, i: usize, j: usize, jitter: [f32; 2]) -> f64 {
    let dx = splat.mean[0] - (i as f64 + 0.5 + f64::from(jitter[0]));
    let dy = splat.mean[1] - (j as f64 + 0.5 + f64::from(jitter[1]));
    let [a, b, c] = splat.conic;
    (-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy).exp()
}

/// What the oracle expects of one Gaussian.
#[derive(Clone, Copy, Default)]
struct Expected {
    weight: f64,
    pixels: f64,
    dominant: f64,
    sensitivity: f64,
    /// Pixels at which a step of the published rule, or a tie, may fall on either side.
    uncertain: f64,
}

/// Every splat at every pixel; the colour behind by recursion from the back.
fn expected(scene: &Scene, oracle: &Oracle, camera: &Camera, settings: &RasterSettings) -> Vec<Expected> {
    let mut all = vec![Expected::default(); scene.gaussians().len()];
    for j in 0..camera.height() as usize {
        for i in 0..camera.width() as usize {
            let is_uncertain = oracle.pixel(i, j).cut_offs.any();
            let mut blended: Vec<(&Splat, f64, f64)> = Vec::new();
            let mut t = 1.0;
            for splat in &oracle.splats {
                let alpha = (splat.opacity * falloff(splat, i, j, settings.jitter)).min(ALPHA_MAX);
                if alpha > 0.9 * ALPHA_MIN {
                    all[splat.index].uncertain += f64::from(is_uncertain);
                }
                if alpha < ALPHA_MIN {
                    continue;
                }
                if t * (1.0 - alpha) < TRANSMITTANCE_MIN {
                    break;
                }
                blended.push((splat, alpha, t));
                t *= 1.0 - alpha;
            }
            let largest = blended.iter().map(|(_, alpha, t)| alpha * t).fold(0.0, f64::max);
            let is_tied =
                blended.iter().filter(|(_, alpha, t)| alpha * t > largest * (1.0 - 1e-4)).count() > 1;
            let mut behind = settings.background.map(f64::from);
            for &(splat, alpha, t) in blended.iter().rev() {
                let one = &mut all[splat.index];
                one.weight += alpha * t;
                one.pixels += 1.0;
                one.dominant += f64::from(alpha * t == largest);
                one.uncertain += f64::from(is_tied);
                for k in 0..3 {
                    one.sensitivity += (splat.opacity * t * (splat.color[k] - behind[k])).powi(2);
                    behind[k] = alpha * splat.color[k] + (1.0 - alpha) * behind[k];
                }
            }
        }
    }
    all
}

#[test]
fn statistics_are_those_of_a_naive_evaluation() {
    let camera = posed(&camera_at_origin(53, 37, DVec2::new(0.05, -0.1)), tilted_pose());
    let (mut certain, mut seen) = (0, 0);
    for seed in 0..6 {
        let opacity_mode = if seed % 2 == 0 { OpacityMode::Default } else { OpacityMode::Antialiased };
        let sh_degree = (seed % 4) as u8;
        let sigma = if seed < 2 { [0.4, 12.0] } else { [0.4, 4.0] };
        let scene = RandomScene { seed, sh_degree, opacity_mode, sigma, ..RandomScene::BASE }.build(&camera);
        let settings = settings();
        let expected = expected(&scene, &oracle(&scene, &camera, &settings), &camera, &settings);
        for culling in EXACT_CULLING {
            let actual = measure(&scene, culling, &camera, &settings);
            for (i, e) in expected.iter().enumerate() {
                // At a step one contribution of 1/255, or the last hundredth of transmittance, comes or goes.
                let check = |name: &str, actual: f64, expected: f64, per_uncertain: f64| {
                    let tolerance = 2e-4 * expected + 1e-6 + per_uncertain * e.uncertain;
                    assert!(
                        (actual - expected).abs() <= tolerance,
                        "seed {seed}, Gaussian {i}: {name}: expected {expected}, found {actual}, {} uncertain",
                        e.uncertain
                    );
                };
                check("weight", actual.weight[i], e.weight, 0.02);
                check("pixels", actual.pixels[i] as f64, e.pixels, 1.0);
                check("dominant", actual.dominant[i] as f64, e.dominant, 1.0);
                check("sensitivity", actual.sensitivity[i], e.sensitivity, 0.05);
                seen += usize::from(e.pixels > 0.0);
                certain += usize::from(e.pixels > 0.0 && e.uncertain == 0.0);
            }
        }
    }
    assert!(seen > 1000 && 2 * certain > seen, "{certain} of {seen} are certain: not enough to compare");
}

#[test]
fn sensitivity_is_the_squared_difference_of_images() {
    // A colour is linear in each contribution, so a wide step is exact.
    const STEP: f32 = 0.1;
    for (seed, mode) in [(21, OpacityMode::Default), (22, OpacityMode::Antialiased)] {
        let camera = camera_at_origin(40, 36, DVec2::new(0.08, -0.05));
        let scene = smooth_scene(&camera, seed, 2, mode);
        let settings = settings();
        let oracle = oracle(&scene, &camera, &settings);
        let actual = measure(&scene, Culling::AccuTile, &camera, &settings);
        for splat in &oracle.splats {
            let opacity = scene.gaussians().opacities[splat.index];
            let with = |opacity: f32| {
                let mut gaussians = scene.gaussians().clone();
                gaussians.opacities[splat.index] = opacity;
                let scene = Scene::new(gaussians, mode).expect("valid by construction");
                render_image(&scene, Culling::AccuTile, &camera, &settings)
            };
            let (less, more) = (with(opacity - STEP), with(opacity + STEP));
            let mut expected = 0.0;
            for (p, (less, more)) in less.pixels().iter().zip(more.pixels()).enumerate() {
                // The contribution depends on o·g alone: ∂/∂g = (o/g)·∂/∂o.
                let g = falloff(splat, p % 40, p / 40, settings.jitter);
                for k in 0..3 {
                    let by_opacity = f64::from(more[k] - less[k]) / f64::from(2.0 * STEP);
                    expected += (by_opacity * f64::from(opacity) / g).powi(2);
                }
            }
            let found = actual.sensitivity[splat.index];
            assert!(expected > 1e-3, "nothing to compare");
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "{}: expected {expected}, found {found}",
                splat.index
            );
        }
    }
}

#[test]
fn weights_add_up_to_alpha_and_dominant_pixels_to_those_that_see_anything() {
    let camera = camera_at_origin(101, 67, DVec2::ZERO);
    for seed in 30..34 {
        let scene = RandomScene { seed, count: 700, ..RandomScene::BASE }.build(&camera);
        let actual = measure(&scene, Culling::AccuTile, &camera, &settings());
        let image = render_image(&scene, Culling::AccuTile, &camera, &settings());
        let alpha: f64 = image.pixels().iter().map(|p| f64::from(p[3])).sum();
        let weight: f64 = actual.weight.iter().sum();
        assert!((weight / alpha - 1.0).abs() < 1e-5, "expected {alpha}, found {weight}");
        let covered = image.pixels().iter().filter(|p| p[3] > 0.0).count() as u64;
        assert_eq!(actual.dominant.iter().sum::<u64>(), covered);
        assert!(actual.dominant.iter().zip(&actual.pixels).all(|(dominant, pixels)| dominant <= pixels));
    }
}

#[test]
fn what_no_pixel_shows_counts_for_nothing() {
    let camera = camera_at_origin(48, 32, DVec2::ZERO);
    let red = [0.9, 0.1, 0.1];
    let specs = [
        Spec::ball(DVec3::new(0.0, 0.0, 9.0), 0.1, 0.9, red), // behind four opaque walls
        Spec::ball(DVec3::new(0.0, 0.0, 2.0), 9.0, 1.0, red),
        Spec::ball(DVec3::new(0.0, 0.0, 3.0), 9.0, 1.0, red),
        Spec::ball(DVec3::new(0.0, 0.0, 4.0), 9.0, 1.0, red),
        Spec::ball(DVec3::new(0.0, 0.0, 5.0), 9.0, 1.0, red),
        Spec::ball(DVec3::new(0.0, 0.0, -3.0), 0.1, 0.9, red), // behind the camera
        Spec::ball(DVec3::new(90.0, 0.0, 3.0), 0.1, 0.9, red), // beside the image
        Spec::ball(DVec3::new(0.0, 0.0, 1.0), 0.1, 0.003, red), // below 1/255
    ];
    let actual = measure(&scene(&specs, 0), Culling::AccuTile, &camera, &settings());
    for i in [0, 5, 6, 7] {
        let found = (actual.weight[i], actual.pixels[i], actual.dominant[i], actual.sensitivity[i]);
        assert_eq!(found, (0.0, 0, 0, 0.0), "Gaussian {i}");
    }
    assert_eq!((actual.pixels[1], actual.dominant[1]), (48 * 32, 48 * 32));
    assert!(actual.sensitivity[1] > 0.0 && actual.weight[1] > 0.98 * 48.0 * 32.0, "{actual:?}");
}

#[test]
fn sums_are_the_same_bits_for_any_number_of_threads_and_any_exact_culling() {
    let camera = camera_at_origin(301, 222, DVec2::ZERO);
    let scene =
        RandomScene { seed: 40, count: 20_000, sigma: [0.2, 5.0], ..RandomScene::BASE }.build(&camera);
    let on = |threads: usize, culling: Culling| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| measure(&scene, culling, &camera, &settings()))
    };
    let one = on(1, Culling::AccuTile);
    assert!(one.pixels.iter().filter(|&&count| count > 0).count() > 5_000);
    for (threads, culling) in
        [(2, Culling::AccuTile), (3, Culling::AccuTile), (7, Culling::Exact), (2, Culling::SnugBox)]
    {
        assert!(on(threads, culling) == one, "{threads} threads, {culling:?}");
    }
}

#[test]
fn views_add_up_and_other_scenes_are_refused() {
    let camera = camera_at_origin(40, 30, DVec2::ZERO);
    let scene = RandomScene::BASE.build(&camera);
    let count = scene.gaussians().len();
    let once = measure(&scene, Culling::AccuTile, &camera, &settings());
    let mut rasterizer = Rasterizer::new(Arc::new(scene), Culling::AccuTile);
    let mut twice = once.clone();
    rasterizer.importance(&camera, &settings(), &mut twice).expect("valid");
    for i in 0..count {
        assert_eq!(twice.pixels[i], 2 * once.pixels[i]);
        assert_eq!(twice.dominant[i], 2 * once.dominant[i]);
        assert!((twice.weight[i] - 2.0 * once.weight[i]).abs() <= 1e-9 * once.weight[i]);
        assert!((twice.sensitivity[i] - 2.0 * once.sensitivity[i]).abs() <= 1e-9 * once.sensitivity[i]);
    }
    let mut other = Importance::zeroed(count - 1);
    let error = rasterizer.importance(&camera, &settings(), &mut other).expect_err("another length");
    assert_eq!(error, RasterError::ImportanceLength { expected: count, actual: count - 1 });
    let bad = RasterSettings { dilation: -1.0, ..settings() };
    assert!(rasterizer.importance(&camera, &bad, &mut twice).is_err());
}
