//! Temporal super sampling: convergence, gain in motion, disocclusion, reset, determinism.

use crate::common::{Sheet, World, camera, grid_jitter, wall_and_post};
use gs3_reconstruct::{Kriging, ReconstructError, ResetReason, SuperSampler, hermite};
use gs3_scene::{Camera, GBuffer, Image, Margin, Size};
use gs3_test_support::psnr;
use proptest::prelude::*;

const SIZE: Size = Size::new(240, 136);

fn at(t: f64) -> Camera {
    camera(SIZE.width, SIZE.height, [t, 0.3 * t, 0.2 * t], 0.1 * t, -0.05 * t)
}

/// Super-samples `frames` frames; the last result.
fn run(world: &World, scale: u32, frames: usize, pose: impl Fn(usize) -> Camera) -> Image {
    run_with(Kriging::Off, world, scale, frames, pose)
}

fn run_with(
    kriging: Kriging,
    world: &World,
    scale: u32,
    frames: usize,
    pose: impl Fn(usize) -> Camera,
) -> Image {
    let mut sampler = SuperSampler::new(scale, kriging).unwrap();
    let mut out = Image::default();
    for k in 0..frames {
        let gbuffer = world.gbuffer(&pose(k).low_resolution(scale), grid_jitter(scale, k));
        sampler.super_sample(&pose(k), &gbuffer, &mut out).unwrap();
    }
    out
}

#[test]
fn at_rest_the_image_becomes_native() {
    let world = wall_and_post(60.0);
    for scale in [2, 3, 4] {
        let native = world.native(&at(0.3));
        let n = (scale * scale) as usize;
        let psnrs = [n - 1, n, n + 3].map(|frames| psnr(&run(&world, scale, frames, |_| at(0.3)), &native));
        assert!(psnrs[1] > 80.0 && psnrs[2] > 80.0, "scale {scale}: {psnrs:?}");
        assert!(psnrs[0] < psnrs[1] - 5.0, "scale {scale}: a missing sample must show: {psnrs:?}");
        let kriged = run_with(Kriging::On, &world, scale, n, |_| at(0.3));
        assert!(kriged == run(&world, scale, n, |_| at(0.3)), "scale {scale}: what is exact stays");
    }
}

#[test]
fn beside_empty_background_nothing_is_lost() {
    // The post alone, several tiles wide: most tiles hold nothing, some a rim, and none may differ at its seams.
    // Its rim is hard: the tails of a soft one are not background.
    let mut world = wall_and_post(60.0);
    world.sheets.pop();
    world.sheets[0].softness = 5e-4;
    let pose = camera(840, 136, [0.3, 0.0, 0.0], 0.05, 0.0);
    let (native, out) = (world.native(&pose), run(&world, 4, 16, |_| pose));
    assert!(psnr(&out, &native) > 80.0, "{:.2} dB", psnr(&out, &native));
    assert!(out.pixels().iter().all(|p| p[3] == 0.0));
    let alone = run(&world, 4, 1, |_| pose);
    let empty = alone.pixels().iter().filter(|p| **p == [0.0; 4]).count();
    assert!(empty > 840 * 136 / 4, "only {empty} pixels are certain to be empty");
}

#[test]
fn history_gains_in_motion() {
    let world = wall_and_post(60.0);
    let pose = |k: usize| at(0.02 * k as f64);
    let native = world.native(&pose(19));
    let with = psnr(&run(&world, 4, 20, pose), &native);
    let mut single = Image::new(SIZE.width as usize, SIZE.height as usize);
    hermite(&world.gbuffer(&pose(19).low_resolution(4), [0.0; 2]), 4, &mut single).unwrap();
    let without = psnr(&single, &native);
    assert!(with > without + 4.0, "history {with:.2} dB, Hermite {without:.2} dB");
}

#[test]
fn kriging_gains_in_motion() {
    // As fine as pixels can show, and half as fine; alone, and behind a post, at whose edges it is not interpolation
    // that errs.
    let wall = |frequency| World { sheets: vec![Sheet::endless(6.0, 3, frequency)] };
    // What it gains, and what it reaches: where little is left to gain, the latter tells.
    let cases = [
        ("fine wall", wall(60.0), 1.0, 41.2),
        ("coarse wall", wall(30.0), 0.5, 50.8),
        ("fine wall, post", wall_and_post(60.0), 1.0, 37.5),
        ("coarse wall, post", wall_and_post(30.0), 0.1, 42.1),
    ];
    for (name, world, least, floor) in cases {
        let pose = |k: usize| at(0.02 * k as f64);
        let native = world.native(&pose(19));
        let [off, coarse, on, fine] = [Kriging::Off, Kriging::Coarse, Kriging::On, Kriging::Fine]
            .map(|kriging| psnr(&run_with(kriging, &world, 4, 20, pose), &native));
        assert!(
            coarse > off + least && coarse > floor,
            "{name}: kriged coarsely {coarse:.2} dB, first order {off:.2} dB"
        );
        assert!(on > coarse, "{name}: kriged {on:.2} dB, coarsely {coarse:.2} dB");
        assert!(fine > on, "{name}: finely kriged {fine:.2} dB, kriged {on:.2} dB");
    }
}

/// A wall's samples that show some of a post's edge, or that the post has come to hide, must not stand beside it.
#[test]
fn what_moves_apart_leaves_no_specks() {
    // Hard and soft edges, uncovering and covering: 51, 0 and 65 specks; 179, 19 and 88 if nothing hid samples, 51, 8
    // and 89 if edges were no matter.
    for (softness, step, most) in [(0.004, 0.02, 80), (0.02, 0.02, 4), (0.02, -0.02, 70)] {
        let mut world = wall_and_post(4.0);
        world.sheets[0].softness = softness;
        let pose = |k: usize| at(step * k as f64);
        let (native, out) = (world.native(&pose(19)), run(&world, 4, 20, pose));
        let is_off = |(a, b): (&[f32; 4], &[f32; 4])| (0..3).any(|c| (a[c] - b[c]).abs() > 0.1);
        let specks = out.pixels().iter().zip(native.pixels()).filter(|pair| is_off(*pair)).count();
        assert!(specks <= most, "edges {softness} wide, {step} a frame: {specks} specks");
    }
}

#[test]
fn colors_that_drift_on_a_smooth_wall_are_those_of_now() {
    // What the eye would see on a glossy wall: every frame everything is brighter by 0.004, well within the range of
    // the colours around.
    let wall = World { sheets: vec![Sheet::endless(6.0, 3, 4.0)] };
    let pose = |k: usize| at(0.02 * k as f64);
    let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
    let mut out = Image::default();
    for k in 0..20 {
        let mut gbuffer = wall.gbuffer(&pose(k).low_resolution(4), grid_jitter(4, k));
        for value in gbuffer.color.data_mut() {
            *value += 0.004 * (k as f32 - 19.0);
        }
        sampler.super_sample(&pose(k), &gbuffer, &mut out).unwrap();
    }
    let psnr = psnr(&out, &wall.native(&pose(19)));
    assert!(psnr > 50.0, "{psnr:.2} dB");
}

/// The innovation of the last of `frames` frames, in which everything is brighter by `brighter`, on an LR grid of
/// 96×40.
fn innovation(
    world: &World,
    scale: u32,
    frames: usize,
    step: f64,
    brighter: f32,
    shift: f32,
) -> Vec<[f32; 4]> {
    let mut sampler = SuperSampler::new(scale, Kriging::Off).unwrap();
    for k in 0..frames {
        let t = step * k as f64;
        let camera = camera(96 * scale, 40 * scale, [t, 0.3 * t, 0.0], 0.0, 0.0);
        let jitter = grid_jitter(scale, k).map(|j| j + shift);
        let mut gbuffer = world.gbuffer(&camera.low_resolution(scale), jitter);
        let brighter = if k + 1 == frames { brighter } else { 0.0 };
        gbuffer.color.data_mut().iter_mut().for_each(|value| *value += brighter);
        sampler.super_sample(&camera, &gbuffer, &mut Image::default()).unwrap();
    }
    sampler.innovation().to_vec()
}

#[test]
fn innovation_is_what_the_past_did_not_know() {
    // Colours are linear between samples, so that first-order predictions are exact.
    let linear = World { sheets: vec![Sheet::endless(6.0, 3, 0.01)] };
    for scale in [2, 3, 4] {
        let n = (scale * scale) as usize;
        let at_rest = innovation(&linear, scale, n, 0.0, 0.1, 0.0);
        assert_eq!(at_rest.len(), 96 * 40);
        for (k, pixel) in at_rest.iter().enumerate() {
            let [r, g, b, known] = *pixel;
            let is_right = [r, g, b].iter().all(|c| (c - 0.1).abs() < 1e-3) && known > 0.3;
            assert!(is_right, "×{scale} sample {k}: {pixel:?}");
        }
        // Without a past, and between pixel centres, nothing is said.
        assert!(innovation(&linear, scale, 1, 0.0, 0.1, 0.0).iter().all(|pixel| *pixel == [0.0; 4]));
        assert!(innovation(&linear, scale, n, 0.0, 0.1, 0.01).iter().all(|pixel| *pixel == [0.0; 4]));
    }
    // In motion, and within the range of colours around.
    let moving = innovation(&wall_and_post(20.0), 4, 16, 0.02, 0.01, 0.0);
    let known: Vec<f32> = moving.iter().filter(|p| p[3] > 0.3).map(|p| p[0] + p[1] + p[2]).collect();
    let mean = known.iter().sum::<f32>() / (3 * known.len()) as f32;
    assert!((0.008..0.012).contains(&mean), "{mean} of {} samples", known.len());
    assert!(known.len() > 96 * 40 / 2, "{}", known.len());
}

#[test]
fn curvature_leaves_no_overshoot() {
    // A turn of the camera: all samples land where they belong, between pixels.
    let world = wall_and_post(60.0);
    let pose = |k: usize| camera(SIZE.width, SIZE.height, [0.0; 3], 0.0037 * k as f64, 0.0019 * k as f64);
    let psnr = psnr(&run(&world, 4, 20, pose), &world.native(&pose(19)));
    assert!(psnr > 34.1, "{psnr:.2} dB");
}

#[test]
fn what_was_hidden_is_not_smeared() {
    // Every frame the post uncovers 2.5 columns of the wall: what it covered in the past is right in few frames only.
    let world = wall_and_post(20.0);
    let pose = |k: usize| camera(SIZE.width, SIZE.height, [0.12 * k as f64, 0.0, 0.0], 0.0, 0.0);
    let native = world.native(&pose(12));
    let out = run(&world, 4, 13, pose);
    // Red of the post is 0.7 ± 0.2, of the wall 0.5 ± 0.2; a ghost of the post on the wall would be off by 0.2 in whole
    // columns. Mean over columns averages the texture's own error out.
    let (width, height) = (out.width(), out.height());
    let silhouettes = [-0.25, 0.25].map(|x| pose(12).project([x, 0.0, 3.0].into()).0.x);
    for x in 0..width {
        // The silhouettes are known to one LR pixel only, and the last columns have just come into view.
        if silhouettes.iter().any(|s| (x as f64 + 0.5 - s).abs() < 4.0) || x + 8 > width {
            continue;
        }
        let mean = |image: &Image| (0..height).map(|y| image.row(y)[x][0]).sum::<f32>() / height as f32;
        let error = (mean(&out) - mean(&native)).abs();
        assert!(error < 0.03, "column {x}: {error}");
    }
}

/// Poles thinner than the distance between samples, which single frames miss here and there: of the wall behind them,
/// other frames have seen what they hide now.
#[test]
fn what_is_behind_thin_things_does_not_show_through() {
    let mut world = World { sheets: Vec::new() };
    for k in -6..=6 {
        let pole = Sheet {
            half_width: 0.03,
            softness: 0.004,
            base: [0.05, 0.1, 0.05],
            ..Sheet::endless(3.0, 7, 20.0)
        };
        world.sheets.push(Sheet { center: 0.3 * f64::from(k), ..pole });
    }
    world.sheets.push(Sheet { base: [0.8, 0.8, 0.7], ..Sheet::endless(6.0, 3, 20.0) });
    let pose =
        |k: usize| camera(SIZE.width, SIZE.height, [0.013 * k as f64, 0.007 * k as f64, 0.0], 0.0, 0.0);
    let native = world.native(&pose(24));
    let out = run(&world, 4, 25, pose);
    // 20.5 dB; 17.8 dB if nothing were behind anything.
    let found = psnr(&out, &native);
    assert!(found > 19.5, "{found:.2} dB");
}

#[test]
fn reset_forgets() {
    let world = wall_and_post(60.0);
    let other = wall_and_post(35.0);
    let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
    assert_eq!(sampler.history_invalid(), Some(ResetReason::FirstFrame));
    let mut out = Image::default();
    for k in 0..5 {
        let gbuffer = world.gbuffer(&at(0.0).low_resolution(4), grid_jitter(4, k));
        sampler.super_sample(&at(0.0), &gbuffer, &mut out).unwrap();
        assert_eq!(sampler.history_invalid(), None);
    }
    let gbuffer = other.gbuffer(&at(0.0).low_resolution(4), grid_jitter(4, 0));
    let mut fresh = Image::default();
    SuperSampler::new(4, Kriging::Off).unwrap().super_sample(&at(0.0), &gbuffer, &mut fresh).unwrap();
    let mut kept = sampler;
    kept.reset(ResetReason::SceneChange);
    assert_eq!(kept.history_invalid(), Some(ResetReason::SceneChange));
    kept.super_sample(&at(0.0), &gbuffer, &mut out).unwrap();
    assert_eq!(out, fresh);
    // Without the reset, the old scene shows.
    let gbuffer = world.gbuffer(&at(0.0).low_resolution(4), grid_jitter(4, 1));
    kept.super_sample(&at(0.0), &gbuffer, &mut out).unwrap();
    assert_ne!(out, fresh);
}

#[test]
fn another_size_resets_and_errors_do_not() {
    let world = wall_and_post(60.0);
    let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
    let mut out = Image::default();
    let small = camera(33, 18, [0.0; 3], 0.0, 0.0);
    for camera in [at(0.0), small] {
        let gbuffer = world.gbuffer(&camera.low_resolution(4), grid_jitter(4, 0));
        sampler.super_sample(&camera, &gbuffer, &mut out).unwrap();
        assert_eq!((out.width() as u32, out.height() as u32), (camera.width(), camera.height()));
        let mut fresh = Image::default();
        SuperSampler::new(4, Kriging::Off).unwrap().super_sample(&camera, &gbuffer, &mut fresh).unwrap();
        assert_eq!(out, fresh);
    }
    let before = out.clone();
    let gbuffer = world.gbuffer(&at(0.0).low_resolution(4), [0.0; 2]);
    let error = sampler.super_sample(&small, &gbuffer, &mut out).unwrap_err();
    assert!(matches!(error, ReconstructError::Size { .. }));
    let bare = GBuffer { geometry: None, ..world.gbuffer(&small.low_resolution(4), [0.0; 2]) };
    let error = sampler.super_sample(&small, &bare, &mut out).unwrap_err();
    assert_eq!(error, ReconstructError::Missing { what: "depth" });
    // One number in the last plane, which vectors look at last, and one in the middle of colours.
    let mut broken = world.gbuffer(&small.low_resolution(4), [0.0; 2]);
    *broken.gradients.as_mut().unwrap().color_dy.data_mut().last_mut().unwrap() = f32::NEG_INFINITY;
    let error = sampler.super_sample(&small, &broken, &mut out).unwrap_err();
    assert_eq!(error, ReconstructError::NotFinite { what: "G-buffer gradients" });
    broken.color.plane_mut(1)[7] = f32::NAN;
    let error = sampler.super_sample(&small, &broken, &mut out).unwrap_err();
    assert_eq!(error, ReconstructError::NotFinite { what: "G-buffer colour" });
    assert_eq!((out, sampler.history_invalid()), (before, None));
}

/// When a camera turns left, the parts at its left edge have been sampled before, and are sharper for it. The right
/// edge is unchanged.
#[test]
fn what_a_turn_reveals_has_a_past_in_the_margin() {
    let world = wall_and_post(60.0);
    let pose = |k: usize| camera(SIZE.width, SIZE.height, [0.0; 3], -0.02 * k as f64, 0.0);
    let margin = Margin { left: 16, top: 2, right: 0, bottom: 1 };
    let super_sampled = |margin: Margin| {
        let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
        let (mut picture, mut out) = (GBuffer::default(), Image::default());
        for k in 0..10 {
            let padded = world.gbuffer_around(&pose(k).low_resolution(4), grid_jitter(4, k), margin);
            padded.crop(&mut picture);
            sampler.super_sample_padded(&pose(k), &picture, &padded, &mut out).unwrap();
        }
        (out, sampler.innovation().to_vec())
    };
    let native = world.native(&pose(9));
    let ((with, news), (without, old_news)) = (super_sampled(margin), super_sampled(Margin::NONE));
    let error = |image: &Image, columns: std::ops::Range<usize>| {
        let width = image.width();
        let pairs = image.pixels().iter().zip(native.pixels()).enumerate();
        let inside = pairs.filter(|(k, _)| columns.contains(&(k % width)));
        inside.flat_map(|(_, (a, b))| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2))).sum::<f64>()
    };
    let (left, right) = (0..16, 120..240);
    assert!(error(&with, left.clone()) < 0.5 * error(&without, left), "the revealed side");
    let (a, b) = (error(&with, right.clone()), error(&without, right));
    assert!((a / b - 1.0).abs() < 0.02, "the other side: {a} and {b}");
    // Samples at the revealed edge meet a past.
    let known = |news: &[[f32; 4]]| news.iter().step_by(60).map(|n| n[3]).sum::<f32>();
    assert_eq!((news.len(), old_news.len()), (60 * 34, 60 * 34));
    assert!(known(&news) > 2.0 * known(&old_news), "{} and {}", known(&news), known(&old_news));
}

#[test]
fn another_frames_margin_is_refused() {
    let world = wall_and_post(60.0);
    let lr = at(0.0).low_resolution(4);
    let margin = Margin { left: 2, ..Margin::NONE };
    let padded = world.gbuffer_around(&lr, [0.125; 2], margin);
    let mut picture = GBuffer::default();
    padded.crop(&mut picture);
    let refused = |picture: &GBuffer, padded: &GBuffer| {
        let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
        sampler.super_sample_padded(&at(0.0), picture, padded, &mut Image::default()).unwrap_err()
    };
    let other = GBuffer { margin: Margin::all(1), ..padded.clone() };
    let size =
        ReconstructError::Size { what: "G-buffer", expected: Size::new(62, 36), actual: Size::new(62, 34) };
    assert_eq!(refused(&picture, &other), size);
    assert!(matches!(
        refused(&picture, &GBuffer { margin: Margin::all(u32::MAX), ..padded.clone() }),
        ReconstructError::Size { .. }
    ));
    let other = GBuffer { jitter: [0.0; 2], ..padded.clone() };
    let jitter = ReconstructError::JitterAround { expected: [0.125; 2], actual: [0.0; 2] };
    assert_eq!(refused(&picture, &other), jitter);
    let other = GBuffer { gradients: None, ..padded.clone() };
    assert_eq!(refused(&picture, &other), ReconstructError::Missing { what: "image gradients" });
    let said = GBuffer { margin, ..picture.clone() };
    assert_eq!(refused(&said, &padded), ReconstructError::Margin { max: 0, actual: 2 });
}

#[test]
fn uncertainty_tells_samples_from_interpolation() {
    let world = wall_and_post(60.0);
    let first = run(&world, 4, 1, |_| at(0.0));
    let part = run(&world, 4, 15, |_| at(0.0));
    let all = run(&world, 4, 16, |_| at(0.0));
    let moving = run(&world, 4, 16, |k| at(0.02 * k as f64));
    for image in [&first, &part, &moving] {
        assert!(image.pixels().iter().all(|p| (0.0..=1.0).contains(&p[3])));
    }
    assert!(all.pixels().iter().all(|p| p[3] == 0.0), "every pixel has its sample");
    // Of fifteen frames, one pixel in sixteen has no sample of its own, but four beside it.
    let missing = part.pixels().iter().filter(|p| p[3] > 0.0).collect::<Vec<_>>();
    assert_eq!(missing.len(), part.pixels().len() / 16);
    assert!(missing.iter().all(|p| (0.3..0.8).contains(&p[3])), "{missing:?}");
    let mean = |image: &Image| image.pixels().iter().map(|p| p[3]).sum::<f32>() / image.pixels().len() as f32;
    let means = [&all, &part, &moving, &first].map(mean);
    assert!(means.is_sorted() && means[3] > 2.0 * means[2], "{means:?}");
}

#[test]
fn the_result_does_not_depend_on_the_threads() {
    let world = wall_and_post(60.0);
    let images = [1, 2, 3, 7].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run_with(Kriging::On, &world, 4, 5, |k| at(0.05 * k as f64)))
    });
    for image in &images[1..] {
        assert!(image == &images[0]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Any size, scale, jitter and motion, and depths of any kind, zero and tiny ones included: constant colour stays,
    /// and nothing becomes NaN.
    #[test]
    fn constants_stay_and_nothing_is_nan(
        width in 1_u32..50, height in 1_u32..50, scale in 1_u32..=8, seed in any::<u64>(),
        jitters in prop::collection::vec((-1.0_f32..1.0, -1.0_f32..1.0), 4),
        step in prop::array::uniform3(-2.0_f64..2.0), yaw in -2.0_f64..2.0,
    ) {
        let mut sampler = SuperSampler::new(scale, Kriging::On).unwrap();
        let mut out = Image::default();
        for (k, jitter) in jitters.iter().enumerate() {
            let camera = camera(width, height, step.map(|s| s * k as f64), yaw * k as f64, 0.0);
            let mut gbuffer = World { sheets: Vec::new() }.gbuffer(&camera.low_resolution(scale), (*jitter).into());
            gbuffer.color.data_mut().fill(0.75);
            let depths = [0.0, 1e-30, 1e-7, 0.3, 1.0, 5.0, 1e6, 1e30];
            for (i, z) in gbuffer.geometry.as_mut().unwrap().depth_median.data_mut().iter_mut().enumerate() {
                *z = depths[((seed >> (i % 61)) % 8) as usize];
            }
            sampler.super_sample(&camera, &gbuffer, &mut out).unwrap();
            for pixel in out.pixels() {
                prop_assert!((pixel[0] - 0.75).abs() < 1e-4 && (0.0..=1.0).contains(&pixel[3]), "{pixel:?}");
            }
        }
    }
}
