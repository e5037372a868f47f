//! Exact pixels in the pipeline: bits, budgets, and what frames gain.

use std::time::Duration;

use gs3::scene::camera_path::CameraPath;
use gs3::scene::{Camera, Image, demo};
use gs3::{FramePipeline, Mode, PipelineError, PipelineSettings, Quality, Refine, ResetReason};
use gs3_test_support::psnr_shown;

use crate::scene;

fn path() -> CameraPath {
    demo::path().resized(320, 180).unwrap()
}

fn pipeline(mode: Mode, refine: Refine) -> FramePipeline {
    FramePipeline::new(scene(), PipelineSettings { mode, refine, ..Default::default() }).unwrap()
}

fn native(camera: &Camera) -> Image {
    pipeline(Mode::Native, Refine::Off).render(camera).unwrap().current.clone()
}

fn rgb(image: &Image) -> impl Iterator<Item = [u32; 3]> + '_ {
    image.pixels().iter().map(|pixel| [pixel[0], pixel[1], pixel[2]].map(f32::to_bits))
}

#[test]
fn all_pixels_exact_are_the_native_image_bit_for_bit() {
    let path = path();
    let mut all = pipeline(Mode::SuperSample, Refine::Share(1.0));
    for camera in &path.cameras()[..3] {
        let image = all.render(camera).unwrap().current.clone();
        assert!(rgb(&image).eq(rgb(&native(camera))));
        assert_eq!(all.refined_share(), 1.0);
    }
}

#[test]
fn frames_without_history_are_exact_as_a_whole() {
    let path = path();
    let (first, second) = (path.cameras()[0], path.cameras()[40]);
    let mut auto = pipeline(Mode::Full, Refine::Auto);
    assert!(rgb(auto.render(&first).unwrap().current).eq(rgb(&native(&first))));
    auto.render(&path.cameras()[1]).unwrap();
    let share = auto.refined_share();
    assert!(share > 0.0 && share <= Quality::Balanced.budget(first.size()).most + 1e-3, "{share}");
    auto.reset(ResetReason::CameraCut);
    assert!(rgb(auto.render(&second).unwrap().current).eq(rgb(&native(&second))));
    assert_eq!((auto.refined_share(), auto.last_reset()), (1.0, Some(ResetReason::CameraCut)));
    // An interactive program must not wait for a whole native frame.
    let mut interactive = pipeline(Mode::Full, Refine::FrameTime(Duration::from_millis(20)));
    interactive.render(&first).unwrap();
    assert!(interactive.refined_share() < 0.05, "{}", interactive.refined_share());
}

#[test]
fn more_exact_pixels_give_better_frames() {
    let path = path();
    let truth: Vec<Image> = path.cameras()[4..12].iter().map(native).collect();
    let quality = |refine| {
        let mut pipeline = pipeline(Mode::SuperSample, refine);
        let mut sum = 0.0;
        for (k, camera) in path.cameras()[..12].iter().enumerate() {
            let image = pipeline.render(camera).unwrap().current;
            if k >= 4 {
                sum += psnr_shown(image, &truth[k - 4]) / 8.0;
            }
        }
        sum
    };
    let [off, some, more] = [Refine::Off, Refine::Share(0.05), Refine::Share(0.2)].map(quality);
    assert!(some > off + 1.0 && more > some + 1.0, "{off:.2} dB off, {some:.2} dB, {more:.2} dB");
}

/// With quality high in-between frames have blocks with the native image's bits where the neighbours disagree. With quality balanced
/// they have none.
#[test]
fn frames_between_are_exact_where_their_neighbors_disagree() {
    let path = path();
    // The share of a frame's blocks that are native, and the frame's PSNR, over ten frames.
    let between = |quality: Quality| {
        let settings = PipelineSettings { quality, in_between: 1, ..Default::default() };
        let mut pipeline = FramePipeline::new(scene(), settings).unwrap();
        let (mut exact, mut quality) = (0, 0.0);
        for k in 0..12 {
            let middle = path.at(k as f64 - 0.5);
            let poses = if k == 0 { &[][..] } else { std::slice::from_ref(&middle) };
            let shown = pipeline.render_with_poses(&path.cameras()[k], poses).unwrap();
            if let Some(image) = shown.in_between[0].filter(|_| k > 1) {
                let truth = native(&middle);
                quality += psnr_shown(image, &truth) / 10.0;
                let same: Vec<bool> = rgb(image).zip(rgb(&truth)).map(|(a, b)| a == b).collect();
                let is_native = |x: usize, y: usize| {
                    (0..16)
                        .all(|i| same[(y + i / 4) * 320 + x + i % 4] && truth.pixels()[y * 320 + x][3] > 0.5)
                };
                let blocks = (0..180).step_by(4).flat_map(|y| (0..320).step_by(4).map(move |x| (x, y)));
                exact += blocks.filter(|(x, y)| is_native(*x, *y)).count();
            }
        }
        (exact as f64 / 36_000.0, quality)
    };
    let [(none, without), (some, with)] = [Quality::Balanced, Quality::High].map(between);
    let most = f64::from(Quality::High.budget_between().unwrap().most);
    assert!(none < 0.001 && some > 0.01 && some <= most + 0.001, "{none} and {some} of at most {most}");
    assert!(with > without + 0.5, "{with:.2} dB, without {without:.2} dB");
}

#[test]
fn better_quality_refines_more() {
    let path = path();
    let shares = Quality::ALL.map(|quality| {
        let settings = PipelineSettings { mode: Mode::SuperSample, quality, ..Default::default() };
        let mut pipeline = FramePipeline::new(scene(), settings).unwrap();
        for camera in &path.cameras()[..4] {
            pipeline.render(camera).unwrap();
        }
        pipeline.refined_share()
    });
    assert!(shares[0] < shares[1] && shares[1] < shares[2], "{shares:?}");
}

#[test]
fn a_resting_camera_is_native_after_sixteen_frames_within_any_budget() {
    let camera = path().cameras()[17];
    let truth = native(&camera);
    let mut resting = pipeline(Mode::SuperSample, Refine::FrameTime(Duration::from_micros(1)));
    for _ in 0..16 {
        resting.render(&camera).unwrap();
    }
    let reached = psnr_shown(resting.last_image(), &truth);
    assert!(reached > 80.0, "{reached:.2} dB");
    let before = resting.last_image().clone();
    resting.render(&camera).unwrap();
    assert_eq!(resting.refined_share(), 0.0, "nothing is left to refine");
    assert!(psnr_shown(resting.last_image(), &before) > 80.0);
}

#[test]
fn a_share_that_is_none_is_refused() {
    for share in [-0.1, 1.5, f32::NAN] {
        let settings = PipelineSettings { refine: Refine::Share(share), ..Default::default() };
        let refused = FramePipeline::new(scene(), settings);
        assert!(matches!(refused, Err(PipelineError::RefineShare { .. })), "{share}");
    }
}
