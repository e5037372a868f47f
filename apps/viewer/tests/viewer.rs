//! The viewer without a window: what frames come, when, and what inputs do.
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

use std::cell::Cell;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use gs3::glam::DVec3;
use gs3::scene::capture::{self, CaptureOptions};
use gs3::scene::orbit::look_at;
use gs3::scene::{Camera, Details, Gaussians, Intrinsics, OpacityMode, Scene, demo};
use gs3::{Backend, FramePipeline, Mode, PipelineSettings, Refine, SessionSettings};
use gs3_viewer::controls::Rig;
use gs3_viewer::input::{Button, Key, Touch};
use gs3_viewer::panels::Action;
use gs3_viewer::video::VideoWish;
use gs3_viewer::{Effect, Input, Next, Opened, Place, Playing, Script, Step, Viewer, ViewerSettings};

const SIZE: [u32; 2] = [240, 136];

/// A sixth of the demo's Gaussians: all tests together render some thousand frames.
fn scene() -> Arc<Scene> {
    static SCENE: LazyLock<Arc<Scene>> = LazyLock::new(|| {
        let mut gaussians = demo::scene().unwrap().into_gaussians();
        gaussians.retain(|_, i| i % 6 == 0);
        Arc::new(Scene::new(gaussians, OpacityMode::Default).unwrap())
    });
    Arc::clone(&SCENE)
}

/// A viewer, and a clock that goes on by what a test says.
struct Hand {
    viewer: Viewer,
    now: Cell<Duration>,
}

impl Hand {
    fn new() -> Self {
        Self::of(false)
    }

    fn of(native_when_fast: bool) -> Self {
        let pipeline = PipelineSettings {
            mode: Mode::SuperSample,
            refine: Refine::FrameTime(Duration::from_millis(33)),
            ..PipelineSettings::default()
        };
        let session = SessionSettings { pipeline, backend: Backend::Cpu, ..SessionSettings::default() };
        let settings = ViewerSettings { session, native_when_fast, fps: 30.0, size: SIZE };
        let viewer = Viewer::new("demo", scene(), Some(&demo::path()), settings).unwrap();
        Self { viewer, now: Cell::new(Duration::ZERO) }
    }

    /// One step at the time when it is due, or now.
    fn step(&mut self) -> Step {
        let step = self.viewer.step(&|| self.now.get());
        let next = match step.next {
            Next::At(due) => due,
            Next::Idle => self.now.get() + Duration::from_millis(33),
        };
        self.now.set(self.now.get().max(next));
        step
    }

    /// Steps until none is due, and how many there were.
    fn rest(&mut self) -> usize {
        for count in 1..400 {
            if self.step().next == Next::Idle {
                return count;
            }
        }
        panic!("never idle");
    }

    fn press(&mut self, key: Key) {
        self.viewer.input(Input::Key(key, true));
        self.viewer.input(Input::Key(key, false));
        self.step();
    }

    fn frames(&self) -> usize {
        self.viewer.figures().rendered()
    }
}

fn native(camera: &Camera) -> Vec<u8> {
    let settings = PipelineSettings { mode: Mode::Native, ..PipelineSettings::default() };
    let mut pipeline = FramePipeline::new(scene(), settings).unwrap();
    pipeline.render(camera).unwrap().current.to_rgb8()
}

fn first_camera() -> Camera {
    demo::path().cameras()[0].resized(SIZE[0], SIZE[1]).unwrap()
}

#[test]
fn a_resting_camera_reaches_the_native_image_and_then_no_frame_is_made() {
    let mut hand = Hand::new();
    hand.rest();
    assert!(hand.viewer.is_idle());
    // The history's sixteen frames, and the native one.
    assert_eq!(hand.frames(), 17);
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    // The camera is the path's, as `gs3 render` has it.
    let psnr = psnr(&hand.viewer.frame().to_rgb8(), &native(&first_camera()));
    assert!(psnr > 60.0, "{psnr:.1} dB");
    let displayed = hand.viewer.figures().displayed();
    for _ in 0..50 {
        let step = hand.step();
        assert!(!step.is_new && step.next == Next::Idle);
    }
    assert_eq!((hand.frames(), hand.viewer.figures().displayed()), (17, displayed));
}

#[test]
fn frames_of_a_moving_camera_are_native_where_that_is_fast() {
    let mut hand = Hand::of(true);
    hand.rest();
    hand.viewer.input(Input::Wheel(1.0));
    // The clock stands still while a frame is made.
    hand.step();
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    hand.rest();
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    // A comparison is with what gs3 reconstructs, so the history is completed.
    let frames = hand.frames();
    hand.press(Key::C);
    hand.rest();
    assert_eq!(hand.frames(), frames + 17);
}

#[test]
fn frames_of_a_moving_camera_are_reconstructed_where_native_ones_are_slow() {
    // A native frame takes 20 of 33 ms, and a reconstructed one as long or twice as long.
    for (reconstructed, is_native) in [(20, false), (40, true)] {
        let mut hand = Hand::of(true);
        let slowly = |hand: &mut Hand| {
            let took = if hand.frames() < 16 { reconstructed } else { 20 };
            let Hand { viewer, now } = hand;
            viewer.step(&|| {
                now.set(now.get() + Duration::from_millis(took));
                now.get()
            })
        };
        while slowly(&mut hand).next != Next::Idle {}
        hand.viewer.input(Input::Wheel(1.0));
        slowly(&mut hand);
        let shown = hand.viewer.frame().to_rgb8();
        assert_eq!(shown == native(&hand.viewer.camera().unwrap()), is_native, "{reconstructed} ms");
    }
}

#[test]
fn any_input_wakes_within_one_step() {
    let mut hand = Hand::new();
    hand.rest();
    let frames = hand.frames();
    // A pointer that only moves paints panels, and renders nothing.
    hand.viewer.input(Input::PointerMoved([100.0, 60.0]));
    assert!(!hand.viewer.is_idle() && hand.step().is_new);
    hand.rest();
    assert_eq!(hand.frames(), frames);
    hand.viewer.input(Input::Wheel(1.0));
    let before = hand.viewer.frame().clone();
    assert!(hand.step().is_new);
    assert_eq!(hand.frames(), frames + 1);
    assert_ne!(*hand.viewer.frame(), before, "the first step shows the movement");
    assert!(!hand.viewer.is_idle());
    hand.rest();
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    // A held key keeps it awake, and letting go lets it rest.
    hand.viewer.input(Input::Key(Key::W, true));
    for _ in 0..40 {
        assert!(matches!(hand.step().next, Next::At(_)));
    }
    hand.viewer.input(Input::Focused(false));
    hand.rest();
}

#[test]
fn drags_on_panels_leave_the_camera_alone() {
    let mut hand = Hand::new();
    hand.press(Key::H);
    hand.rest();
    let before = hand.viewer.camera().unwrap();
    let drag = |hand: &mut Hand| {
        hand.viewer.input(Input::PointerMoved([120.0, 68.0]));
        hand.step();
        hand.viewer.input(Input::Button(Button::Left, true));
        hand.step();
        hand.viewer.input(Input::PointerMoved([170.0, 80.0]));
        hand.viewer.input(Input::Button(Button::Left, false));
        hand.rest();
    };
    drag(&mut hand);
    assert_eq!(hand.viewer.camera().unwrap(), before);
    hand.press(Key::Escape);
    hand.rest();
    drag(&mut hand);
    assert_ne!(hand.viewer.camera().unwrap(), before);
}

#[test]
fn one_finger_orbits_and_two_pan_and_pinch() {
    let mut hand = Hand::new();
    hand.rest();
    let distance = |hand: &Hand| hand.viewer.rig().offset.length();
    let touch = |hand: &mut Hand, finger: u64, touch: Touch, at: [f32; 2]| {
        hand.viewer.input(Input::Touch(finger, touch, at));
        hand.step();
    };
    let before = *hand.viewer.rig();
    touch(&mut hand, 4, Touch::Began, [120.0, 70.0]);
    touch(&mut hand, 4, Touch::Moved, [150.0, 70.0]);
    touch(&mut hand, 4, Touch::Ended, [150.0, 70.0]);
    hand.rest();
    let turned = *hand.viewer.rig();
    assert!(turned.rotation.angle_between(before.rotation) > 0.1);
    assert_eq!(turned.pivot, before.pivot);
    // Two fingers, apart by half as much again, and their middle 10 pixels lower.
    touch(&mut hand, 1, Touch::Began, [100.0, 60.0]);
    touch(&mut hand, 2, Touch::Began, [140.0, 60.0]);
    touch(&mut hand, 2, Touch::Moved, [140.0, 70.0]);
    touch(&mut hand, 1, Touch::Moved, [80.0, 70.0]);
    hand.rest();
    let pinched = *hand.viewer.rig();
    assert!((distance(&hand) / turned.offset.length() - 40.0 / 60.0).abs() < 1e-3, "{}", distance(&hand));
    assert!(pinched.rotation.angle_between(turned.rotation) < 1e-9, "two fingers turn nothing");
    assert!(pinched.pivot.distance(turned.pivot) > 0.0);
    // One of two stays: nothing follows it, and after both are gone nothing is held.
    touch(&mut hand, 1, Touch::Ended, [80.0, 70.0]);
    touch(&mut hand, 2, Touch::Moved, [200.0, 20.0]);
    touch(&mut hand, 2, Touch::Ended, [200.0, 20.0]);
    touch(&mut hand, 9, Touch::Moved, [10.0, 10.0]);
    hand.viewer.input(Input::PointerMoved([220.0, 100.0]));
    hand.rest();
    assert_eq!(*hand.viewer.rig(), pinched);
}

/// Also where the frame of the camera is native from the start, so that the last G-buffer is one of an earlier camera.
#[test]
fn a_double_click_sets_the_pivot_on_the_surface() {
    [false, true].into_iter().for_each(check_pivot);
}

fn check_pivot(native_when_fast: bool) {
    let mut hand = Hand::of(native_when_fast);
    hand.rest();
    hand.viewer.input(Input::Wheel(-8.0));
    hand.rest();
    let before = hand.viewer.camera().unwrap();
    let at = [60.0, 100.0];
    hand.viewer.input(Input::PointerMoved(at));
    for is_down in [true, false, true, false] {
        hand.viewer.input(Input::Button(Button::Left, is_down));
    }
    hand.rest();
    let (now, then) = (hand.viewer.camera().unwrap().view_from_world(), before.view_from_world());
    assert!(now.abs_diff_eq(then, 1e-12), "the view does not move");
    // What was clicked stays where it is while the camera turns around it.
    let native = |camera: &Camera| {
        let settings = PipelineSettings { mode: Mode::SuperSample, scale: 1, ..PipelineSettings::default() };
        let mut pipeline = FramePipeline::new(scene(), settings).unwrap();
        pipeline.render(camera).unwrap();
        let geometry = pipeline.gbuffer().geometry.as_ref().unwrap();
        f64::from(geometry.depth_median.row(0, at[1] as usize)[at[0] as usize])
    };
    let point = before.unproject(gs3::glam::DVec2::new(60.0, 100.0), native(&before));
    hand.viewer.input(Input::Button(Button::Left, true));
    hand.viewer.input(Input::PointerMoved([100.0, 100.0]));
    hand.viewer.input(Input::Button(Button::Left, false));
    hand.rest();
    let after = hand.viewer.camera().unwrap();
    assert!(after.position().distance(before.position()) > 0.3);
    let moved = (after.project(point).0 - gs3::glam::DVec2::new(60.0, 100.0)).length();
    // The pivot's depth comes from a low-resolution pixel, 4 pixels wide.
    assert!(moved < 4.0, "{moved} pixels");
}

#[test]
fn what_cannot_be_opened_leaves_the_old_scene() {
    let mut hand = Hand::new();
    hand.rest();
    let (gaussians, before) = (hand.viewer.gaussians(), hand.viewer.frame().clone());
    hand.viewer.input(Input::Dropped(PathBuf::from("bad.ply")));
    hand.step();
    assert!(hand.viewer.is_opening());
    assert_eq!(hand.viewer.take_effects(), [Effect::Open(PathBuf::from("bad.ply"))]);
    hand.viewer.progress(0.5);
    hand.step();
    let message = "bad.ply: expected a scene, found nothing of the kind";
    hand.viewer.opened(Err(message.to_owned()), hand.now.get());
    hand.step();
    assert_eq!(hand.viewer.message(), Some(message));
    assert_ne!(hand.viewer.picture().pixels, before.pixels, "the message is in the picture");
    // The scene goes on under the message.
    let frames = hand.frames();
    hand.viewer.input(Input::PointerGone);
    hand.viewer.input(Input::Wheel(1.0));
    hand.rest();
    assert!(hand.frames() > frames && hand.viewer.message().is_some());
    hand.press(Key::R);
    hand.press(Key::Escape);
    assert_eq!(hand.viewer.message(), None);
    hand.rest();
    assert_eq!((hand.viewer.gaussians(), hand.viewer.frame()), (gaussians, &before));
}

#[test]
fn another_scene_is_shown_from_where_it_is_in_view() {
    let mut hand = Hand::new();
    hand.rest();
    let mut one = Gaussians::zeroed(1, 0);
    one.means[0][0] = 40.0;
    one.scales.iter_mut().for_each(|axis| axis[0] = 1.0);
    (one.rotations[0][0], one.opacities[0]) = (1.0, 0.9);
    one.sh.iter_mut().for_each(|v| *v = 1.0);
    let scene = Arc::new(Scene::new(one, OpacityMode::Default).unwrap());
    let opened = Opened::Scene { name: "one".to_owned(), scene, cameras: None };
    hand.viewer.opened(Ok(opened), hand.now.get());
    hand.rest();
    assert_eq!(hand.viewer.gaussians(), 1);
    let (pixel, z) = hand.viewer.camera().unwrap().project(DVec3::new(40.0, 0.0, 0.0));
    assert!(z > 0.0 && (pixel.x - 120.0).abs() < 1.0 && (pixel.y - 68.0).abs() < 1.0, "{pixel}");
}

/// The same Gaussians around another origin: in the file's coordinates nothing has moved.
#[test]
fn a_finer_scene_leaves_the_camera_and_its_path_where_they_are() {
    let mut hand = Hand::new();
    hand.rest();
    hand.press(Key::K);
    hand.viewer.input(Input::Wheel(1.0));
    hand.rest();
    hand.press(Key::K);
    hand.rest();
    let coarse = Arc::clone(hand.viewer.session().scene());
    let origin = DVec3::new(5.0, -1.0, 3.0);
    let mut gaussians = coarse.gaussians().clone();
    for (means, by) in gaussians.means.iter_mut().zip(origin.to_array()) {
        means.iter_mut().for_each(|mean| *mean -= by as f32);
    }
    let details = Details { origin: coarse.details().origin + origin, ..coarse.details().clone() };
    let finer = Arc::new(Scene::new(gaussians, OpacityMode::Default).unwrap().with_details(details));
    let (before, shown) = (hand.viewer.camera().unwrap(), hand.viewer.frame().to_rgb8());
    assert!(hand.viewer.opened(Ok(Opened::Finer { scene: finer }), hand.now.get()));
    hand.rest();
    let after = hand.viewer.camera().unwrap();
    assert!((after.position() + origin).distance(before.position()) < 1e-9);
    let now = hand.viewer.frame().to_rgb8();
    let different = now.iter().zip(&shown).filter(|(a, b)| a.abs_diff(**b) > 2).count();
    assert!(different * 1000 < now.len(), "{different} of {} bytes differ", now.len());
    // The path still ends at its second key, which is this camera.
    hand.viewer.act(Action::Scrub(1e9), hand.now.get());
    hand.rest();
    assert!(hand.viewer.camera().unwrap().position().distance(after.position()) < 1e-9);
}

#[test]
fn comparisons_show_each_method_on_its_side() {
    let mut hand = Hand::new();
    hand.press(Key::C);
    hand.step();
    let camera = hand.viewer.camera().unwrap();
    let expected = native(&camera);
    let half = |rgb: &[u8], columns: std::ops::Range<usize>| -> Vec<u8> {
        let rows = rgb.chunks_exact(SIZE[0] as usize * 3);
        rows.flat_map(|row| row[columns.start * 3..columns.end * 3].to_vec()).collect()
    };
    let shown = hand.viewer.frame().to_rgb8();
    assert_eq!(half(&shown, 0..120), half(&expected, 0..120));
    assert_ne!(half(&shown, 120..240), half(&expected, 120..240), "gs3 has not converged yet");
    // The divider is dragged to a quarter.
    hand.viewer.input(Input::PointerMoved([121.0, 60.0]));
    hand.viewer.input(Input::Button(Button::Left, true));
    hand.viewer.input(Input::PointerMoved([60.0, 60.0]));
    hand.viewer.input(Input::Button(Button::Left, false));
    hand.rest();
    assert_eq!(hand.viewer.camera().unwrap(), camera, "dragging a divider does not turn the camera");
    assert_eq!(hand.viewer.frame().to_rgb8(), expected, "at rest gs3 is native");
    let settings = PipelineSettings { mode: Mode::Bicubic, ..PipelineSettings::default() };
    let mut bicubic = FramePipeline::new(scene(), settings).unwrap();
    let bicubic = bicubic.render(&camera).unwrap().current.to_rgb8();
    hand.press(Key::C);
    hand.rest();
    assert_eq!(half(&hand.viewer.frame().to_rgb8(), 0..120), half(&bicubic, 0..120));
    assert_eq!(half(&hand.viewer.frame().to_rgb8(), 120..240), half(&expected, 120..240));
}

#[test]
fn a_recorded_tour_plays_ends_and_is_written() {
    let mut hand = Hand::new();
    hand.rest();
    let home = hand.viewer.camera().unwrap();
    hand.press(Key::K);
    hand.viewer.input(Input::Wheel(3.0));
    hand.rest();
    let near = hand.viewer.camera().unwrap();
    hand.press(Key::K);
    hand.press(Key::R);
    hand.rest();
    hand.press(Key::Space);
    assert!(hand.viewer.tour().playing().is_some());
    hand.rest();
    assert!(hand.viewer.tour().playing().is_none());
    assert!(hand.viewer.camera().unwrap().position().distance(near.position()) < 1e-6);
    hand.viewer.take_effects();
    hand.viewer.save_tour(Place::File(PathBuf::from("tour.json")));
    let effects = hand.viewer.take_effects();
    let [Effect::Save(Place::File(file), bytes)] = &effects[..] else { panic!("{effects:?}") };
    assert_eq!(*file, PathBuf::from("tour.json"));
    let path = capture::parse_json(bytes).unwrap();
    assert!(path.cameras()[0].position().distance(home.position()) < 1e-6);
    // Cameras that are dropped are a tour, too.
    hand.viewer.opened(Ok(Opened::Cameras { name: "tour.json".to_owned(), path }), hand.now.get());
    hand.rest();
    assert!(hand.viewer.camera().unwrap().position().distance(home.position()) < 1e-6);
    assert_eq!(hand.viewer.tour().keys(), 61);
}

/// A viewer with two keyframes that look at the scene with −y up, a bit apart.
fn hand_with_a_tour() -> Hand {
    let mut hand = Hand::new();
    // Cameras that came with the scene are no keyframes to add to.
    let intrinsics = Intrinsics::from_fov_y(SIZE[0], SIZE[1], 0.8);
    // Turned around y alone: the cameras between are level, too.
    for turn in [0.2_f64, 0.4] {
        let eye = DVec3::new(4.0 * turn.sin(), -1.0, -4.0 * turn.cos());
        let camera = look_at(eye, DVec3::new(0.0, 0.2, 0.0), DVec3::NEG_Y, intrinsics).unwrap();
        hand.viewer.look(Rig::of(&camera, 4.0));
        hand.press(Key::K);
    }
    assert_eq!(hand.viewer.tour().keys(), 2);
    hand.viewer.take_effects();
    hand
}

#[test]
fn a_tour_goes_to_supersplat_and_comes_back() {
    let mut hand = hand_with_a_tour();
    let given = hand.viewer.tour().way().unwrap().clone();
    hand.viewer.save_tour(Place::File(PathBuf::from("a/garden.settings.json")));
    let effects = hand.viewer.take_effects();
    let [Effect::Save(_, bytes)] = &effects[..] else { panic!("{effects:?}") };
    let json: serde_json::Value = serde_json::from_slice(bytes).unwrap();
    assert_eq!((&json["version"], &json["startMode"]), (&2.into(), &"animTrack".into()));
    let options = CaptureOptions { size: Some(SIZE.into()), ..CaptureOptions::default() };
    let path = capture::parse_json_with(bytes, &options).unwrap();
    hand.viewer.saved(Ok(PathBuf::from("a/garden.settings.json")), hand.now.get());
    assert_eq!(hand.viewer.note(), Some("written: a/garden.settings.json"), "nothing is left out");
    hand.viewer.opened(Ok(Opened::Cameras { name: "settings".to_owned(), path }), hand.now.get());
    let read = hand.viewer.tour().way().unwrap();
    assert_eq!((read.cameras().len(), read.frames_per_second()), (61, 30.0));
    for (read, given) in read.cameras().iter().zip(given.cameras()) {
        assert!(read.view_from_world().abs_diff_eq(given.view_from_world(), 1e-6));
        assert!((read.intrinsics().fy / given.intrinsics().fy - 1.0).abs() < 1e-6);
    }
    // The demo's cameras are level where z is up: the note says what becomes of that.
    let mut hand = Hand::new();
    hand.rest();
    hand.press(Key::K);
    hand.viewer.save_tour(Place::Numbered { stem: "camera_path", extension: "settings.json" });
    hand.viewer.saved(Ok(PathBuf::from("camera_path-0001.settings.json")), hand.now.get());
    let note = hand.viewer.note().unwrap();
    assert!(
        note.starts_with("written: camera_path-0001.settings.json; settings of SuperSplat have no roll"),
        "{note}"
    );
}

#[test]
fn the_tour_is_scrubbed_and_plays_on_from_there() {
    let mut hand = hand_with_a_tour();
    let (way, seconds) = (hand.viewer.tour().way().unwrap().clone(), hand.viewer.tour().seconds());
    assert_eq!(seconds, 2.0);
    let script = br#"{"steps": [{"do": "scrub", "at": 0.25}, {"do": "wait_idle"}]}"#;
    let mut script = Script::parse(script).unwrap();
    while script.tick(&mut hand.viewer).unwrap() == Playing::On {
        hand.step();
    }
    let near = |hand: &Hand, frame: usize| {
        let (shown, expected) = (hand.viewer.camera().unwrap().position(), way.cameras()[frame].position());
        shown.distance(expected) < 1e-6
    };
    assert!(near(&hand, 15) && !near(&hand, 14));
    hand.press(Key::Space);
    assert!(hand.viewer.tour().playing().is_some_and(|time| (0.5..0.7).contains(&time)));
    hand.rest();
    assert!(near(&hand, 60));
    // Without keyframes there is nothing to scrub.
    hand.press(Key::Backspace);
    let failure = Script::parse(br#"{"steps": [{"do": "scrub", "at": 0}]}"#).unwrap().tick(&mut hand.viewer);
    assert_eq!(failure.unwrap_err().to_string(), "steps[0]: expected at least 2 keyframes, found 1");
}

#[test]
fn a_video_is_asked_for_told_of_and_stopped() {
    let mut hand = hand_with_a_tour();
    hand.rest();
    let frames = hand.frames();
    hand.viewer.make_video(VideoWish::default());
    assert!(!hand.viewer.is_idle() && hand.viewer.video() == Some(0.0));
    hand.rest();
    let effects = hand.viewer.take_effects();
    let [Effect::Video(Place::Numbered { stem: "gs3", extension: "mp4" }, plan)] = &effects[..] else {
        panic!("{effects:?}")
    };
    let way = hand.viewer.tour().way().unwrap().resized(SIZE[0], SIZE[1]).unwrap();
    assert!(plan.path.cameras() == way.cameras() && plan.rate == 60.0, "{plan:?}");
    // Progress is painted, and renders nothing in the window.
    let before = hand.viewer.picture().clone();
    hand.viewer.video_progress(0.5);
    assert!(hand.step().is_new);
    assert_ne!(hand.viewer.picture().pixels, before.pixels);
    assert_eq!(hand.frames(), frames);
    hand.viewer.make_video(VideoWish::default());
    let message = "video: expected no other video under way, found one at 50 %";
    assert_eq!(hand.viewer.message(), Some(message));
    hand.press(Key::Escape);
    hand.viewer.stop_video();
    assert_eq!(hand.viewer.take_effects(), [Effect::StopVideo]);
    hand.viewer.video_ended(Ok(None), hand.now.get());
    assert!(hand.viewer.video().is_none() && hand.viewer.note().unwrap().contains("cancelled"));
    // With none under way nothing is to be stopped, and late news is no news.
    hand.viewer.stop_video();
    hand.viewer.video_progress(0.7);
    assert!(hand.viewer.video().is_none() && hand.viewer.take_effects().is_empty());
    hand.press(Key::Backspace);
    hand.viewer.make_video(VideoWish::default());
    assert_eq!(hand.viewer.message(), Some("video: expected at least 2 keyframes, found 1"));
    hand.viewer.video_ended(Err("a.mp4: the disk is full".to_owned()), hand.now.get());
    assert_eq!(hand.viewer.message(), Some("a.mp4: the disk is full"));
}

#[test]
fn files_are_asked_for() {
    let mut hand = Hand::new();
    hand.rest();
    hand.press(Key::O);
    assert_eq!(hand.viewer.take_effects(), [Effect::Choose]);
    hand.viewer.not_chosen("there is no dialog".to_owned());
    hand.step();
    assert_eq!(hand.viewer.message(), Some("there is no dialog"));
}

#[test]
fn large_screenshots_are_native_frames() {
    let mut hand = Hand::new();
    let shot = |scale| gs3_viewer::Shot { file: None, panels: false, scale, camera: None };
    hand.rest();
    hand.viewer.shoot(shot(2));
    hand.rest();
    let effects = hand.viewer.take_effects();
    let [Effect::Save(Place::Numbered { stem: "gs3", extension: "png" }, bytes)] = &effects[..] else {
        panic!("{} effects", effects.len())
    };
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut rgb).unwrap();
    let camera = first_camera().resized(480, 272).unwrap();
    let psnr = psnr(&rgb, &native(&camera));
    assert!(psnr > 60.0, "{psnr:.1} dB");
    // The native image is back.
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
}

#[test]
fn another_size_and_scale_are_shown_at_once() {
    let mut hand = Hand::new();
    hand.rest();
    hand.viewer.input(Input::Resized([161, 90]));
    hand.viewer.input(Input::Scale(2.0));
    hand.step();
    assert_eq!((hand.viewer.picture().size, hand.viewer.camera().unwrap().width()), ([161, 90], 161));
    hand.rest();
    assert_eq!(hand.viewer.frame().to_rgb8(), native(&hand.viewer.camera().unwrap()));
    hand.viewer.input(Input::Resized([0, 0]));
    hand.step();
    assert_eq!(hand.viewer.size(), [1, 1]);
}

#[test]
fn a_script_does_what_a_hand_does_and_tells_what_it_did_not_expect() {
    let script = |steps: &str| Script::parse(format!("{{\"steps\": [{steps}]}}").as_bytes()).unwrap();
    let play = |hand: &mut Hand, mut script: Script| loop {
        match script.tick(&mut hand.viewer)? {
            Playing::On => _ = hand.step(),
            end => return Ok(end),
        }
    };
    let mut hand = Hand::new();
    let steps = r#"{"do": "wait_idle"}, {"do": "expect", "idle": true, "keys": 600, "message": ""},
        {"do": "drag", "button": "left", "from": [0.5, 0.5], "to": [0.6, 0.5], "frames": 4}, {"do": "end"}"#;
    let steps = steps.replace("600", &demo::path().cameras().len().to_string());
    let before = first_camera();
    assert_eq!(play(&mut hand, script(&steps)), Ok::<_, gs3_viewer::ScriptFailure>(Playing::End));
    let turned = hand.viewer.camera().unwrap();
    assert!(turned.position().distance(before.position()) > 0.1);
    let failure = play(&mut hand, script(r#"{"do": "wait", "frames": 1}, {"do": "expect", "gaussians": 7}"#));
    let failure = failure.unwrap_err().to_string();
    let expected = format!("steps[1]: expected gaussians 7, found gaussians {}", hand.viewer.gaussians());
    assert_eq!(failure, expected);
}

/// Of 8-bit pictures.
fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (255.0 * 255.0 / (sum / a.len() as f64)).log10()
}
