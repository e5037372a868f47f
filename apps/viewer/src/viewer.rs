//! The viewer without a window: inputs and time go in, pictures and wishes come out.

mod files;
mod frames;
mod inputs;
mod shown;
mod touch;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gs3::glam::DVec3;
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::orbit::{self, Bulk};
use gs3::scene::{Camera, CameraError, CameraPath, Scene};
use gs3::{PipelineError, Session, SessionSettings};

use crate::compare::{Compare, Dividers};
use crate::controls::{Controls, Rig};
use crate::figures::Figures;
use crate::input::{Button, Input, Modifiers};
use crate::paint::Picture;
use crate::panels::Panels;
use crate::tour::Tour;
use crate::views::View;
use touch::Fingers;

/// Longest time that a movement goes on by at once, seconds: after a slow frame nothing jumps.
const LONGEST_STEP: f64 = 0.1;

/// How much a new measurement of the time beside rendering counts against those before: as in the controller of exact pixels.
const NEWEST: f64 = 0.5;

/// How a viewer begins.
#[derive(Clone, Debug)]
pub struct ViewerSettings {
    /// How the session renders. [`gs3::PipelineSettings::refine`] is set by the viewer where it is a time.
    pub session: SessionSettings,
    /// Displayed frames per second that are aimed at.
    pub fps: f64,
    /// Width and height of the picture.
    pub size: [u32; 2],
}

/// A scene to show.
#[derive(Clone, Debug)]
pub enum Opened {
    /// A scene, with cameras if it came with some.
    Scene {
        /// What it is called.
        name: String,
        /// The scene.
        scene: Arc<Scene>,
        /// Its cameras.
        cameras: Option<CameraPath>,
    },
    /// Cameras for the scene that is shown.
    Cameras {
        /// What they are called.
        name: String,
        /// The cameras.
        path: CameraPath,
    },
}

/// Where something is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Here.
    File(PathBuf),
    /// The first free name of `stem-0001.extension` and so on.
    Numbered {
        /// What the name begins with.
        stem: &'static str,
        /// What it ends with.
        extension: &'static str,
    },
}

/// What the viewer wants of its surroundings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Opens a file or folder, and answers with [`Viewer::opened`].
    Open(PathBuf),
    /// Writes a file, and answers with [`Viewer::saved`].
    Save(Place, Vec<u8>),
}

/// A screenshot that is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shot {
    /// Where it goes; none is a numbered file.
    pub file: Option<PathBuf>,
    /// Whether panels are in it.
    pub panels: bool,
    /// How many times larger than the picture it is. Larger ones are native frames, without panels and comparisons.
    pub scale: u32,
    /// Where the camera goes, as a `camera_path.json`.
    pub camera: Option<PathBuf>,
}

/// When the next step is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// At this time, or at once if an input comes.
    At(Duration),
    /// Once an input comes.
    Idle,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Whether [`Viewer::picture`] has changed.
    pub is_new: bool,
    /// When the next one is due.
    pub next: Next,
}

/// Why the viewer does not begin.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// There is no session.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The picture has no size.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// How far the picture of a resting camera has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Rest {
    /// The camera of the last frame; none before the first one and where it failed.
    camera: Option<Camera>,
    /// Frames since the camera has been there.
    frames: usize,
    /// Whether the native image is shown.
    is_native: bool,
}

/// The viewer without a window.
///
/// [`Viewer::input`] takes inputs at any time; they count with the next [`Viewer::step`]. A step moves the camera, renders at
/// most one frame and paints the panels. While a camera moves, steps are due at the rate that is aimed at, and the exact
/// pixels of a frame are as many as the rate leaves time for. Once the camera rests, frames go on until the history holds
/// every pixel; the native image follows, and then no step is due until an input comes.
#[derive(Debug)]
pub struct Viewer {
    session: Session,
    controls: Controls,
    bulk: Bulk,
    name: String,
    size: [u32; 2],
    scale: f32,
    interval: Duration,
    inputs: Vec<Input>,
    pointer: Option<[f32; 2]>,
    modifiers: Modifiers,
    drag: Option<Button>,
    fingers: Fingers,
    last_click: Option<(Duration, [f32; 2])>,
    panels: Panels,
    view: View,
    compare: Compare,
    dividers: Dividers,
    tour: Tour,
    rest: Rest,
    /// Whether the last frame could not be made, and nothing has happened since.
    has_failed: bool,
    /// Whether what is shown of the frame has changed, so that it is to be composed again.
    is_stale: bool,
    /// Whether a step must paint panels in any case.
    is_woken: bool,
    is_idle: bool,
    figures: Figures,
    frame: Picture,
    picture: Picture,
    /// Seconds of a step beside rendering.
    overhead: f64,
    memory: Option<u64>,
    message: Option<String>,
    note: Option<(String, Duration)>,
    is_hovering: bool,
    opening: Option<(String, f32)>,
    shots: Vec<Shot>,
    effects: Vec<Effect>,
    last_step: Option<Duration>,
    due: Duration,
    next: Next,
    has_panels: bool,
}

impl Viewer {
    /// A viewer that shows `scene`, called `name`, from the first of `cameras`, or from where all of it is in view.
    ///
    /// # Errors
    /// [`ViewerError`] if a setting is not supported, or the GPU that is asked for is not there.
    pub fn new(
        name: &str,
        scene: Arc<Scene>,
        cameras: Option<&CameraPath>,
        settings: ViewerSettings,
    ) -> Result<Self, ViewerError> {
        let ViewerSettings { session, fps, size } = settings;
        let bulk = Bulk::of(&scene);
        let controls = Controls::new(&first_camera(&scene, cameras, size)?, &bulk);
        Ok(Self {
            session: Session::new(scene, session)?,
            controls,
            bulk,
            name: name.to_owned(),
            size,
            scale: 1.0,
            interval: interval(fps),
            inputs: Vec::new(),
            pointer: None,
            modifiers: Modifiers::default(),
            drag: None,
            fingers: Fingers::default(),
            last_click: None,
            panels: Panels::default(),
            view: View::default(),
            compare: Compare::default(),
            dividers: Dividers::default(),
            tour: cameras.map(Tour::along).unwrap_or_default(),
            rest: Rest::default(),
            has_failed: false,
            is_stale: true,
            is_woken: true,
            is_idle: false,
            figures: Figures::default(),
            frame: Picture::default(),
            picture: Picture::default(),
            overhead: 0.0,
            memory: None,
            message: None,
            note: None,
            is_hovering: false,
            opening: None,
            shots: Vec::new(),
            effects: Vec::new(),
            last_step: None,
            due: Duration::ZERO,
            next: Next::At(Duration::ZERO),
            has_panels: true,
        })
    }

    /// Takes an input, which counts with the next step.
    pub fn input(&mut self, input: Input) {
        self.inputs.push(input);
        self.is_idle = false;
    }

    /// Goes on to now. `clock` is the time since any fixed moment.
    pub fn step(&mut self, clock: &dyn Fn() -> Duration) -> Step {
        let started = clock();
        let seconds = match self.last_step {
            Some(last) if !self.figures_paused() => started.saturating_sub(last).as_secs_f64(),
            _ => self.interval.as_secs_f64(),
        };
        self.last_step = Some(started);
        let inputs = std::mem::take(&mut self.inputs);
        let mut is_due = std::mem::take(&mut self.is_woken) || !inputs.is_empty() || !self.shots.is_empty();
        is_due |= self.panels.due().is_some_and(|due| due <= started);
        is_due |= self.note.take_if(|(_, until)| *until <= started).is_some();
        self.has_failed &= inputs.is_empty();
        inputs.into_iter().for_each(|input| self.handle(input, started));
        self.move_camera(seconds.min(LONGEST_STEP));
        let (is_rendered, rendering) = self.render(clock);
        is_due |= is_rendered || self.is_stale;
        if is_due {
            self.compose();
            let actions = self.paint(started, is_rendered);
            self.figures.show(started, is_rendered);
            actions.into_iter().for_each(|action| self.act(action, started));
            self.take_shots();
            let rest = clock().saturating_sub(started).saturating_sub(rendering).as_secs_f64();
            self.overhead += NEWEST * (rest - self.overhead);
        }
        self.next = self.next(started);
        Step { is_new: is_due, next: self.next }
    }

    /// When the next step is due: what the last one said, or at once after an input or another wish.
    #[must_use]
    pub const fn next_step(&self) -> Next {
        if self.is_woken || !self.inputs.is_empty() || !self.shots.is_empty() {
            Next::At(Duration::ZERO)
        } else {
            self.next
        }
    }

    /// Tells how long the picture took to reach the screen after a step.
    pub fn presented(&mut self, took: Duration) {
        // The step's own part was followed already; this is what came on top.
        self.overhead += NEWEST * took.as_secs_f64();
    }

    fn next(&mut self, started: Duration) -> Next {
        let is_active = self.is_woken
            || self.is_stale
            || !self.inputs.is_empty()
            || !self.shots.is_empty()
            || self.controls.is_moving()
            || self.tour.playing().is_some()
            || self.is_rendering_due();
        let due = self.due + self.interval;
        // A step that came late is not made up for by hurried ones.
        self.due = if due + self.interval < started || due > started + self.interval {
            started + self.interval
        } else {
            due
        };
        if is_active {
            self.is_idle = false;
            return Next::At(self.due);
        }
        if !std::mem::replace(&mut self.is_idle, true) {
            self.figures.pause();
        }
        let note = self.note.as_ref().map(|(_, until)| *until);
        match [self.panels.due(), note].into_iter().flatten().min() {
            Some(due) => Next::At(due.max(self.due)),
            None => Next::Idle,
        }
    }

    fn figures_paused(&self) -> bool {
        self.is_idle
    }

    /// Tells how much memory the process has, bytes.
    pub const fn set_memory(&mut self, bytes: u64) {
        self.memory = Some(bytes);
    }

    /// What is wanted of the surroundings since this was asked last.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// The picture of the last step, panels included.
    #[must_use]
    pub const fn picture(&self) -> &Picture {
        &self.picture
    }

    /// What is shown of the scene, without panels.
    #[must_use]
    pub const fn frame(&self) -> &Picture {
        &self.frame
    }

    /// Width and height of the next picture.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Whether no more frames are made until something happens.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        self.is_idle
    }

    /// Whether something is being opened.
    #[must_use]
    pub const fn is_opening(&self) -> bool {
        self.opening.is_some()
    }

    /// The camera that is shown.
    #[must_use]
    pub const fn camera(&self) -> Option<Camera> {
        self.rest.camera
    }

    /// Where the camera is, and what it turns around.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        self.controls.shown()
    }

    /// The upward direction, of length 1.
    #[must_use]
    pub const fn up(&self) -> DVec3 {
        self.controls.up()
    }

    /// Moves the camera to `rig` at once.
    pub fn look(&mut self, rig: Rig) {
        self.tour.stop();
        self.controls.jump(rig);
        (self.is_woken, self.has_failed) = (true, false);
    }

    /// Whether panels, notes and messages lie over the picture; they do from the beginning.
    pub const fn set_panels(&mut self, are_shown: bool) {
        (self.has_panels, self.is_woken) = (are_shown, true);
    }

    /// The message that is shown, if there is one.
    #[must_use]
    pub fn message(&self) -> Option<&str> {
        self.message.as_deref()
    }

    /// The keyframes.
    #[must_use]
    pub const fn tour(&self) -> &Tour {
        &self.tour
    }

    /// How fast frames come.
    #[must_use]
    pub const fn figures(&self) -> &Figures {
        &self.figures
    }

    /// Number of Gaussians of the scene shown.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.session.scene().gaussians().len()
    }

    /// The time from one displayed frame to the next that is aimed at.
    #[must_use]
    pub const fn interval(&self) -> Duration {
        self.interval
    }

    /// What renders.
    #[must_use]
    pub const fn session(&self) -> &Session {
        &self.session
    }
}

/// The time from one displayed frame to the next; rates that are none are 30 a second.
fn interval(fps: f64) -> Duration {
    let fps = if fps.is_finite() { fps.clamp(1.0, 1000.0) } else { 30.0 };
    Duration::from_secs_f64(1.0 / fps)
}

/// The first of `cameras`, or one from which all of `scene` is in view, for a picture of `size`.
fn first_camera(scene: &Scene, cameras: Option<&CameraPath>, size: [u32; 2]) -> Result<Camera, CameraError> {
    let [width, height] = size.map(|side| side.clamp(1, MAX_SIDE));
    match cameras {
        Some(path) => path.cameras()[0].resized(width, height),
        None => Ok(orbit::around(scene, 1, width, height)?.cameras()[0]),
    }
}
