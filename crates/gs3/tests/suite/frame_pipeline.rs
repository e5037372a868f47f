//! The pipeline's promises: what rests becomes native, history ends when it must, threads do not matter.

use std::sync::Arc;

use gs3::scene::camera_path::CameraPath;
use gs3::scene::{GBuffer, Image, demo};
use gs3::{Dilation, FramePipeline, Mode, PipelineSettings, Refine, ResetReason, Sampling, Scale, Stage};
use gs3_raster::{Outputs, RasterSettings, Rasterizer};
use gs3_test_support::psnr_shown;

use crate::scene;

const WIDTH: u32 = 256;
const HEIGHT: u32 = 144;

fn path() -> CameraPath {
    demo::path().resized(WIDTH, HEIGHT).unwrap()
}

fn pipeline(mode: Mode) -> FramePipeline {
    FramePipeline::new(scene(), PipelineSettings { mode, in_between: 1, ..Default::default() }).unwrap()
}

#[test]
fn a_resting_camera_becomes_native() {
    let camera = path().cameras()[17];
    let native = pipeline(Mode::Native).render(&camera).unwrap().current.clone();
    let settings = PipelineSettings { mode: Mode::SuperSample, refine: Refine::Off, ..Default::default() };
    let mut resting = FramePipeline::new(scene(), settings).unwrap();
    let first = psnr_shown(resting.render(&camera).unwrap().current, &native);
    for _ in 1..16 {
        resting.render(&camera).unwrap();
    }
    let last = psnr_shown(resting.render(&camera).unwrap().current, &native);
    assert!(last >= 50.0 && last > first + 15.0, "{first} dB, then {last} dB");
}

#[test]
fn every_mode_shows_the_scene_and_the_order_of_quality_holds() {
    let path = path();
    let frames = 12;
    let native: Vec<Image> = {
        let mut pipeline = pipeline(Mode::Native);
        path.cameras()[..frames].iter().map(|c| pipeline.render(c).unwrap().current.clone()).collect()
    };
    let quality = |mode| {
        let mut pipeline = pipeline(mode);
        path.cameras()[..frames].iter().fold(0.0, |_, camera| {
            let shown = pipeline.render(camera).unwrap();
            psnr_shown(shown.current, &native[frames - 1])
        })
    };
    let (bicubic, super_sampled, full) =
        (quality(Mode::Bicubic), quality(Mode::SuperSample), quality(Mode::Full));
    assert!(super_sampled > bicubic + 2.0, "bicubic {bicubic} dB, super-sampled {super_sampled} dB");
    assert_eq!(full, super_sampled, "interpolation does not touch rendered frames");
}

#[test]
fn normals_are_made_for_whoever_wants_to_look_at_them() {
    let path = path();
    let cameras = &path.cameras()[..3];
    let mut looked_at = pipeline(Mode::Full);
    let mut other = pipeline(Mode::Full);
    for camera in cameras {
        looked_at.render(camera).unwrap();
        let gbuffer = looked_at.gbuffer();
        assert!(gbuffer.geometry.as_ref().unwrap().normal.data().is_empty());
        let settings = RasterSettings {
            dilation: looked_at.settings().dilation.at_scale(4),
            jitter: gbuffer.jitter,
            ..RasterSettings::new(Outputs::GBuffer)
        };
        let mut expected = GBuffer::default();
        let mut rasterizer = Rasterizer::new(scene(), looked_at.settings().culling);
        rasterizer.rasterize_low_resolution(camera, 4, &settings, &mut expected).unwrap();
        // The second time there is nothing left to make.
        for _ in 0..2 {
            looked_at.fetch_normals().unwrap();
            assert_eq!(looked_at.gbuffer(), &expected);
        }
        other.render(camera).unwrap();
        assert!(looked_at.presented().iter().eq(other.presented().iter()));
    }
    let mut bicubic = pipeline(Mode::Bicubic);
    bicubic.fetch_normals().unwrap();
    bicubic.render(&cameras[0]).unwrap();
    bicubic.fetch_normals().unwrap();
    assert_eq!(bicubic.gbuffer().geometry, None);
}

#[test]
fn full_mode_shows_the_true_moment_between() {
    let path = path();
    let (a, b, middle) = (path.at(3.0), path.at(5.0), path.at(4.0));
    let truth = pipeline(Mode::Native).render(&middle).unwrap().current.clone();
    let mut full = pipeline(Mode::Full);
    assert!(full.render(&a).unwrap().in_between == [None; 3], "nothing lies before the first frame");
    let held = psnr_shown(full.render_with_poses(&b, &[middle]).unwrap().current, &truth);
    let mut full = pipeline(Mode::Full);
    full.render(&a).unwrap();
    let shown = full.render_with_poses(&b, &[middle]).unwrap();
    assert_eq!(shown.iter().count(), 2);
    let between = psnr_shown(shown.in_between[0].unwrap(), &truth);
    assert!(between > held + 2.0, "between {between} dB, a neighbour {held} dB");
    assert!(Stage::ALL.iter().all(|stage| full.times().get(*stage).is_some()));
}

/// The frame of `camera` with no past at all.
fn fresh(mode: Mode, camera: &gs3::scene::Camera) -> Image {
    pipeline(mode).render(camera).unwrap().current.clone()
}

/// A viewer renders on a thread of its own.
const _: () = {
    const fn is_send<T: Send>() {}
    is_send::<FramePipeline>();
};

#[test]
fn history_says_why_it_ended() {
    let cameras = path().cameras().to_vec();
    let turned = {
        let pose = glam::DAffine3::from_rotation_y(std::f64::consts::PI) * cameras[0].view_from_world();
        gs3::scene::Camera::new(pose, cameras[0].intrinsics()).unwrap()
    };
    let larger = cameras[0].resized(WIDTH + 4, HEIGHT + 4).unwrap();
    let mut p = pipeline(Mode::SuperSample);
    // Nothing was there that another reason could end.
    p.reset(ResetReason::SceneChange);
    for (camera, reason) in [
        (&cameras[0], Some(ResetReason::FirstFrame)),
        (&cameras[1], None),
        (&turned, Some(ResetReason::CameraCut)),
        (&turned, None),
        (&larger, Some(ResetReason::SizeOrTierChange)),
    ] {
        p.render(camera).unwrap();
        assert_eq!(p.last_reset(), reason);
    }
    p.set_scene(Arc::clone(p.scene())).unwrap();
    // The first reason counts.
    p.reset(ResetReason::CameraCut);
    p.render(&larger).unwrap();
    assert_eq!(p.last_reset(), Some(ResetReason::SceneChange));
    p.render(&larger).unwrap();
    assert_eq!(p.last_reset(), None);
}

#[test]
fn history_ends_at_cuts_resets_new_sizes_and_new_scenes() {
    let path = path();
    let (near, far) = (path.cameras()[0], path.cameras()[0]);
    // The camera turned by half a circle about its own axis sees nothing of what it saw.
    let turned = {
        let pose = glam::DAffine3::from_rotation_y(std::f64::consts::PI) * far.view_from_world();
        gs3::scene::Camera::new(pose, far.intrinsics()).unwrap()
    };
    let mut p = pipeline(Mode::Full);
    p.render(&near).unwrap();
    let shown = p.render(&turned).unwrap();
    assert_eq!(shown.current, &fresh(Mode::Full, &turned));
    assert_eq!(shown.in_between[0], Some(&fresh(Mode::Full, &near)), "the previous frame is held over a cut");

    let next = path.cameras()[1];
    let with_history = |reset: Option<ResetReason>| {
        let mut p = pipeline(Mode::SuperSample);
        p.render(&near).unwrap();
        if let Some(reason) = reset {
            p.reset(reason);
        }
        p.render(&next).unwrap().current.clone()
    };
    let anew = fresh(Mode::SuperSample, &next);
    assert!(with_history(None) != anew, "a small motion keeps the history");
    assert!(with_history(Some(ResetReason::SceneChange)) == anew);

    let larger = next.resized(WIDTH + 5, HEIGHT + 3).unwrap();
    let mut p = pipeline(Mode::Full);
    p.render(&near).unwrap();
    let shown = p.render(&larger).unwrap();
    assert!(shown.in_between == [None; 3] && shown.current == &fresh(Mode::Full, &larger));

    let mut p = pipeline(Mode::SuperSample);
    p.render(&near).unwrap();
    p.set_scene(scene()).expect("the CPU takes any scene");
    assert!(p.render(&next).unwrap().current == &anew);
}

#[test]
fn large_frames_have_a_larger_scale_and_begin_anew() {
    let small = path().cameras()[0];
    let large = small.resized(2720, 1360).unwrap();
    for mode in [Mode::Bicubic, Mode::Full] {
        let with = |scale| {
            let settings =
                PipelineSettings { mode, scale, refine: Refine::Off, ..PipelineSettings::default() };
            FramePipeline::new(scene(), settings).unwrap()
        };
        let alone = |scale, camera| with(Scale::Fixed(scale)).render(camera).unwrap().current.clone();
        let mut p = with(Scale::Auto);
        for (camera, scale, samples) in
            [(&small, 4, [64, 36]), (&large, 6, [454, 227]), (&small, 4, [64, 36])]
        {
            assert_eq!(p.scale_of(camera), scale);
            let shown = p.render(camera).unwrap();
            assert!(shown.current == &alone(scale, camera), "{mode:?}, {}", camera.size());
            assert_eq!(p.scale(), scale);
            let color = &p.gbuffer().color;
            assert_eq!([color.width(), color.height()], samples);
            assert_eq!(p.jitter_period(), (scale * scale) as usize);
        }
        assert_eq!(p.last_reset(), Some(ResetReason::SizeOrTierChange));
    }
    let native = pipeline(Mode::Native);
    assert_eq!((native.scale_of(&small), native.scale_of(&large)), (1, 1));
}

#[test]
fn a_jump_across_an_orbit_is_a_cut_and_brisk_motion_is_none() {
    // Around the knot in the middle of the demo scene, which stays in view from everywhere.
    let intrinsics = path().cameras()[0].intrinsics();
    let target = glam::DVec3::new(0.0, 0.0, 1.25);
    let orbit = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let eye = target + glam::DVec3::new(4.0 * cos, 4.0 * sin, 0.6);
        gs3::scene::orbit::look_at(eye, target, glam::DVec3::Z, intrinsics).unwrap()
    };
    let pan = |degrees: f64| {
        let turn = glam::DAffine3::from_rotation_y(degrees.to_radians());
        gs3::scene::Camera::new(turn * orbit(0.0).view_from_world(), intrinsics).unwrap()
    };
    let is_cut = |from: gs3::scene::Camera, to: gs3::scene::Camera| {
        let mut p = pipeline(Mode::SuperSample);
        p.render(&from).unwrap();
        *p.render(&to).unwrap().current == fresh(Mode::SuperSample, &to)
    };
    for (degrees, cut) in [(1.2, false), (6.0, false), (90.0, true), (180.0, true)] {
        assert_eq!(is_cut(orbit(0.0), orbit(degrees)), cut, "orbit by {degrees}°");
    }
    for (degrees, cut) in [(3.0, false), (10.0, false), (120.0, true)] {
        assert_eq!(is_cut(pan(0.0), pan(degrees)), cut, "pan by {degrees}°");
    }
}

#[test]
fn the_number_of_frames_in_between_changes_without_losing_the_history() {
    let (path, settings) = (path(), PipelineSettings { mode: Mode::Full, ..Default::default() });
    let with = |in_between| FramePipeline::new(scene(), PipelineSettings { in_between, ..settings }).unwrap();
    let (mut changing, mut three, mut one) = (with(3), with(3), with(1));
    for (k, camera) in path.cameras()[..5].iter().enumerate() {
        let count = [3, 1, 0, 1, 3][k];
        changing.set_in_between(count as u32).unwrap();
        let images = |pipeline: &mut FramePipeline| -> Vec<Image> {
            pipeline.render(camera).unwrap().iter().cloned().collect()
        };
        let (shown, three, one) = (images(&mut changing), images(&mut three), images(&mut one));
        // The first frame has none before it.
        assert_eq!(shown.len(), if k == 0 { 1 } else { count + 1 });
        assert_eq!(shown.last(), three.last());
        match count {
            3 => assert_eq!(shown, three),
            1 => assert_eq!(shown, one),
            _ => {}
        }
        assert!(k == 0 || changing.last_reset().is_none());
    }
    let error = changing.set_in_between(4).unwrap_err();
    assert!(error.to_string().contains("expected 0 to 3 frames for each rendered one, found 4"), "{error}");
    assert_eq!(changing.settings().in_between, 3);
    // One frame in between takes one pose.
    changing.set_in_between(1).unwrap();
    assert!(changing.render_with_poses(&path.cameras()[5], &path.cameras()[..3]).is_err());
    let mut plain = pipeline(Mode::SuperSample);
    assert!(plain.set_in_between(0).is_ok() && plain.set_in_between(1).is_err());
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let path = path();
    let frames = |threads: usize| -> Vec<Image> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut p = pipeline(Mode::Full);
            let render = |camera| -> Vec<Image> { p.render(camera).unwrap().iter().cloned().collect() };
            path.cameras()[..3].iter().flat_map(render).collect()
        })
    };
    let one = frames(1);
    assert_eq!(one.len(), 5);
    assert!(one == frames(3));
}

/// What is refused leaves no trace: the frames after it are those that would have come without.
#[test]
fn refused_cameras_change_nothing() {
    let (path, small) = (path(), demo::path().resized(WIDTH / 2, HEIGHT / 2).unwrap());
    let shown = |refused: bool| {
        let mut pipeline = pipeline(Mode::Full);
        let mut shown = Vec::new();
        for (k, camera) in path.cameras()[..4].iter().enumerate() {
            if refused {
                let last = pipeline.last_image().clone();
                let error =
                    pipeline.render_with_poses(camera, &small.cameras()[..1]).unwrap_err().to_string();
                assert_eq!(error, "camera between two frames: expected 256x144 pixels, found 128x72");
                assert!(*pipeline.last_image() == last, "frame {k}");
            }
            shown.extend(pipeline.render(camera).unwrap().iter().cloned());
        }
        shown
    };
    assert_eq!(shown(false).len(), 7);
    assert!(shown(true) == shown(false));
}

#[test]
fn settings_out_of_range_are_errors() {
    let settings = |scale| PipelineSettings { scale: Scale::Fixed(scale), ..Default::default() };
    let error = FramePipeline::new(scene(), settings(0)).err().unwrap();
    assert!(error.to_string().contains("scale: expected 1 to"), "{error}");
    let settings = PipelineSettings { dilation: Dilation::Value(-1.0), ..Default::default() };
    let error = FramePipeline::new(scene(), settings).err().unwrap();
    assert!(error.to_string().contains("dilation: expected"), "{error}");
    let settings = PipelineSettings { background: [f32::NAN; 3], ..Default::default() };
    let error = FramePipeline::new(scene(), settings).err().unwrap();
    assert!(error.to_string().contains("background: expected"), "{error}");
    let settings = PipelineSettings { mode: Mode::Native, in_between: 0, ..Default::default() };
    assert!(FramePipeline::new(scene(), settings).is_ok(), "native frames have none between");
    let centered = PipelineSettings { sampling: Sampling::Centered, ..Default::default() };
    let mut p = FramePipeline::new(scene(), centered).unwrap();
    p.render(&path().cameras()[0]).unwrap();
    assert_eq!(p.gbuffer().jitter, [0.0, 0.0]);
}
