//! The viewer without a window: what frames come, when, and what inputs do.
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

mod apart;
mod inputs;
mod opening;
mod pictures;
mod tours;
mod warm_up;

use gs3::scene::{Camera, OpacityMode, Scene, Size, demo};
use gs3::{Backend, FramePipeline, Mode, PipelineSettings, Refine, SessionSettings};
use gs3_test_support::psnr_of_bytes;
use gs3_viewer::input::Key;
use gs3_viewer::{Input, Next, Step, Viewer, ViewerSettings};
use std::cell::Cell;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

const SIZE: Size = Size::new(240, 136);

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
        let settings = ViewerSettings { session, native_when_fast, waker: None, fps: 30.0, size: SIZE };
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
    demo::path().cameras()[0].resized(SIZE.width, SIZE.height).unwrap()
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
    let psnr = psnr_of_bytes(&hand.viewer.frame().to_rgb8(), &native(&first_camera()));
    assert!(psnr > 60.0, "{psnr:.1} dB");
    let displayed = hand.viewer.figures().displayed();
    for _ in 0..50 {
        let step = hand.step();
        assert!(!step.is_new && step.next == Next::Idle);
    }
    assert_eq!((hand.frames(), hand.viewer.figures().displayed()), (17, displayed));
}

#[test]
fn views_of_a_resting_camera_show_something() {
    let mut hand = Hand::new();
    hand.rest();
    let picture = hand.viewer.frame().to_rgb8();
    let mut seen = vec![picture.clone()];
    for view in ["depth", "normals", "gradients"] {
        hand.press(Key::V);
        hand.rest();
        let shown = hand.viewer.frame().to_rgb8();
        assert!(shown.iter().any(|v| *v > 0) && !seen.contains(&shown), "{view}");
        seen.push(shown);
    }
    // A native frame may have neither expected errors nor exact blocks. The picture is next.
    (0..3).for_each(|_| hand.press(Key::V));
    hand.rest();
    assert!(hand.viewer.frame().to_rgb8() == picture);
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
