//! Exact pixels of frames that a GPU makes: budgets, and what frames gain.

use std::sync::Arc;
use std::time::Duration;

use gs3::scene::{Camera, Image, Scene, Size, demo};
use gs3::{Culling, FramePipeline, Mode, PipelineSettings, Quality, Refine, ResetReason};
use gs3_test_support::{part_of_demo, psnr};

use crate::gpu_frames::gpu;

fn cameras() -> Vec<Camera> {
    demo::path().resized(298, 170).unwrap().cameras().to_vec()
}

fn settings(mode: Mode, refine: Refine) -> PipelineSettings {
    PipelineSettings { mode, refine, ..Default::default() }
}

fn native(scene: &Arc<Scene>, camera: &Camera) -> Image {
    let mut pipeline = FramePipeline::new(Arc::clone(scene), settings(Mode::Native, Refine::Off)).unwrap();
    pipeline.render(camera).unwrap().current.clone()
}

#[test]
fn exact_pixels_make_better_frames_on_a_gpu() {
    let Some(gpu) = gpu() else { return };
    let (scene, cameras) = (Arc::new(part_of_demo(8)), cameras());
    let on_gpu = |refine| {
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings(Mode::Full, refine)).unwrap();
        pipeline.render_on(&gpu).unwrap();
        pipeline
    };
    // Frames without history are native as a whole, and so are frames of exact blocks alone.
    let mut auto = on_gpu(Refine::Auto);
    let first = psnr(auto.render(&cameras[0]).unwrap().current, &native(&scene, &cameras[0]));
    assert_eq!(auto.refined_share(), 1.0);
    auto.render(&cameras[1]).unwrap();
    auto.reset(ResetReason::CameraCut);
    let cut = psnr(auto.render(&cameras[40]).unwrap().current, &native(&scene, &cameras[40]));
    let mut whole = on_gpu(Refine::Share(1.0));
    whole.render(&cameras[0]).unwrap();
    let second = psnr(whole.render(&cameras[1]).unwrap().current, &native(&scene, &cameras[1]));
    eprintln!("native as a whole: {first:.1}, {cut:.1}, {second:.1} dB");
    assert!(first.min(cut).min(second) >= 60.0, "{first:.1}, {cut:.1}, {second:.1} dB");

    // Rendered frames, and the frames between them, without and with exact blocks.
    let quality = |refine| {
        let mut pipeline = on_gpu(refine);
        let (mut rendered, mut between, mut share) = (0.0, 0.0, 0.0_f32);
        for (k, camera) in cameras[..10].iter().enumerate() {
            let shown = pipeline.render(camera).unwrap();
            let (current, in_between) = (shown.current.clone(), shown.in_between[0].cloned());
            if k >= 4 {
                rendered += psnr(&current, &native(&scene, camera)) / 6.0;
                let middle = gs3::scene::camera_path::pose_between(&cameras[k - 1], camera, 0.5);
                between += psnr(&in_between.unwrap(), &native(&scene, &middle)) / 6.0;
                share = share.max(pipeline.refined_share());
            }
        }
        (rendered, between, share)
    };
    let [off, some, more] = [Refine::Off, Refine::Share(0.05), Refine::Share(0.2)].map(quality);
    eprintln!("rendered, between, share: {off:.3?}, {some:.3?}, {more:.3?}");
    assert_eq!(off.2, 0.0);
    assert!((some.2 - 0.05).abs() < 1e-3 && more.2 > some.2 && more.2 <= 0.2005, "{some:?}, {more:?}");
    assert!(more.0 > some.0 + 1.0, "{off:.2?}, {some:.2?}, {more:.2?}");
    // Exact blocks of these frames alone gain 1.7 dB.
    assert!(some.0 > off.0 + 2.5, "later frames remember exact blocks: {off:.2?}, {some:.2?}");
    assert!(some.1 > off.1 + 0.5 && more.1 > some.1 + 0.5, "{off:.2?}, {some:.2?}, {more:.2?}");
    let auto = quality(Refine::Auto);
    assert!(auto.2 > 0.0 && auto.2 <= Quality::Balanced.budget(Size::new(1, 1)).most + 1e-3, "{auto:?}");
}

#[test]
fn exact_pixels_of_a_gpu_keep_to_a_time_and_end_at_rest() {
    let Some(gpu) = gpu() else { return };
    let (scene, cameras) = (Arc::new(part_of_demo(8)), cameras());
    let with = |settings| {
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings).unwrap();
        pipeline.render_on(&gpu).unwrap();
        pipeline
    };
    // No device has this little time, and any device has this much.
    for (time, has_time) in [(Duration::from_micros(1), false), (Duration::from_secs(60), true)] {
        let mut pipeline = with(settings(Mode::SuperSample, Refine::FrameTime(time)));
        pipeline.render(&cameras[0]).unwrap();
        assert!(pipeline.refined_share() < 0.02, "{}", pipeline.refined_share());
        for camera in &cameras[1..4] {
            pipeline.render(camera).unwrap();
        }
        if gpu.capabilities().timestamps {
            let share = pipeline.refined_share();
            assert!(if has_time { share > 0.3 } else { share == 0.0 }, "{time:?}: {share}");
        }
        // From off to on and back, with the same history.
        pipeline.set_refine(Refine::Off).unwrap();
        pipeline.render(&cameras[4]).unwrap();
        assert_eq!((pipeline.refined_share(), pipeline.last_reset()), (0.0, None));
        pipeline.set_refine(Refine::Share(0.1)).unwrap();
        pipeline.render(&cameras[5]).unwrap();
        assert!(pipeline.refined_share() > 0.05 && pipeline.last_reset().is_none());
    }
    // No share is no exact pixel, of a frame without history neither.
    let mut none = with(settings(Mode::SuperSample, Refine::Share(0.0)));
    none.render(&cameras[0]).unwrap();
    assert_eq!(none.refined_share(), 0.0);
    let mut resting = with(settings(Mode::SuperSample, Refine::Auto));
    for _ in 0..17 {
        resting.render(&cameras[17]).unwrap();
    }
    assert_eq!(resting.refined_share(), 0.0, "no error is expected of samples alone");
    // Published culling cuts splats at the tiles of a low-resolution frame.
    let mut published =
        with(PipelineSettings { culling: Culling::Adr, ..settings(Mode::SuperSample, Refine::Share(0.5)) });
    published.render(&cameras[0]).unwrap();
    assert_eq!(published.refined_share(), 0.0);
}

/// A keyframe of a GPU is exact as a whole, and frames after it depend on no frame before.
#[test]
fn a_part_of_a_path_begins_at_a_keyframe_of_a_gpu() {
    let Some(gpu) = gpu() else { return };
    let (scene, cameras) = (Arc::new(part_of_demo(8)), cameras());
    let new = || {
        let settings = PipelineSettings { keyframes: 4, ..settings(Mode::Full, Refine::Share(0.05)) };
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings).unwrap();
        pipeline.render_on(&gpu).unwrap();
        pipeline
    };
    let mut whole = new();
    let frames: Vec<_> = (0..11)
        .map(|k| {
            let shown = whole.render(&cameras[k]).unwrap();
            let made = (shown.in_between[0].cloned(), shown.current.clone());
            assert_eq!(made.0.is_some(), k > 0, "in-between frames lead to keyframe {k}");
            assert_eq!(whole.refined_share() == 1.0, k % 4 == 0, "{k}");
            made
        })
        .collect();
    assert!(psnr(&frames[8].1, &native(&scene, &cameras[8])) >= 60.0);
    for number in [6, 9] {
        let mut part = new();
        let first = part.first_of_warm_up(number);
        assert_eq!(first, (number - 1) / 4 * 4);
        part.set_frame_number(first);
        for k in first..11 {
            let shown = part.render(&cameras[k as usize]).unwrap();
            if k >= number {
                let (in_between, current) = &frames[k as usize];
                assert!(shown.current == current && shown.in_between[0] == in_between.as_ref());
            }
        }
    }
}

/// Of any size, scene and margin, and of frames that stay on the device.
#[test]
fn exact_pixels_of_a_gpu_follow_sizes_scenes_and_margins() {
    let Some(gpu) = gpu() else { return };
    let [scene, other] = [8, 5].map(|every| Arc::new(part_of_demo(every)));
    let cameras = cameras();
    let with = |settings| {
        let mut pipeline = FramePipeline::new(Arc::clone(&scene), settings).unwrap();
        pipeline.render_on(&gpu).unwrap();
        pipeline
    };
    let mut all = with(settings(Mode::SuperSample, Refine::Share(1.0)));
    let small = cameras[3].resized(101, 67).unwrap();
    // What halves leave of a picture is 72 dB; steps of the formulas may take some of this.
    let floor = 60.0;
    for (camera, scene) in [(&cameras[0], &scene), (&small, &scene), (&small, &other), (&cameras[1], &other)]
    {
        if !Arc::ptr_eq(all.scene(), scene) {
            all.set_scene(Arc::clone(scene)).unwrap();
        }
        let found = psnr(all.render(camera).unwrap().current, &native(scene, camera));
        assert!(found >= floor, "{:?}: {found:.1} dB", camera.size());
    }
    // The margin follows the turn.
    let overscan = PipelineSettings { overscan: true, ..settings(Mode::SuperSample, Refine::Share(1.0)) };
    let mut turning = with(overscan);
    for k in 0..6 {
        let turn = glam::DAffine3::from_rotation_y(0.03 * f64::from(k));
        let pose = turn * cameras[0].view_from_world();
        let camera = Camera::new(pose, cameras[0].intrinsics()).unwrap();
        let found = psnr(turning.render(&camera).unwrap().current, &native(&scene, &camera));
        assert!(found >= floor, "frame {k}: {found:.1} dB");
    }

    let auto = settings(Mode::SuperSample, Refine::Auto);
    let [mut here, mut there] = [with(auto), with(auto)];
    for camera in &cameras[..4] {
        let expected = here.render(camera).unwrap().current.clone();
        let mut image = Image::default();
        there.render_to_device(camera, &[]).unwrap().current.read(&gpu, &mut image).unwrap();
        assert!(image == expected);
        assert_eq!(there.refined_share(), here.refined_share());
    }
    // Nobody waits for these frames, so nothing is known of them.
    there.submit_to_device(&cameras[4], &[]).unwrap();
    assert_eq!(there.refined_share(), 0.0);
    assert!(there.wait_for_device().unwrap());
}
