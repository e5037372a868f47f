//! Frames that nobody waits for: what they tell is known one frame late.

use std::sync::Arc;

use gs3::glam::{DAffine3, DVec3};
use gs3::raster::Culling;
use gs3::scene::{Camera, Gaussians, Image, Intrinsics, OpacityMode, Scene, demo};
use gs3::{FramePipeline, Mode, PipelineSettings, Refine, ResetReason};
use gs3_test_support::part_of_demo;

use crate::gpu_frames::gpu;

fn settings(mode: Mode) -> PipelineSettings {
    PipelineSettings { mode, refine: Refine::Off, in_between: 1, ..Default::default() }
}

/// A camera at `place` that looks along z, with a picture of `size`.
fn camera(place: DVec3, size: [u32; 2]) -> Camera {
    let intrinsics = Intrinsics::from_fov_y(size[0], size[1], 0.8);
    Camera::new(DAffine3::from_translation(-place), intrinsics).unwrap()
}

#[test]
fn jumps_along_a_near_wall_are_cuts_once_its_depth_is_known() {
    let Some(gpu) = gpu() else { return };
    // A wall of 60 × 2 flat Gaussians at depth 1.
    let mut wall = Gaussians::zeroed(120, 0);
    for k in 0..120 {
        wall.means[0][k] = 0.5 * (k / 2) as f32 - 15.0;
        wall.means[1][k] = 0.5 * (k % 2) as f32 - 0.25;
        wall.means[2][k] = 1.0;
    }
    wall.scales.iter_mut().for_each(|scales| scales.fill(0.3));
    wall.scales[2].fill(0.01);
    wall.rotations[0].fill(1.0);
    wall.opacities.fill(0.99);
    let wall = Scene::new(wall, OpacityMode::Default).unwrap();
    let mut pipeline = FramePipeline::new(wall, settings(Mode::SuperSample)).unwrap();
    pipeline.render_on(&gpu).unwrap();
    let at = |x: f64| camera(DVec3::new(x, 0.0, 0.0), [128, 72]);
    let mut submit = |x: f64| {
        pipeline.submit_to_device(&at(x), &[]).unwrap();
        pipeline.last_reset()
    };
    assert_eq!(submit(0.0), Some(ResetReason::FirstFrame));
    // Nothing is known of the first frame yet, and what is far away moves little.
    assert_eq!(submit(3.0), None);
    // From here on the wall is known to be near.
    assert_eq!(submit(3.01), None);
    assert_eq!(submit(6.0), Some(ResetReason::CameraCut));
    // The frame before the last one is one before the cut: its depths are of another view.
    assert_eq!(submit(9.0), None);
    assert!(pipeline.wait_for_device().unwrap());
    // All of them are done, so the last frame is known, too.
    pipeline.submit_to_device(&at(12.0), &[]).unwrap();
    assert_eq!(pipeline.last_reset(), Some(ResetReason::CameraCut));
}

/// Frames that nobody waits for have the same bits again, read one by one or after all others, and a frame that is waited for may
/// come between them.
#[test]
fn late_frames_are_the_same_again() {
    let Some(gpu) = gpu() else { return };
    let scene = Arc::new(part_of_demo(8));
    let path = demo::path().resized(160, 88).unwrap();
    let run = |first_read: usize| {
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings(Mode::Full)).unwrap();
        pipeline.render_on(&gpu).unwrap();
        let mut shown = Vec::new();
        for (k, camera) in path.cameras()[..7].iter().enumerate() {
            let presented = match k {
                4 => pipeline.render_to_device(camera, &[]).unwrap(),
                _ => pipeline.submit_to_device(camera, &[]).unwrap(),
            };
            if k < first_read {
                continue;
            }
            for image in presented.in_between.iter().chain([presented.current]) {
                let mut out = Image::default();
                image.read(&gpu, &mut out).unwrap();
                shown.push(out);
            }
        }
        assert!(pipeline.wait_for_device().unwrap());
        shown
    };
    let shown = run(0);
    assert_eq!(shown.len(), 13);
    // Reading waits for the device. Without it, frames are on their way when later ones are recorded.
    assert!(run(6) == shown[11..]);
}

#[test]
fn an_overflow_is_settled_one_frame_late() {
    let Some(gpu) = gpu() else { return };
    // All over the picture: 50 × 4,096 tiles of an LR frame of 8×8 pixels each, where at first there is room for 16 a tile.
    let mut large = Gaussians::zeroed(50, 0);
    large.scales.iter_mut().for_each(|scales| scales.fill(100.0));
    large.rotations[0].fill(1.0);
    large.opacities.fill(0.9);
    let scene = Arc::new(Scene::new(large, OpacityMode::Default).unwrap());
    let settings = PipelineSettings { culling: Culling::AccuTile, ..settings(Mode::SuperSample) };
    let new = || {
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings).unwrap();
        pipeline.render_on(&gpu).unwrap();
        pipeline
    };
    let [before, behind] = [5.0, -5.0].map(|z| camera(DVec3::new(0.0, 0.0, -z), [2048, 2048]));
    let mut pipeline = new();
    let mut submit = |camera: &Camera| {
        pipeline.submit_to_device(camera, &[]).unwrap();
        pipeline.last_reset()
    };
    assert_eq!(submit(&behind), Some(ResetReason::FirstFrame));
    let found: Vec<_> = (0..4).map(|_| submit(&before)).collect();
    // The second frame is on its way before anything is known of the first one, which overflows.
    assert_eq!(found, [None, None, Some(ResetReason::Failure), None]);
    assert!(!pipeline.wait_for_device().unwrap());
    // Later frames are whole.
    let mut expected = new();
    expected.render(&before).unwrap();
    pipeline.reset(ResetReason::CameraCut);
    let mut image = Image::default();
    pipeline.submit_to_device(&before, &[]).unwrap().current.read(&gpu, &mut image).unwrap();
    assert!(image == *expected.last_image());
    assert!(pipeline.wait_for_device().unwrap());
}
