//! Poison values, extreme sizes, settings that make no sense.

use std::sync::Arc;

use glam::{DQuat, DVec2, DVec3};
use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, Rules};
use gs3_scene::gaussians::MAX_SH;
use gs3_scene::{GBuffer, Image, Margin, OpacityMode, Scene};
use proptest::prelude::*;

use crate::compare::{EVERYTHING, assert_identical, oracle, pairs, render, render_image};
use crate::scenes::{RandomScene, Spec, camera_at_origin, gaussians, scene};

const ALL_CULLING: [Culling; 5] =
    [Culling::Aabb3Sigma, Culling::Adr, Culling::SnugBox, Culling::AccuTile, Culling::Exact];

fn assert_finite(gbuffer: &GBuffer, what: &str) {
    for pair in pairs(gbuffer) {
        let bad = pair.actual.iter().position(|v| !v.is_finite());
        assert_eq!(bad, None, "{what}: {} is not finite", pair.name);
    }
    let range = gbuffer.alpha.data().iter().all(|a| (0.0..=1.0).contains(a));
    assert!(range, "{what}: alpha outside [0, 1]");
}

/// Values that have broken renderers before: extreme, degenerate, at the near plane.
fn poison() -> impl Strategy<Value = Spec> {
    let coordinate = || {
        prop_oneof![
            4 => -3.0..3.0_f64,
            1 => Just(0.0),
            1 => Just(1e6),
            1 => Just(-1e6),
            1 => Just(1e-12),
            1 => Just(1e30),
        ]
    };
    let depth = prop_oneof![
        3 => 0.2..10.0_f64,
        2 => 0.199_99..0.200_01_f64,
        1 => Just(0.2),
        1 => Just(0.0),
        1 => Just(-1.0),
        1 => Just(1e6),
        1 => Just(1e30),
    ];
    let scale = || {
        prop_oneof![
            3 => 1e-3..1.0_f64,
            1 => Just(0.0),
            1 => Just(1e-12),
            1 => Just(1e-30),
            1 => Just(1e3),
            1 => Just(1e6),
            1 => Just(1e18),
            1 => Just(1e30),
        ]
    };
    let opacity = prop_oneof![3 => 0.0..1.0_f64, 1 => Just(0.0), 1 => Just(1.0), 1 => Just(1.0 / 255.0)];
    // Of the third degree; smaller ones take the first of them.
    let most = f64::from(MAX_SH);
    let sh =
        prop::collection::vec(prop_oneof![4 => -2.0..2.0_f64, 1 => Just(most), 1 => Just(-most)], 3 * 16);
    let quaternion = prop::array::uniform4(-1.0..1.0_f64);
    (coordinate(), coordinate(), depth, [scale(), scale(), scale()], quaternion, opacity, sh).prop_map(
        |(x, y, z, s, q, opacity, sh)| {
            let q = DQuat::from_array(q);
            let rotation = if q.length() > 1e-3 { q.normalize() } else { DQuat::IDENTITY };
            Spec { mean: DVec3::new(x, y, z), scale: DVec3::from_array(s), rotation, opacity, sh }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    /// No value that a scene can hold makes any output NaN or infinite, and culling stays exact.
    #[test]
    fn poisoned_scenes_give_finite_output(
        mut specs in prop::collection::vec(poison(), 1..24),
        degree in 0_usize..4,
        antialiased: bool,
        dilation in prop_oneof![Just(0.0_f32), Just(0.3), Just(0.3 / 16.0), Just(1e-12), Just(1e6)],
    ) {
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        specs.iter_mut().for_each(|spec| spec.sh.truncate(3 * (degree + 1).pow(2)));
        let scene = Scene::new(gaussians(&specs, degree as u8), mode).expect("finite");
        let camera = camera_at_origin(35, 21, DVec2::ZERO);
        let settings = RasterSettings { dilation, background: [0.5; 3], ..EVERYTHING };
        let frames = ALL_CULLING.map(|c| render(&scene, c, &camera, &settings));
        for (frame, culling) in frames.iter().zip(ALL_CULLING) {
            assert_finite(frame, &format!("{culling:?}"));
        }
        for (frame, culling) in frames.iter().zip(ALL_CULLING).skip(3) {
            assert_identical(&frames[2], frame, &format!("SnugBox and {culling:?}"));
        }
    }
}

/// A splat far larger than the image covers all of it.
#[test]
fn enormous_splats_cover_the_image() {
    for radius in [1e2, 1e4, 1e8] {
        let ball = Spec::ball(DVec3::new(0.0, 0.0, 5.0), radius, 0.7, [1.0, 0.5, 0.25]);
        let camera = camera_at_origin(100, 50, DVec2::ZERO);
        for culling in ALL_CULLING {
            let frame = render(&scene(std::slice::from_ref(&ball), 0), culling, &camera, &EVERYTHING);
            assert_finite(&frame, &format!("radius {radius} {culling:?}"));
            for (p, a) in frame.alpha.data().iter().enumerate() {
                assert!((a - 0.7).abs() < 1e-2, "radius {radius} {culling:?} pixel {p}: alpha {a}");
            }
        }
    }
}

/// At 7680×4320 tile numbers need more than 16 bits, and positions most of a single-precision mantissa.
#[test]
fn largest_sizes() {
    let camera = camera_at_origin(7680, 4320, DVec2::ZERO);
    let scene = RandomScene { count: 400, sigma: [2.0, 300.0], ..RandomScene::BASE }.build(&camera);
    let settings = RasterSettings { outputs: Outputs::Color, background: [0.1, 0.2, 0.3], ..EVERYTHING };
    let image = render_image(&scene, Culling::AccuTile, &camera, &settings);
    assert_eq!((image.width(), image.height()), (7680, 4320));
    let oracle = oracle(&scene, &camera, &settings);
    let mut compared = 0;
    let mut hits = 0;
    for j in (7..4320).step_by(101).chain([0, 4319]) {
        for i in (5..7680).step_by(103).chain([0, 7679]) {
            let sample = oracle.pixel(i, j);
            if sample.cut_offs.any() {
                continue;
            }
            let pixel = image.row(j)[i];
            for c in 0..3 {
                let error = (f64::from(pixel[c]) - sample.color[c]).abs();
                // Single precision places a splat to 2⁻¹² px at x = 7680, which a splat of σ = 2 px amplifies to 2e-4.
                assert!(error < 1e-3, "pixel ({i}, {j}): expected {:?}, found {pixel:?}", sample.color);
            }
            compared += 1;
            hits += usize::from(sample.alpha > 0.1);
        }
    }
    assert!(compared > 3000 && hits > compared / 4, "compared {compared}, hits {hits}");
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let camera = camera_at_origin(16, 16, DVec2::ZERO);
    let mut rasterizer = Rasterizer::new(Arc::new(RandomScene::BASE.build(&camera)), Culling::Exact);
    let refused = [
        RasterSettings { dilation: -0.1, ..EVERYTHING },
        RasterSettings { dilation: f32::NAN, ..EVERYTHING },
        RasterSettings { dilation: f32::INFINITY, ..EVERYTHING },
        RasterSettings { jitter: [f32::NAN, 0.0], ..EVERYTHING },
        RasterSettings { jitter: [0.0, f32::INFINITY], ..EVERYTHING },
        RasterSettings { margin: Margin { top: 33, ..Margin::NONE }, ..EVERYTHING },
        RasterSettings { margin: Margin::all(u32::MAX), ..EVERYTHING },
        RasterSettings { rules: Rules { near: Some(0.0), ..Rules::KERBL }, ..EVERYTHING },
        RasterSettings { rules: Rules { far: f32::NAN, ..Rules::KERBL }, ..EVERYTHING },
        RasterSettings { rules: Rules { max_alpha: 1.0, ..Rules::KERBL }, ..EVERYTHING },
        RasterSettings { rules: Rules { min_compensation: -0.1, ..Rules::KERBL }, ..EVERYTHING },
        RasterSettings { background: [0.0, f32::NAN, 0.0], ..EVERYTHING },
        RasterSettings { background: [0.0, 0.0, f32::NEG_INFINITY], ..EVERYTHING },
    ];
    for settings in &refused {
        assert!(rasterizer.rasterize(&camera, settings, &mut GBuffer::default()).is_err(), "{settings:?}");
        assert!(
            rasterizer.rasterize_image(&camera, settings, &mut Image::default()).is_err(),
            "{settings:?}"
        );
        let error = rasterizer.rasterize(&camera, settings, &mut GBuffer::default()).expect_err("refused");
        let message = error.to_string();
        assert!(message.contains("expected") && message.contains("found"), "{message}");
    }
    rasterizer.rasterize(&camera, &EVERYTHING, &mut GBuffer::default()).expect("still usable afterwards");
}
