//! Frames rendered in a thread of their own, with frames in between, by a real clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Wake, Waker};
use std::time::{Duration, Instant};

use gs3::scene::{Camera, Size, demo};
use gs3::{Backend, Mode, PipelineSettings, Refine, SessionSettings};
use gs3_test_support::{psnr_of_bytes, row_of_gaussians};
use gs3_viewer::input::Key;
use gs3_viewer::{Input, Next, Opened, Viewer, ViewerSettings};

use super::{SIZE, native, scene};

/// Longer than any of these tests takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

struct Apart {
    viewer: Viewer,
    started: Instant,
    /// How often the viewer asked to be stepped.
    woken: Arc<Woken>,
}

#[derive(Default)]
struct Woken(AtomicUsize);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

impl Apart {
    /// More frames a second than are rendered on any machine, so that there are frames in between.
    fn new(refine: Refine) -> Self {
        let pipeline =
            PipelineSettings { mode: Mode::Full, in_between: 3, refine, ..PipelineSettings::default() };
        let session = SessionSettings { pipeline, backend: Backend::Cpu, ..SessionSettings::default() };
        let woken = Arc::new(Woken::default());
        let waker = Some(Waker::from(Arc::clone(&woken)));
        let settings = ViewerSettings { session, native_when_fast: false, waker, fps: 1000.0, size: SIZE };
        let viewer = Viewer::new("demo", scene(), Some(&demo::path()), settings).unwrap();
        Self { viewer, started: Instant::now(), woken }
    }

    /// A step, and the pause until the next one. Returns whether there is another picture.
    fn step(&mut self) -> bool {
        let started = self.started;
        let displayed = self.viewer.figures().displayed();
        let step = self.viewer.step(&|| started.elapsed());
        if let Next::At(due) = step.next {
            std::thread::sleep(due.saturating_sub(started.elapsed()).min(Duration::from_millis(5)));
        }
        self.viewer.figures().displayed() > displayed
    }

    /// Steps until `is_done`.
    fn until(&mut self, mut is_done: impl FnMut(&Self) -> bool) {
        let begun = Instant::now();
        while !is_done(self) {
            self.step();
            assert!(begun.elapsed() < PATIENCE, "never done");
        }
    }

    fn rest(&mut self) {
        self.until(|apart| apart.viewer.is_idle());
    }
}

#[test]
fn steps_do_not_wait_for_frames() {
    let mut apart = Apart::new(Refine::FrameTime(Duration::from_millis(33)));
    apart.rest();
    assert_eq!(apart.viewer.figures().rendered(), 17);
    apart.viewer.input(Input::Wheel(1.0));
    let started = apart.started;
    // The last frame's end may be told after it was found.
    while apart.woken.0.load(Ordering::Relaxed) < 17 {
        std::thread::sleep(Duration::from_millis(1));
        assert!(started.elapsed() < PATIENCE, "never woken");
    }
    let mut step = apart.viewer.step(&|| started.elapsed());
    // The frame has been begun, and is not there yet.
    assert!(matches!(step.next, Next::At(_)) && apart.viewer.figures().rendered() == 17);
    // The end of the frame wakes the viewer, which does nothing by itself but what is due: a step that came early begins
    // no frame.
    while apart.woken.0.load(Ordering::Relaxed) < 18 {
        std::thread::sleep(Duration::from_millis(1));
        assert!(started.elapsed() < PATIENCE, "never woken");
        if let Next::At(at) = step.next
            && at <= started.elapsed()
        {
            step = apart.viewer.step(&|| started.elapsed());
        }
    }
    // The picture is shown when its time has come.
    apart.until(|apart| apart.viewer.figures().rendered() > 17);
    assert_eq!(apart.viewer.figures().rendered(), 18);
    apart.rest();
    assert_eq!(apart.viewer.frame().to_rgb8(), native(&apart.viewer.camera().unwrap()));
}

#[test]
fn a_moving_camera_has_frames_in_between_on_its_way() {
    let mut apart = Apart::new(Refine::Off);
    apart.rest();
    apart.viewer.input(Input::Key(Key::D, true));
    // (Whether it was rendered, its camera, its picture.)
    let mut shown: Vec<(bool, Camera, Vec<u8>)> = Vec::new();
    let mut rendered = apart.viewer.figures().rendered();
    let begun = Instant::now();
    while shown.iter().filter(|(is_rendered, ..)| *is_rendered).count() < 12 {
        if apart.step() {
            let now = apart.viewer.figures().rendered();
            shown.push((now > rendered, apart.viewer.camera().unwrap(), apart.viewer.frame().to_rgb8()));
            rendered = now;
        }
        assert!(begun.elapsed() < PATIENCE, "never done");
    }
    apart.viewer.input(Input::Key(Key::D, false));
    apart.rest();
    let between = shown.iter().filter(|(is_rendered, ..)| !is_rendered).count();
    assert!(between >= 12, "{between} of {}", shown.len());
    // Along the way, and never back.
    let way = shown.last().unwrap().1.position() - shown[0].1.position();
    assert!(way.length() > 0.0);
    for pair in shown.windows(2) {
        assert!((pair[1].1.position() - pair[0].1.position()).dot(way) >= -1e-9 * way.length_squared());
    }
    // A frame in between shows what its own camera sees, not what the next rendered one does.
    let place = shown.iter().rposition(|(is_rendered, ..)| !is_rendered).unwrap();
    let (_, camera, picture) = &shown[place];
    let (_, next, _) = shown[place..].iter().find(|(is_rendered, ..)| *is_rendered).unwrap();
    let [own, other] = [camera, next].map(|camera| psnr_of_bytes(picture, &native(camera)));
    assert!(own > 20.0 && own > other, "{own:.1} and {other:.1} dB");
    // At rest there are none.
    assert_eq!(apart.viewer.frame().to_rgb8(), native(&apart.viewer.camera().unwrap()));
}

#[test]
fn a_scene_that_is_opened_while_a_frame_is_under_way_is_the_one_shown() {
    let mut apart = Apart::new(Refine::FrameTime(Duration::from_millis(33)));
    apart.until(|apart| apart.viewer.figures().rendered() > 2);
    let other = Arc::new(row_of_gaussians(1, 0.2));
    let opened = Opened::Scene { name: "one".to_owned(), scene: Arc::clone(&other), cameras: None };
    assert!(apart.viewer.opened(Ok(opened), apart.started.elapsed()));
    assert_eq!(apart.viewer.gaussians(), 1);
    apart.rest();
    let settings = PipelineSettings { mode: Mode::Native, ..PipelineSettings::default() };
    let mut pipeline = gs3::FramePipeline::new(other, settings).unwrap();
    let camera = apart.viewer.camera().unwrap();
    assert_eq!(apart.viewer.frame().to_rgb8(), pipeline.render(&camera).unwrap().current.to_rgb8());
}

#[test]
fn what_needs_the_session_waits_for_the_frame_under_way() {
    let mut apart = Apart::new(Refine::FrameTime(Duration::from_millis(33)));
    apart.until(|apart| apart.viewer.figures().rendered() > 2);
    // Two clicks set the pivot, and a large screenshot is a native frame.
    for is_pressed in [true, false, true, false] {
        apart.viewer.input(Input::PointerMoved([120.0, 70.0]));
        apart.viewer.input(Input::Button(gs3_viewer::input::Button::Left, is_pressed));
    }
    apart.viewer.shoot(gs3_viewer::Shot { file: None, panels: false, scale: 2, camera: None });
    apart.step();
    assert!(apart.viewer.note().is_some_and(|note| note == "the pivot is here"), "{:?}", apart.viewer.note());
    assert_eq!(apart.viewer.take_effects().len(), 1);
    // Another view and another size come at once, too.
    apart.viewer.input(Input::Key(Key::V, true));
    apart.viewer.input(Input::Resized(Size::new(161, 90)));
    apart.rest();
    assert_eq!(apart.viewer.frame().size, [161, 90]);
    assert_eq!(apart.viewer.message(), None);
}
