//! What hands and scripts do.

use gs3::scene::{Camera, demo};
use gs3::{FramePipeline, Mode, PipelineSettings, Scale};
use gs3_viewer::input::{Button, Key, Touch};
use gs3_viewer::{Input, Next, Playing, Script};

use super::{Hand, first_camera, native, scene};

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
        let settings = PipelineSettings {
            mode: Mode::SuperSample,
            scale: Scale::Fixed(1),
            ..PipelineSettings::default()
        };
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
