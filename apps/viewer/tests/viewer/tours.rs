//! Keyframes, their path and its video.

use gs3::glam::DVec3;
use gs3::scene::Intrinsics;
use gs3::scene::capture::{self, CaptureOptions};
use gs3::scene::orbit::look_at;
use gs3_viewer::controls::Rig;
use gs3_viewer::input::Key;
use gs3_viewer::video::VideoWish;
use gs3_viewer::{Destination, Effect, Input, Opened, Playing, Script};
use std::path::PathBuf;

use super::{Hand, SIZE};

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
    hand.viewer.save_tour(Destination::File(PathBuf::from("tour.json")));
    let effects = hand.viewer.take_effects();
    let [Effect::Save(Destination::File(file), bytes)] = &effects[..] else { panic!("{effects:?}") };
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
    let intrinsics = Intrinsics::from_fov_y(SIZE.width, SIZE.height, 0.8);
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
    hand.viewer.save_tour(Destination::File(PathBuf::from("a/garden.settings.json")));
    let effects = hand.viewer.take_effects();
    let [Effect::Save(_, bytes)] = &effects[..] else { panic!("{effects:?}") };
    let json: serde_json::Value = serde_json::from_slice(bytes).unwrap();
    assert_eq!((&json["version"], &json["startMode"]), (&2.into(), &"animTrack".into()));
    let options = CaptureOptions { size: Some(SIZE), ..CaptureOptions::default() };
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
    hand.viewer.save_tour(Destination::Numbered { stem: "camera_path", extension: "settings.json" });
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
    let [Effect::Video(Destination::Numbered { stem: "gs3", extension: "mp4" }, plan)] = &effects[..] else {
        panic!("{effects:?}")
    };
    let way = hand.viewer.tour().way().unwrap().resized(SIZE.width, SIZE.height).unwrap();
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
