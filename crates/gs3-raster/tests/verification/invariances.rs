//! Changes that must not change the picture, or must change it in a known way.

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec2, DVec3};
use gs3_raster::{Culling, Outputs, RasterError, RasterSettings, Rasterizer, Window, matched_dilation};
use gs3_scene::{Camera, GBuffer, Image, Margin, OpacityMode, Scene, Size};
use proptest::prelude::*;

use crate::compare::{
    EVERYTHING, EXACT_CULLING, assert_identical, assert_matches, oracle, oracle_samples, pairs, render,
};
use crate::scenes::{Random, RandomScene, Spec, camera_at_origin, gaussians, posed, scene};

fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

fn recipes() -> impl Strategy<Value = RandomScene> {
    (any::<u64>(), 1_usize..150, 0_u8..=4, any::<bool>()).prop_map(|(seed, count, sh_degree, antialiased)| {
        let opacity_mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        RandomScene { seed, count, sh_degree, opacity_mode, ..RandomScene::BASE }
    })
}

fn test_camera() -> Camera {
    camera_at_origin(53, 37, DVec2::new(0.1, -0.1))
}

proptest! {
    #![proptest_config(cases(24))]

    /// Opaque walls hide everything behind them: two of α = 0.99 leave T = 1e-4, and any further splat would leave
    /// less.
    #[test]
    fn hidden_splats_change_nothing(seed: u64, count in 1_usize..60) {
        let camera = test_camera();
        let walls: Vec<Spec> = (0..3)
            .map(|k| Spec::ball(DVec3::new(0.0, 0.0, 4.0 + f64::from(k)), 100.0, 1.0, [0.7, 0.4, 0.2]))
            .collect();
        let hidden = RandomScene { seed, count, ..RandomScene::BASE }.specs(&camera).into_iter().map(|mut s| {
            s.mean.z = s.mean.z.abs() + 8.0;
            s
        });
        let all: Vec<Spec> = walls.iter().cloned().chain(hidden).collect();
        for culling in EXACT_CULLING {
            assert_identical(
                &render(&scene(&walls, 0), culling, &camera, &EVERYTHING),
                &render(&scene(&all, 0), culling, &camera, &EVERYTHING),
                "hidden",
            );
        }
    }

    /// In a unit a thousand times larger, with the near plane in that unit, everything looks the same but for rounding.
    #[test]
    fn small_scenes_look_like_large_ones_with_a_near_plane_of_their_own(recipe in recipes()) {
        let unit = 2f64.powi(-10);
        let camera = test_camera();
        let large = recipe.build(&camera);
        let mut g = large.gaussians().clone();
        for plane in g.means.iter_mut().chain(&mut g.scales) {
            plane.iter_mut().for_each(|v| *v *= unit as f32);
        }
        let pose = camera.view_from_world();
        let nearer = DAffine3 { translation: pose.translation * unit, ..pose };
        let small_camera = Camera::new(nearer, camera.intrinsics()).expect("valid");
        let near = large.details().near * unit as f32;
        let small = Scene::new(g, large.opacity_mode()).expect("valid").with_near(near);
        for culling in EXACT_CULLING {
            let a = render(&large, culling, &camera, &EVERYTHING);
            let b = render(&small, culling, &small_camera, &EVERYTHING);
            let pairs = a.color.data().iter().zip(b.color.data());
            let largest = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            prop_assert!(largest < 1e-5, "{largest}");
        }
    }

    /// The order in the file does not matter where depths differ.
    #[test]
    fn permutations_change_nothing(recipe in recipes(), shuffle: u64) {
        let camera = test_camera();
        let mut specs = recipe.specs(&camera);
        for (k, s) in specs.iter_mut().enumerate() {
            // Distinct in single precision, the rest of the scene left to chance.
            s.mean.z = 0.25 + 0.01 * k as f64;
        }
        let build = |specs: &[Spec]| {
            Scene::new(gaussians(specs, recipe.sh_degree), recipe.opacity_mode).expect("valid")
        };
        let before = render(&build(&specs), Culling::AccuTile, &camera, &EVERYTHING);
        let mut random = Random(shuffle);
        for k in (1..specs.len()).rev() {
            specs.swap(k, (random.bits() % (k as u64 + 1)) as usize);
        }
        let after = render(&build(&specs), Culling::AccuTile, &camera, &EVERYTHING);
        assert_identical(&before, &after, "permuted");
    }

    /// Equal depths are drawn in a fixed order, with any culling and any number of threads.
    #[test]
    fn ties_are_deterministic(recipe in recipes(), layers in 1_usize..4) {
        let camera = test_camera();
        let mut specs = recipe.specs(&camera);
        for (k, s) in specs.iter_mut().enumerate() {
            s.mean.z = 1.0 + (k % layers) as f64;
        }
        let scene = Scene::new(gaussians(&specs, recipe.sh_degree), recipe.opacity_mode).expect("valid");
        let first = on_threads(1, || render(&scene, Culling::Exact, &camera, &EVERYTHING));
        for (threads, culling) in [(1, Culling::SnugBox), (3, Culling::AccuTile), (2, Culling::Exact)] {
            let again = on_threads(threads, || render(&scene, culling, &camera, &EVERYTHING));
            assert_identical(&first, &again, "ties");
        }
    }

    /// Moving scene and camera together changes rounding only. Degree 0: coefficients of higher degree do not turn with
    /// the scene.
    #[test]
    fn rigid_motion_changes_nothing(seed: u64, turn: u64, x in -3.0..3.0_f64, y in -3.0..3.0_f64) {
        let camera = test_camera();
        let recipe = RandomScene { seed, ..RandomScene::BASE };
        let motion = DAffine3::from_rotation_translation(Random(turn).rotation(), DVec3::new(x, y, x - y));
        let mut specs = recipe.specs(&camera);
        let still = scene(&specs, 0);
        for s in &mut specs {
            s.mean = motion.transform_point3(s.mean);
            s.rotation = DQuat::from_mat3(&motion.matrix3) * s.rotation;
        }
        let moved_camera = posed(&camera, camera.view_from_world() * motion.inverse());
        let samples = oracle_samples(&oracle(&still, &camera, &EVERYTHING), &camera);
        let moved = render(&scene(&specs, 0), Culling::AccuTile, &moved_camera, &EVERYTHING);
        // Positions of magnitude 10 are known to 1e-6, splats of σ = 0.4 px at a focal length of 46 px amplify it to
        // 1e-4 of the colour, and 3/σ times that for gradients.
        assert_matches(&moved, &samples, 2e-3, "moved");
    }

    /// The same for any degree when scene and camera are only shifted.
    #[test]
    fn translation_changes_nothing(recipe in recipes(), x in -3.0..3.0_f64, y in -3.0..3.0_f64) {
        let camera = test_camera();
        let shift = DVec3::new(x, y, y - x);
        let mut specs = recipe.specs(&camera);
        let build = |specs: &[Spec]| {
            Scene::new(gaussians(specs, recipe.sh_degree), recipe.opacity_mode).expect("valid")
        };
        let samples = oracle_samples(&oracle(&build(&specs), &camera, &EVERYTHING), &camera);
        for s in &mut specs {
            s.mean += shift;
        }
        let moved_camera = posed(&camera, camera.view_from_world() * DAffine3::from_translation(-shift));
        let moved = render(&build(&specs), Culling::AccuTile, &moved_camera, &EVERYTHING);
        assert_matches(&moved, &samples, 2e-3, "shifted");
    }

    /// The same frame bit for bit on any number of threads, and from a used rasterizer and buffer.
    #[test]
    fn threads_and_reuse_change_nothing(recipe in recipes()) {
        let camera = test_camera();
        let scene = recipe.build(&camera);
        let settings = RasterSettings { jitter: [0.3, -0.2], ..EVERYTHING };
        let first = on_threads(1, || render(&scene, Culling::AccuTile, &camera, &settings));
        for threads in [2, 3, 5] {
            let other = on_threads(threads, || render(&scene, Culling::AccuTile, &camera, &settings));
            assert_identical(&first, &other, &format!("{threads} threads"));
        }
        let mut rasterizer = Rasterizer::new(Arc::new(scene), Culling::AccuTile);
        let mut gbuffer = GBuffer::default();
        let other_camera = camera_at_origin(90, 11, DVec2::ZERO);
        rasterizer.rasterize(&other_camera, &EVERYTHING, &mut gbuffer).expect("valid");
        let colors = RasterSettings { outputs: Outputs::Color, ..settings };
        rasterizer.rasterize(&camera, &colors, &mut gbuffer).expect("valid");
        rasterizer.rasterize(&camera, &settings, &mut gbuffer).expect("valid");
        assert_identical(&first, &gbuffer, "reused");
    }
}

/// Runs `work` in a pool of its own.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool").install(work)
}

/// Nothing in view: the background exactly, and zeros.
#[test]
fn no_visible_splat_gives_the_background() {
    let unseen = [
        Spec::ball(DVec3::new(0.0, 0.0, -3.0), 0.5, 1.0, [1.0; 3]),
        Spec::ball(DVec3::new(0.0, 0.0, 0.19), 0.5, 1.0, [1.0; 3]),
        Spec::ball(DVec3::new(500.0, 0.0, 3.0), 0.5, 1.0, [1.0; 3]),
        Spec::ball(DVec3::new(0.0, 0.0, 3.0), 0.5, 0.0, [1.0; 3]),
        Spec::ball(DVec3::new(0.0, 0.0, 3.0), 0.5, 1.0 / 256.0, [1.0; 3]),
    ];
    let background = [0.1, 0.7, 0.3];
    for culling in EXACT_CULLING {
        let settings = RasterSettings { background, ..EVERYTHING };
        let frame = render(&scene(&unseen, 0), culling, &test_camera(), &settings);
        for c in 0..3 {
            assert!(frame.color.plane(c).iter().all(|v| *v == background[c]), "{culling:?}");
        }
        for pair in pairs(&frame).iter().filter(|p| p.name != "color") {
            assert!(pair.actual.iter().all(|v| *v == 0.0), "{culling:?}: {}", pair.name);
        }
    }
}

/// A low-resolution frame with matched dilation, jittered onto a native pixel of each block, is that pixel; its
/// gradients are per LR pixel, so `S` times as large.
#[test]
fn matched_low_resolution_samples_the_native_image() {
    const S: usize = 4;
    let native_camera = camera_at_origin(128, 96, DVec2::ZERO);
    for mode in [OpacityMode::Default, OpacityMode::Antialiased] {
        let recipe = RandomScene { opacity_mode: mode, sigma: [1.0, 20.0], ..RandomScene::BASE };
        let scene = recipe.build(&native_camera);
        let native = render(&scene, Culling::AccuTile, &native_camera, &EVERYTHING);
        let samples = oracle_samples(&oracle(&scene, &native_camera, &EVERYTHING), &native_camera);
        let camera = native_camera.low_resolution(S as u32);
        for (a, b) in [(0, 0), (3, 0), (1, 2), (3, 3)] {
            let jitter = [(a as f32 - 1.5) / 4.0, (b as f32 - 1.5) / 4.0];
            let settings = RasterSettings { jitter, dilation: matched_dilation(S as u32), ..EVERYTHING };
            let low = render(&scene, Culling::AccuTile, &camera, &settings);
            for (l, n) in pairs(&low).iter().zip(pairs(&native)) {
                let factor = match l.name {
                    "color_dx" | "color_dy" => S as f64,
                    "color_dxy" => (S * S) as f64,
                    _ => 1.0,
                };
                let (mut squares, mut count, mut largest) = (0.0, 0, 0.0_f64);
                let (lw, lh) = (low.width(), low.height());
                for (i, v) in l.actual.iter().enumerate() {
                    let (k, y, x) = (i / (lw * lh), i / lw % lh * S + b, i % lw * S + a);
                    let cut_offs = samples[y * 128 + x].cut_offs;
                    if cut_offs.any() || (cut_offs.median() && l.name == "depth_median") {
                        continue;
                    }
                    let expected = factor * f64::from(n.actual[(k * 96 + y) * 128 + x]);
                    squares += (f64::from(*v) - expected).powi(2);
                    largest = largest.max(expected.abs());
                    count += 1;
                }
                let decibels = 10.0 * (largest.powi(2) * f64::from(count) / squares).log10();
                // Colours and alpha as stated by the method; the others lose the amplification of their slopes.
                let floor = if matches!(l.name, "color" | "alpha") { 110.0 } else { 90.0 };
                eprintln!("{mode:?} ({a}, {b}) {}: {decibels:.1} dB", l.name);
                assert!(decibels > floor, "{mode:?} ({a}, {b}) {}: {decibels:.1} dB", l.name);
            }
        }
    }
}

/// A window of a view, its principal point far outside, shows what the view shows there.
#[test]
fn a_window_shows_what_its_view_shows_there() {
    let view = camera_at_origin(256, 128, DVec2::ZERO);
    let (left, top, width, height) = (208, 4, 48, 32);
    let mut intrinsics = view.intrinsics();
    (intrinsics.width, intrinsics.height) = (width, height);
    intrinsics.cx -= f64::from(left);
    intrinsics.cy -= f64::from(top);
    let window = Camera::new(DAffine3::IDENTITY, intrinsics).expect("valid by construction");
    let mut random = Random(7);
    let specs: Vec<Spec> = (0..80)
        .map(|_| {
            let [x, y] = [f64::from(width), f64::from(height)].map(|side| random.uniform(0.0, side));
            let mean = window.unproject(DVec2::new(x, y), random.uniform(2.0, 6.0));
            let color = std::array::from_fn(|_| random.uniform(0.2, 1.0));
            let scale = DVec3::new(0.01, 0.05, 0.3);
            Spec { scale, rotation: random.rotation(), ..Spec::ball(mean, 1.0, 0.7, color) }
        })
        .collect();
    let scene = scene(&specs, 0);
    let all = render(&scene, Culling::AccuTile, &view, &EVERYTHING);
    let part = render(&scene, Culling::AccuTile, &window, &EVERYTHING);
    let mut largest = 0.0_f32;
    for (c, y) in (0..3).flat_map(|c| (0..height as usize).map(move |y| (c, y))) {
        let expected = &all.color.row(c, y + top as usize)[left as usize..][..width as usize];
        for (a, b) in part.color.row(c, y).iter().zip(expected) {
            largest = largest.max((a - b).abs());
        }
    }
    // Positions on the image are rounded where the window begins or where the view does.
    assert!(largest < 1e-3, "{largest}");
}

/// Windows of an image have its bits: what is made in parts is made as a whole. They may begin anywhere if splats are whole, and
/// at blocks of 4×4 pixels if a culling cuts splats.
#[test]
fn windows_have_the_bits_of_the_image() {
    let camera = camera_at_origin(203, 117, DVec2::new(0.05, -0.1));
    let recipe = RandomScene { count: 500, sigma: [0.1, 25.0], anisotropy: 30.0, ..RandomScene::BASE };
    let scene = Arc::new(recipe.build(&camera));
    let settings = RasterSettings { background: [0.1, 0.2, 0.3], ..RasterSettings::new(Outputs::Color) };
    let cullings = [Culling::Aabb3Sigma, Culling::Adr, Culling::SnugBox, Culling::AccuTile, Culling::Exact];
    for culling in cullings {
        let mut rasterizer = Rasterizer::new(Arc::clone(&scene), culling);
        let mut whole = Image::default();
        rasterizer.rasterize_image(&camera, &settings, &mut whole).expect("valid settings");
        let mut part = Image::default();
        for (left, top, width, height) in [
            (0, 0, 203, 117),
            (0, 0, 64, 48),
            (64, 48, 64, 48),
            (37, 51, 1, 1),
            (101, 3, 102, 50),
            (100, 4, 103, 50),
            (200, 116, 3, 1),
        ] {
            let is_at_blocks = left % 4 == 0 && top % 4 == 0;
            if !is_at_blocks && !EXACT_CULLING.contains(&culling) {
                continue;
            }
            let window = Window { left, top, width, height };
            rasterizer.rasterize_window(&camera, window, &settings, &mut part).expect("valid settings");
            for y in 0..height as usize {
                let expected = &whole.row(y + top as usize)[left as usize..][..width as usize];
                assert!(part.row(y) == expected, "{culling:?}, {window:?}: row {y}");
            }
        }
        assert!(whole.pixels().iter().any(|pixel| pixel[3] > 0.9), "something is shown");
    }
    let mut rasterizer = Rasterizer::new(scene, Culling::AccuTile);
    for (left, top, width, height) in
        [(0, 0, 0, 1), (100, 0, 104, 117), (0, 1, 203, 117), (u32::MAX, 0, 2, 1)]
    {
        let window = Window { left, top, width, height };
        let error = rasterizer.rasterize_window(&camera, window, &settings, &mut Image::default());
        assert_eq!(error, Err(RasterError::Window { size: Size::new(203, 117), actual: window }));
    }
}

/// What is rasterized around a picture changes nothing in it, and shows what a wider camera sees.
#[test]
fn a_margin_changes_nothing_in_the_picture() {
    let camera = camera_at_origin(120, 70, DVec2::new(0.05, 0.1));
    let recipe = RandomScene { count: 400, sigma: [0.1, 20.0], anisotropy: 30.0, ..RandomScene::BASE };
    let margin = Margin { left: 17, top: 3, right: 0, bottom: 32 };
    let mut intrinsics = camera.intrinsics();
    (intrinsics.width, intrinsics.height) = (120 + 17, 70 + 3 + 32);
    intrinsics.cx += 17.0;
    intrinsics.cy += 3.0;
    let wider = Camera::new(DAffine3::IDENTITY, intrinsics).expect("valid by construction");
    // There is something beside the picture.
    let scene = Arc::new(recipe.build(&wider));
    let settings = RasterSettings { jitter: [0.25, -0.375], outputs: Outputs::GBuffer, ..EVERYTHING };
    let alone = render(&scene, Culling::AccuTile, &camera, &settings);
    let padded = render(&scene, Culling::AccuTile, &camera, &RasterSettings { margin, ..settings });
    assert_eq!((padded.width(), padded.height(), padded.margin), (137, 105, margin));
    let mut picture = GBuffer::default();
    padded.crop(&mut picture);
    assert_eq!((picture.jitter, picture.margin), (alone.jitter, Margin::NONE));
    let largest = |a: &[f32], b: &[f32]| {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(largest(picture.color.data(), alone.color.data()) < 1e-4);
    assert!(largest(picture.alpha.data(), alone.alpha.data()) < 1e-4);
    let dx = |g: &GBuffer| g.gradients.as_ref().expect("asked for").color_dx.data().to_vec();
    assert!(largest(&dx(&picture), &dx(&alone)) < 1e-3);
    let expected = |g: &GBuffer| g.geometry.as_ref().expect("asked for").depth_expected.data().to_vec();
    assert!(largest(&expected(&picture), &expected(&alone)) < 1e-2);
    // A wider camera's own limits of the Jacobian lie farther out: of large splats near its edges it makes others.
    let all = render(&scene, Culling::AccuTile, &wider, &settings);
    let mean = |a: &[f32], b: &[f32]| {
        a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.len() as f64
    };
    let (near, far) =
        (mean(padded.color.data(), all.color.data()), mean(padded.color.data(), &[0.0; 3 * 137 * 105]));
    assert!(near < 0.05 * far, "{near} of {far}");
}
