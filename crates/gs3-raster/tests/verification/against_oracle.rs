//! Every plane, in every mode, against the oracle.

use glam::DVec2;
use gs3_raster::{Outputs, RasterSettings, Rules, matched_dilation};
use gs3_scene::{Gaussians, OpacityMode, Scene};

use crate::compare::{EVERYTHING, EXACT_CULLING, Tally, assert_matches, oracle, oracle_samples, render};
use crate::scenes::{RandomScene, camera_at_origin, posed, tilted_pose};

/// Of the plane's largest value, outside the cut-off sets.
const TOLERANCE: f64 = 1e-4;

const SIZES: [[u32; 2]; 7] = [[1, 1], [2, 3], [17, 13], [33, 31], [64, 48], [263, 5], [5, 71]];
const OUTPUTS: [Outputs; 4] = [Outputs::Color, Outputs::Samples, Outputs::GBuffer, Outputs::GBufferMixed];
const MODES: [OpacityMode; 2] = [OpacityMode::Default, OpacityMode::Antialiased];

#[test]
fn all_modes() {
    let mut tally = Tally::default();
    // Degrees up to 3 and degree 4 are counted on their own.
    let mut seeds = [0, 1000];
    for [width, height] in SIZES {
        for opacity_mode in MODES {
            for sh_degree in 0..=4 {
                for (dilation, sigma) in [(0.3, 0.4), (matched_dilation(4), 0.4), (0.05, 0.2), (0.0, 1.0)] {
                    let seed = &mut seeds[usize::from(sh_degree / 4)];
                    *seed += 1;
                    let seed = *seed;
                    let shift = DVec2::new(0.11, -0.23) * (seed % 3) as f64;
                    let camera = posed(&camera_at_origin(width, height, shift), tilted_pose());
                    let recipe = RandomScene {
                        seed,
                        sh_degree,
                        opacity_mode,
                        sigma: [sigma, 12.0],
                        ..RandomScene::BASE
                    };
                    let scene = recipe.build(&camera);
                    for (jitter, background) in [([0.0; 2], [0.0; 3]), ([0.375, -0.125], [0.9, 0.3, 0.6])] {
                        let settings = RasterSettings { dilation, jitter, background, ..EVERYTHING };
                        let samples = oracle_samples(&oracle(&scene, &camera, &settings), &camera);
                        for outputs in OUTPUTS {
                            for culling in EXACT_CULLING {
                                let what = format!(
                                    "{width}x{height} {opacity_mode:?} degree {sh_degree} dilation {dilation} \
                                     jitter {jitter:?} {outputs:?} {culling:?} seed {seed}"
                                );
                                let settings = RasterSettings { outputs, ..settings };
                                let gbuffer = render(&scene, culling, &camera, &settings);
                                assert_eq!(gbuffer.gradients.is_some(), outputs != Outputs::Color, "{what}");
                                assert_eq!(gbuffer.geometry.is_some(), outputs != Outputs::Color, "{what}");
                                let whole = gbuffer.geometry.as_ref().is_some_and(|g| {
                                    [g.depth_expected.size(), g.normal.size()] == [gbuffer.size(); 2]
                                });
                                let has_normals =
                                    [Outputs::GBuffer, Outputs::GBufferMixed].contains(&outputs);
                                assert_eq!(whole, has_normals, "{what}");
                                let mixed = gbuffer.gradients.as_ref().and_then(|g| g.color_dxy.as_ref());
                                assert_eq!(mixed.is_some(), outputs == Outputs::GBufferMixed, "{what}");
                                assert_eq!(gbuffer.jitter, jitter, "{what}");
                                tally.add(assert_matches(&gbuffer, &samples, TOLERANCE, &what));
                            }
                        }
                    }
                }
            }
        }
    }
    eprintln!("{tally:?}: {:.2} % near a cut-off", 100.0 * tally.excluded_share());
    assert!(tally.excluded_share() < 0.05, "too much excluded: {tally:?}");
    assert!(tally.compared > 1_000_000, "too little compared: {tally:?}");
}

/// Many layers, so that blending stops within most pixels.
#[test]
fn dense_scenes() {
    let camera = camera_at_origin(48, 40, DVec2::ZERO);
    let mut tally = Tally::default();
    for seed in 100..106 {
        let recipe = RandomScene { seed, count: 600, sigma: [2.0, 20.0], sh_degree: 1, ..RandomScene::BASE };
        let scene = recipe.build(&camera);
        let settings = RasterSettings { background: [1.0; 3], ..EVERYTHING };
        let samples = oracle_samples(&oracle(&scene, &camera, &settings), &camera);
        assert!(samples.iter().filter(|s| s.alpha > 0.99).count() > samples.len() / 2);
        for culling in EXACT_CULLING {
            let gbuffer = render(&scene, culling, &camera, &settings);
            tally.add(assert_matches(
                &gbuffer,
                &samples,
                TOLERANCE,
                &format!("dense {culling:?} seed {seed}"),
            ));
        }
    }
    assert!(tally.excluded_share() < 0.15, "too much excluded: {tally:?}");
}

/// Flat and needle-like Gaussians, as trained scenes hold them.
#[test]
fn thin_gaussians() {
    let camera = camera_at_origin(64, 48, DVec2::ZERO);
    let mut tally = Tally::default();
    for seed in 200..206 {
        let recipe = RandomScene { seed, anisotropy: 1e4, sigma: [0.5, 6.0], ..RandomScene::BASE };
        let scene = recipe.build(&camera);
        for dilation in [0.3, matched_dilation(4)] {
            let settings = RasterSettings { dilation, outputs: Outputs::GBuffer, ..EVERYTHING };
            let samples = oracle_samples(&oracle(&scene, &camera, &settings), &camera);
            let gbuffer = render(&scene, EXACT_CULLING[1], &camera, &settings);
            // Elongated splats lose a few bits of the determinant to cancellation.
            tally.add(assert_matches(
                &gbuffer,
                &samples,
                1e-3,
                &format!("thin, dilation {dilation}, seed {seed}"),
            ));
        }
    }
    assert!(tally.excluded_share() < 0.10, "too much excluded: {tally:?}");
}

/// Splats so small that antialiasing holds their opacity at its floor of 0.005, just above the 1/255 that is drawn.
#[test]
fn antialiased_opacity_has_a_floor() {
    let camera = camera_at_origin(48, 40, DVec2::ZERO);
    let recipe = RandomScene {
        seed: 300,
        count: 900,
        sigma: [0.002, 0.05],
        anisotropy: 1.0,
        opacity_mode: OpacityMode::Antialiased,
        ..RandomScene::BASE
    };
    let scene = recipe.build(&camera);
    let samples = oracle_samples(&oracle(&scene, &camera, &EVERYTHING), &camera);
    let faint = samples.iter().filter(|s| s.alpha > 0.0 && s.alpha < 0.005).count();
    assert!(faint > 20, "only {faint} pixels show a splat at the floor");
    let gbuffer = render(&scene, EXACT_CULLING[2], &camera, &EVERYTHING);
    assert_matches(&gbuffer, &samples, TOLERANCE, "floor");
}

/// The differences of gsplat: its cap of α, and its depths, which are depths of centres. The least compensation and
/// the planes are not part of the oracle and have tests of their own.
#[test]
fn rules_of_gsplat() {
    let camera = camera_at_origin(64, 48, DVec2::ZERO);
    let rules = Rules { near: None, ..Rules::GSPLAT };
    let mut tally = Tally::default();
    for seed in 700..706 {
        let scene = RandomScene { seed, sigma: [2.0, 20.0], ..RandomScene::BASE }.build(&camera);
        let settings = RasterSettings { rules, outputs: Outputs::GBuffer, ..EVERYTHING };
        let samples = oracle_samples(&oracle(&scene, &camera, &settings), &camera);
        let gbuffer = render(&scene, EXACT_CULLING[1], &camera, &settings);
        tally.add(assert_matches(&gbuffer, &samples, TOLERANCE, &format!("seed {seed}")));
    }
    // Splats are large and opaque: a pixel has more of them near the cap, and more pixels end.
    assert!(tally.excluded_share() < 0.10, "too much excluded: {tally:?}");
}

/// A ball is shown between the planes only, and an antialiased one fainter than the least compensation allows is not.
#[test]
fn rules_decide_what_is_shown() {
    // The ball is in the middle of the middle pixel.
    let camera = camera_at_origin(17, 17, DVec2::ZERO);
    let alpha = |z: f32, scale: f32, mode: OpacityMode, rules: Rules| {
        let mut ball = Gaussians::zeroed(1, 0);
        (ball.means[2][0], ball.rotations[0][0], ball.opacities[0]) = (z, 1.0, 1.0);
        ball.scales = [vec![scale], vec![scale], vec![scale]];
        let scene = Scene::new(ball, mode).unwrap();
        let gbuffer = render(&scene, EXACT_CULLING[1], &camera, &RasterSettings { rules, ..EVERYTHING });
        gbuffer.alpha.data().iter().copied().fold(0.0, f32::max)
    };
    let rules = Rules { near: Some(1.0), far: 3.0, ..Rules::GSPLAT };
    for (z, is_shown) in [(0.99, false), (1.01, true), (2.99, true), (3.01, false)] {
        assert_eq!(alpha(z, 1.0, OpacityMode::Default, rules) > 0.9, is_shown, "{z}");
    }
    // The scene's own near plane counts where the rules have none.
    assert!(alpha(0.1, 0.1, OpacityMode::Default, Rules::KERBL) == 0.0);
    assert!(alpha(0.1, 0.1, OpacityMode::Default, Rules::GSPLAT) > 0.9);
    let tiny = |rules| alpha(2.0, 1e-6, OpacityMode::Antialiased, rules);
    assert!((0.0039..=0.005).contains(&tiny(Rules::KERBL)) && tiny(Rules::GSPLAT) == 0.0);
}

/// The colour-only entry gives the colours of the G-buffer and alpha in its fourth channel.
#[test]
fn image_holds_color_and_alpha() {
    let camera = camera_at_origin(67, 45, DVec2::ZERO);
    let scene = RandomScene::BASE.build(&camera);
    for culling in EXACT_CULLING {
        let settings = RasterSettings { background: [0.2, 0.4, 0.8], ..EVERYTHING };
        let gbuffer =
            render(&scene, culling, &camera, &RasterSettings { outputs: Outputs::Color, ..settings });
        let image = crate::compare::render_image(&scene, culling, &camera, &settings);
        assert_eq!((image.width(), image.height()), (67, 45));
        for (p, pixel) in image.pixels().iter().enumerate() {
            let expected = [0, 1, 2].map(|c| gbuffer.color.plane(c)[p]);
            assert_eq!(pixel[..3], expected, "{culling:?} pixel {p}");
            assert_eq!(pixel[3], gbuffer.alpha.plane(0)[p], "{culling:?} pixel {p}");
        }
    }
}
