//! Frame interpolation at the true middle pose.

use crate::common::{Sheet, World, camera, wall_and_post};
use crate::refine::exact_blocks;
use crate::world::psnr_where;
use gs3_reconstruct::{BlockGradients, Interpolator, Neighbor, ReconstructError, Reprojected, Warped};
use gs3_scene::{Camera, GBuffer, Image, block_grid};
use gs3_test_support::psnr;
use proptest::prelude::*;

struct Frame {
    camera: Camera,
    image: Image,
    gbuffer: GBuffer,
}

impl Frame {
    /// The exact HR frame and its LR frame.
    fn of(world: &World, camera: Camera, scale: u32, jitter: [f32; 2]) -> Self {
        let gbuffer = world.gbuffer(&camera.low_resolution(scale), jitter);
        Self { camera, image: world.native(&camera), gbuffer }
    }

    fn neighbor(&self) -> Neighbor<'_> {
        Neighbor { camera: &self.camera, image: &self.image, gbuffer: &self.gbuffer, gradients: None }
    }
}

fn pose(x: f64) -> Camera {
    camera(240, 136, [x, 0.0, 0.0], 0.0, 0.0)
}

/// The columns at which the post of [`wall_and_post`] begins and ends.
fn silhouettes_at(x: f64) -> [f64; 2] {
    [-0.25, 0.25].map(|edge| pose(x).project([edge, 0.0, 3.0].into()).0.x)
}

fn neighbors(world: &World, x: [f64; 2]) -> [Frame; 2] {
    [(x[0], [0.1, -0.2]), (x[1], [-0.3, 0.2])].map(|(x, jitter)| Frame::of(world, pose(x), 4, jitter))
}

fn between(world: &World, x: [f64; 2], t: f32) -> (Image, Image) {
    let [before, after] = neighbors(world, x);
    let middle = pose(x[0] + (x[1] - x[0]) * f64::from(t));
    let mut out = Image::default();
    let mut interpolator = Interpolator::new(4).unwrap();
    interpolator.interpolate(before.neighbor(), after.neighbor(), t, &middle, &mut out).unwrap();
    (out, world.native(&middle))
}

#[test]
fn a_moving_wall_is_where_it_should_be() {
    let world = World { sheets: vec![Sheet::endless(6.0, 3, 40.0)] };
    for t in [0.2, 1.0 / 3.0, 0.5, 2.0 / 3.0, 0.8] {
        let (out, native) = between(&world, [0.0, 0.3], t);
        let (repeated, _) = between(&world, [0.0, 0.3], 0.0);
        let (moved, repeated) = (psnr(&out, &native), psnr(&repeated, &native));
        assert!(moved > 38.0 && moved > repeated + 15.0, "t {t}: {moved:.2} dB, repeated {repeated:.2} dB");
    }
}

#[test]
fn the_ends_of_the_interval_are_the_neighbors() {
    let world = wall_and_post(40.0);
    for t in [0.0, 1.0] {
        let (out, native) = between(&world, [0.0, 0.2], t);
        assert!(psnr(&out, &native) > 70.0, "t {t}: {:.2} dB", psnr(&out, &native));
    }
}

#[test]
fn occlusion_and_holes_are_filled_from_the_neighbor_that_sees() {
    let world = wall_and_post(40.0);
    let (out, native) = between(&world, [0.0, 1.0], 0.5);
    // Each neighbour hides 10 columns of the wall beside the post that the middle frame shows. A blend with the post
    // there would be off by 0.1 in red. The silhouettes themselves are known to one LR pixel only.
    let silhouettes = silhouettes_at(0.5);
    for x in 0..out.width() {
        if silhouettes.iter().any(|s| (x as f64 + 0.5 - s).abs() < 4.0) {
            continue;
        }
        let mean = |image: &Image| (0..136).map(|y| image.row(y)[x][0]).sum::<f32>() / 136.0;
        assert!((mean(&out) - mean(&native)).abs() < 0.04, "column {x}: {} {}", mean(&out), mean(&native));
    }
}

/// Pixels beside a silhouette may have the depth of the wrong surface. One neighbour then shows the post there and the
/// other one the wall: 27.1 and 30.5 dB, if both are blended.
#[test]
fn silhouettes_leave_no_ghosts() {
    let world = wall_and_post(10.0);
    for x in [0.25, 0.3] {
        let (out, native) = between(&world, [0.0, x], 0.5);
        let silhouettes = silhouettes_at(0.5 * x);
        let is_beside = |k: usize| {
            let column = (k % native.width()) as f64 + 0.5;
            silhouettes.iter().any(|s| (column - s).abs() < 4.0)
        };
        let beside = psnr_where(&out, &native, is_beside);
        assert!(beside > 35.0, "moved by {x}: {beside:.2} dB");
    }
}

#[test]
fn times_other_than_the_middle_see_what_is_there() {
    let world = wall_and_post(40.0);
    for t in [1.0 / 3.0, 2.0 / 3.0] {
        let (out, native) = between(&world, [0.0, 0.3], t);
        let (wrong, _) = between(&world, [0.0, 0.3], 1.0 - t);
        let (right, wrong) = (psnr(&out, &native), psnr(&wrong, &native));
        assert!(
            right > 30.0 && right > wrong + 10.0,
            "t {t}: {right:.2} dB, at the other time {wrong:.2} dB"
        );
    }
}

#[test]
fn the_less_uncertain_neighbor_counts_more() {
    let world = wall_and_post(40.0);
    let of = |color: f32, uncertainty: f32| {
        let mut frame = Frame::of(&world, pose(0.0), 4, [0.1, -0.2]);
        frame.image.pixels_mut().fill([color, color, color, uncertainty]);
        frame
    };
    let mut interpolator = Interpolator::new(4).unwrap();
    let mut out = Image::default();
    // With the 0.05 px² that warping leaves, the first is 5 times less sure, then as sure, then neither can be.
    for (uncertainty, t, expected) in
        [([0.45, 0.05], 0.5, 5.0 / 6.0), ([0.3, 0.3], 0.25, 0.25), ([0.0, 0.0], 0.75, 0.75)]
    {
        let [before, after] = [of(0.0, uncertainty[0]), of(1.0, uncertainty[1])];
        interpolator.interpolate(before.neighbor(), after.neighbor(), t, &pose(0.0), &mut out).unwrap();
        // Beside the post both are seen alike, too: the camera rests.
        for (k, [r, ..]) in out.pixels().iter().enumerate() {
            assert!((r - expected).abs() < 1e-4, "pixel {k}: {r} instead of {expected}");
        }
    }
}

/// A square in one neighbour alone: its blocks, and only these, are expected to err, by the square of the difference times the
/// shares. At scales where patches begin at blocks, between blocks, and one pixel before them.
#[test]
fn blocks_where_the_neighbors_differ_are_expected_to_err() {
    let camera = pose(0.0);
    let world = wall_and_post(40.0);
    for scale in [1, 2, 4, 6, 8] {
        let [before, mut after] = [(); 2].map(|()| Frame::of(&world, camera, scale, [0.0; 2]));
        let square = |x: usize, y: usize| (32..48).contains(&x) && (24..40).contains(&y);
        let width = after.image.width();
        for (k, (pixel, old)) in after.image.pixels_mut().iter_mut().zip(before.image.pixels()).enumerate() {
            let change = if square(k % width, k / width) { 0.25 } else { 0.0 };
            *pixel = [old[0] + change, old[1], old[2], old[3]];
        }
        let mut interpolator = Interpolator::new(scale).unwrap();
        let (mut out, mut errors) = (Image::default(), Vec::new());
        interpolator.interpolate(before.neighbor(), after.neighbor(), 0.25, &camera, &mut out).unwrap();
        interpolator.expected_errors(&mut errors);
        let [columns, rows] = block_grid(camera.size());
        assert_eq!(errors.len(), columns * rows);
        for (k, error) in errors.iter().enumerate() {
            let [x, y] = [k % columns * 4, k / columns * 4];
            // The neighbours are equally uncertain, so their shares depend on the time alone. The factor 3.6 is `SHARED`.
            let inside = 3.6 * 16.0 * 0.25 * 0.75 * 0.25_f32.powi(2);
            let is_within = (36..44).contains(&x) && (28..36).contains(&y);
            let is_beside = (28..52).contains(&x) && (20..44).contains(&y);
            if is_within {
                assert!((error / inside - 1.0).abs() < 1e-3, "scale {scale}, {x}, {y}: {error} of {inside}");
            } else if !is_beside {
                assert!(*error < 1e-6, "scale {scale}, {x}, {y}: {error}");
            }
        }
        let all: f32 = errors.iter().sum();
        interpolator.set_has_errors(false);
        interpolator.interpolate(before.neighbor(), after.neighbor(), 0.25, &camera, &mut out).unwrap();
        interpolator.expected_errors(&mut errors);
        assert!(errors.iter().all(|error| *error == 0.0), "they were not asked for");
        let expected = 3.6 * 256.0 * 0.25 * 0.75 * 0.25_f32.powi(2);
        assert!((all / expected - 1.0).abs() < 0.02, "scale {scale}: {all} of {expected}");
    }
}

/// Texture finer than a pixel moves by parts of a pixel. Where both neighbours are exact, their derivatives tell what is between
/// pixels; nothing else changes.
#[test]
fn derivatives_of_exact_blocks_tell_detail_between_pixels() {
    let world = World { sheets: vec![Sheet::endless(6.0, 3, 90.0)] };
    let (x, t) = ([0.0, 0.05], 0.5);
    let frames = neighbors(&world, x);
    let native = world.native(&pose(0.025));
    let places: Vec<[u16; 2]> = (0..34).flat_map(|row| (30..60).map(move |column| [column, row])).collect();
    let gradients = frames.each_ref().map(|frame| {
        let mut gradients = BlockGradients::default();
        gradients.clear(frame.camera.size());
        gradients.add(&exact_blocks(&world, &frame.camera, places.clone()));
        gradients
    });
    let made = |with: bool| {
        let [before, after] = [0, 1].map(|k| Neighbor {
            gradients: if with { gradients[k].some() } else { None },
            ..frames[k].neighbor()
        });
        let (mut out, mut interpolator) = (Image::default(), Interpolator::new(4).unwrap());
        interpolator.interpolate(before, after, t, &pose(0.025), &mut out).unwrap();
        out
    };
    let [without, with] = [false, true].map(made);
    let [old, new] = [&without, &with].map(|out| psnr_where(out, &native, |k| k % 240 >= 128));
    assert!(new > old + 3.0, "{new:.2} dB, without derivatives {old:.2} dB");
    let left = |image: &Image| -> Vec<[f32; 4]> {
        image.pixels().iter().enumerate().filter(|(k, _)| k % 240 < 112).map(|(_, pixel)| *pixel).collect()
    };
    assert_eq!(left(&with), left(&without));
    // Derivatives of another size are refused.
    let mut other = BlockGradients::default();
    other.clear(gs3_scene::Size::new(8, 8));
    let wrong = Neighbor { gradients: Some(&other), ..frames[0].neighbor() };
    let mut interpolator = Interpolator::new(4).unwrap();
    let error = interpolator.interpolate(wrong, frames[1].neighbor(), t, &pose(0.025), &mut Image::default());
    assert_eq!(error.unwrap_err().to_string(), "neighbour gradients: expected 240x136 pixels, found 8x8");
}

#[test]
fn warped_neighbors_blended_by_their_share_are_the_frame() {
    let world = wall_and_post(40.0);
    let [mut before, mut after] = neighbors(&world, [0.0, 0.7]);
    for (frame, every) in [(&mut before, 7), (&mut after, 11)] {
        for (k, pixel) in frame.image.pixels_mut().iter_mut().enumerate() {
            pixel[3] = (k % every) as f32 / every as f32;
        }
    }
    let mut interpolator = Interpolator::new(4).unwrap();
    let (mut blended, mut warped) = (Image::default(), Warped::default());
    for t in [1.0 / 3.0, 0.5, 0.9] {
        let middle = pose(0.7 * f64::from(t));
        let (before, after) = (before.neighbor(), after.neighbor());
        interpolator.interpolate(before, after, t, &middle, &mut blended).unwrap();
        interpolator.warp(before, after, t, &middle, &mut warped).unwrap();
        let mut most_different = 0.0_f32;
        for (k, pixel) in blended.pixels().iter().enumerate() {
            let (a, b, share) = (warped.before.pixels()[k], warped.after.pixels()[k], warped.share.data()[k]);
            for c in 0..4 {
                let mix = (1.0 - share) * a[c] + share * b[c];
                assert!((mix - pixel[c]).abs() < 1e-4, "t {t}, pixel {k}: {mix}, {}", pixel[c]);
                most_different = most_different.max((a[c] - b[c]).abs());
            }
        }
        assert!(most_different > 0.1, "the neighbours do not show the same everywhere");
    }
}

#[test]
fn one_neighbor_reprojected_is_that_of_both_warped() {
    let world = wall_and_post(40.0);
    let [before, now] = neighbors(&world, [0.0, 0.7]);
    let (before, now) = (before.neighbor(), now.neighbor());
    let mut interpolator = Interpolator::new(4).unwrap();
    let (mut warped, mut reprojected) = (Warped::default(), Reprojected::default());
    interpolator.warp(before, now, 0.5, now.camera, &mut warped).unwrap();
    interpolator.reproject(before, now, &mut reprojected).unwrap();
    // Beside silhouettes, both neighbours together may find another surface.
    let silhouettes = silhouettes_at(0.7);
    let width = reprojected.image.width();
    let mut different = 0;
    for (k, pixel) in reprojected.image.pixels().iter().enumerate() {
        let is_same = (0..4).all(|c| (pixel[c] - warped.before.pixels()[k][c]).abs() < 1e-6)
            && reprojected.visibility.data()[k] == warped.visibility.plane(0)[k];
        let is_beside = silhouettes.iter().any(|s| ((k % width) as f64 + 0.5 - s).abs() < 20.0);
        assert!(is_same || is_beside, "pixel {k}");
        different += usize::from(!is_same);
    }
    assert!(different * 50 < reprojected.image.pixels().len(), "{different} pixels differ");
    let seen = reprojected.visibility.data().iter().filter(|v| **v == 1.0).count();
    assert!(seen > 0 && seen < reprojected.visibility.data().len(), "{seen} pixels are seen");
}

#[test]
fn warped_neighbors_say_what_they_see() {
    let world = wall_and_post(40.0);
    let frames = neighbors(&world, [0.0, 1.0]);
    let middle = pose(0.5);
    let mut warped = Warped::default();
    let mut interpolator = Interpolator::new(4).unwrap();
    let [before, after] = frames.each_ref().map(Frame::neighbor);
    interpolator.warp(before, after, 0.5, &middle, &mut warped).unwrap();
    let native = world.native(&middle);
    let (width, height) = (native.width(), native.height());
    let ([mut seen, mut hidden], [mut error_seen, mut error_hidden]) = ([0, 0], [0.0; 2]);
    for (n, image) in [&warped.before, &warped.after].into_iter().enumerate() {
        for (k, &visibility) in warped.visibility.plane(n).iter().enumerate() {
            assert!((0.0..=1.0).contains(&visibility));
            let error: f32 = (0..3).map(|c| (image.pixels()[k][c] - native.pixels()[k][c]).abs()).sum();
            if visibility == 1.0 {
                seen += 1;
                error_seen += error;
            }
            if visibility < 1e-4 {
                hidden += 1;
                error_hidden += error;
            }
            // Even where a neighbour does not see it, there is something; the fourth channel, here alpha, is warped
            // too.
            assert!((image.pixels()[k][3] - 1.0).abs() < 1e-3, "neighbour {n}, pixel {k}");
        }
    }
    assert!(seen > width * height && hidden > width * height / 20, "{seen}, {hidden}");
    let (mean_seen, mean_hidden) = (error_seen / seen as f32, error_hidden / hidden as f32);
    assert!(mean_seen < 0.02 && mean_hidden > 0.1, "{mean_seen}, {mean_hidden}");
    // Shares follow from visibility and time.
    for k in 0..width * height {
        let [a, b] = [0, 1].map(|n| warped.visibility.plane(n)[k]);
        let share = b / (a + b);
        assert!((warped.share.data()[k] - share).abs() < 2e-4);
    }
    // Depths equal the middle pose's depths, except within one LR pixel of silhouettes.
    let lr_camera = middle.low_resolution(4);
    let [mut right, mut count] = [0, 0];
    for y in 0..warped.inverse_depth.height() {
        for (x, w) in warped.inverse_depth.row(0, y).iter().enumerate() {
            let z = world.sample(&lr_camera, glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).depth;
            count += 1;
            right += usize::from((f64::from(*w) * z - 1.0).abs() < 0.01);
        }
    }
    assert!(right > count * 95 / 100, "{right} of {count}");
}

#[test]
fn the_result_does_not_depend_on_the_threads() {
    let world = wall_and_post(40.0);
    let images = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| between(&world, [0.0, 0.25], 0.5).0)
    });
    assert!(images[1..].iter().all(|image| image == &images[0]));
    let [before, after] = neighbors(&world, [0.0, 0.25]);
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut warped = Warped::default();
        let mut interpolator = Interpolator::new(4).unwrap();
        pool.install(|| {
            interpolator.warp(before.neighbor(), after.neighbor(), 0.5, &pose(0.125), &mut warped).unwrap();
        });
        (warped.before, warped.after, warped.share, warped.visibility, warped.inverse_depth)
    });
    assert!(one == three);
}

#[test]
fn wrong_inputs_are_typed_errors() {
    let world = wall_and_post(40.0);
    let frame = Frame::of(&world, pose(0.0), 4, [0.0; 2]);
    let mut interpolator = Interpolator::new(4).unwrap();
    let mut out = Image::default();
    let n = frame.neighbor();
    let error = interpolator.interpolate(n, n, f32::NAN, &frame.camera, &mut out).unwrap_err();
    assert!(matches!(error, ReconstructError::Time { .. }));
    let small = camera(64, 36, [0.0; 3], 0.0, 0.0);
    let error = interpolator.interpolate(n, n, 0.5, &small, &mut out).unwrap_err();
    assert!(matches!(error, ReconstructError::Size { what: "neighbour camera", .. }));
    let bare = GBuffer { geometry: None, ..frame.gbuffer.clone() };
    let error = interpolator
        .interpolate(n, Neighbor { gbuffer: &bare, ..n }, 0.5, &frame.camera, &mut out)
        .unwrap_err();
    assert_eq!(error, ReconstructError::Missing { what: "depth" });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn constants_stay_and_nothing_is_nan(
        width in 1_u32..50, height in 1_u32..50, scale in 1_u32..=8, seed in any::<u64>(), t in 0.0_f32..=1.0,
        step in prop::array::uniform3(-2.0_f64..2.0), yaw in -2.0_f64..2.0,
    ) {
        let frames = [0.0, 1.0].map(|k| {
            let camera = camera(width, height, step.map(|s| s * k), yaw * k, 0.0);
            let mut frame = Frame::of(&World { sheets: Vec::new() }, camera, scale, [0.4, -0.9]);
            frame.image.pixels_mut().fill([0.25, 0.5, 0.75, 1.0]);
            let depths = [0.0, 1e-30, 1e-7, 0.3, 1.0, 5.0, 1e6, 1e30];
            for (i, z) in frame.gbuffer.geometry.as_mut().unwrap().depth_median.data_mut().iter_mut().enumerate() {
                *z = depths[((seed >> (i % 61)) % 8) as usize];
            }
            frame
        });
        let middle = camera(width, height, step.map(|s| s * 0.5), yaw * 0.5, 0.0);
        let mut out = Image::default();
        let mut interpolator = Interpolator::new(scale).unwrap();
        interpolator.interpolate(frames[0].neighbor(), frames[1].neighbor(), t, &middle, &mut out).unwrap();
        for pixel in out.pixels() {
            for (value, expected) in pixel.iter().zip([0.25, 0.5, 0.75, 1.0]) {
                prop_assert!((value - expected).abs() < 1e-5, "{pixel:?}");
            }
        }
        let mut warped = Warped::default();
        interpolator.warp(frames[0].neighbor(), frames[1].neighbor(), t, &middle, &mut warped).unwrap();
        for pixel in warped.before.pixels().iter().chain(warped.after.pixels()) {
            for (value, expected) in pixel.iter().zip([0.25, 0.5, 0.75, 1.0]) {
                prop_assert!((value - expected).abs() < 1e-5, "{pixel:?}");
            }
        }
        for values in [warped.share.data(), warped.visibility.data()] {
            prop_assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
        }
        prop_assert!(warped.inverse_depth.data().iter().all(|w| w.is_finite() && *w >= 0.0));
    }
}
