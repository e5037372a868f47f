//! The viewer without a window: inputs and time go in, pictures and wishes come out.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gs3::glam::DVec2;
use gs3::scene::camera::MAX_SIDE;
use gs3::scene::orbit::{self, Bulk};
use gs3::scene::{Camera, CameraError, CameraPath, Scene};
use gs3::{Mode, PipelineError, Refine, Session, SessionSettings, Stage};

use crate::compare::{Compare, Dividers, Method};
use crate::controls::{Controls, Flight, Rig, flight_speed};
use crate::figures::Figures;
use crate::input::{Button, Input, Key, Modifiers};
use crate::paint::Picture;
use crate::panels::{Action, Facts, Panels, UPS};
use crate::screenshot::png;
use crate::tour::{Tour, camera_path_json, moved};
use crate::views::{View, show_difference, show_image, show_view};

/// Longest time that a movement goes on by at once, seconds: after a slow frame nothing jumps.
const LONGEST_STEP: f64 = 0.1;

/// Two clicks within this time, and this many points apart, are a double click: what desktops are set to.
const DOUBLE_CLICK: (Duration, f32) = (Duration::from_millis(500), 4.0);

/// Reach of a divider for the pointer, points.
const REACH: f32 = 6.0;

/// How long a note stays.
const NOTE: Duration = Duration::from_secs(4);

/// How much a new measurement of the time beside rendering counts against those before: as in the controller of exact pixels.
const NEWEST: f64 = 0.5;

/// Part of the interval that rendering gets at least, however long the rest takes.
const LEAST_SHARE: f64 = 0.25;

/// Factor on the differences to native, so that one step of 8 bits is visible.
const DIFFERENCE_GAIN: f32 = 8.0;

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
    /// Whether a step is to paint panels, whatever else happens.
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
        Step { is_new: is_due, next: self.next(started) }
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

    fn handle(&mut self, input: Input, now: Duration) {
        self.panels.input(&input, self.scale);
        match input {
            Input::PointerMoved(to) => self.point(to),
            Input::PointerGone => self.pointer = None,
            Input::Button(button, is_pressed) => self.button(button, is_pressed, now),
            Input::Wheel(lines) => {
                if !self.is_over_panel() {
                    self.tour.stop();
                    self.controls.dolly(f64::from(lines));
                }
            }
            Input::Key(key, is_pressed) => self.key(key, is_pressed, now),
            Input::Modifiers(modifiers) => self.modifiers = modifiers,
            Input::Resized(size) => {
                self.size = size.map(|side| side.clamp(1, MAX_SIDE));
                self.is_stale = true;
            }
            Input::Scale(scale) if scale.is_finite() => self.scale = scale.clamp(0.5, 8.0),
            Input::Scale(_) => {}
            Input::Hovering(is_hovering) => self.is_hovering = is_hovering,
            Input::Dropped(file) => {
                self.is_hovering = false;
                self.open(file);
            }
            Input::Focused(is_focused) => {
                if !is_focused {
                    self.controls.release();
                    self.drag = None;
                }
            }
        }
    }

    /// Asks for a file or folder to be opened.
    pub fn open(&mut self, file: PathBuf) {
        let name =
            file.file_name().map_or_else(|| file.display().to_string(), |n| n.to_string_lossy().into_owned());
        self.opening = Some((name, 0.0));
        self.message = None;
        self.is_woken = true;
        self.effects.push(Effect::Open(file));
    }

    fn is_over_panel(&self) -> bool {
        self.pointer.is_some_and(|at| self.panels.are_at(at, self.scale))
    }

    fn point(&mut self, to: [f32; 2]) {
        let from = self.pointer.replace(to).unwrap_or(to);
        if self.dividers.drag(to[0], self.size[0] as usize) {
            self.is_stale = true;
            return;
        }
        let delta = [0, 1].map(|axis| f64::from(to[axis] - from[axis]));
        let height = f64::from(self.size[1]);
        match self.drag {
            Some(Button::Left) => self.controls.orbit(delta, height),
            Some(Button::Right) => self.controls.pan(delta, height),
            Some(Button::Middle) | None => return,
        }
        self.tour.stop();
    }

    fn button(&mut self, button: Button, is_pressed: bool, now: Duration) {
        if !is_pressed {
            self.dividers.release();
            self.drag = self.drag.filter(|held| *held != button);
            return;
        }
        let Some(at) = self.pointer.filter(|_| !self.is_over_panel()) else { return };
        if button == Button::Left {
            if self.dividers.grab(self.compare, at[0], REACH * self.scale, self.size[0] as usize) {
                return;
            }
            let is_near = |from: [f32; 2]| {
                (0..2).all(|axis| (at[axis] - from[axis]).abs() <= DOUBLE_CLICK.1 * self.scale)
            };
            let last = self.last_click.replace((now, at));
            if last.is_some_and(|(then, from)| now.saturating_sub(then) <= DOUBLE_CLICK.0 && is_near(from)) {
                self.last_click = None;
                self.set_pivot(at, now);
                return;
            }
        }
        self.drag = Some(button);
    }

    /// Makes what is seen at `at` the pivot.
    fn set_pivot(&mut self, at: [f32; 2], now: Duration) {
        if let Err(error) = self.session.fetch_gbuffer() {
            self.message = Some(error.to_string());
            return;
        }
        let Some(camera) = self.rest.camera else { return };
        let pipeline = self.session.pipeline();
        let geometry = pipeline.gbuffer().geometry.as_ref();
        let scale = pipeline.settings().scale.max(1) as usize;
        let depth =
            geometry.map(|geometry| &geometry.depth_median).filter(|d| d.width() > 0 && d.height() > 0);
        let z = depth.map(|depth| {
            let place = |v: f32, size: usize| ((v.max(0.0) as usize) / scale).min(size - 1);
            depth.row(0, place(at[1], depth.height()))[place(at[0], depth.width())]
        });
        match z.filter(|z| *z > 0.0 && z.is_finite()) {
            Some(z) => {
                let pixel = DVec2::new(f64::from(at[0]), f64::from(at[1]));
                self.controls.set_pivot(camera.unproject(pixel, f64::from(z)));
                self.tell("the pivot is here".to_owned(), now);
            }
            None => self.tell("there is no surface here for a pivot".to_owned(), now),
        }
    }

    fn key(&mut self, key: Key, is_pressed: bool, now: Duration) {
        let flight = match key {
            Key::W => Some(Flight::Forward),
            Key::S => Some(Flight::Back),
            Key::A => Some(Flight::Left),
            Key::D => Some(Flight::Right),
            Key::E => Some(Flight::Up),
            Key::Q => Some(Flight::Down),
            _ => None,
        };
        if let Some(flight) = flight {
            self.controls.hold(flight, is_pressed);
            self.tour.stop();
            return;
        }
        if !is_pressed {
            return;
        }
        match key {
            Key::F => self.act(Action::Frame, now),
            Key::R => self.act(Action::Reset, now),
            Key::OpenBracket => self.act(Action::Fov(self.controls.fov() / 1.1), now),
            Key::CloseBracket => self.act(Action::Fov(self.controls.fov() * 1.1), now),
            Key::U => {
                let current = UPS.iter().position(|(_, up)| up.dot(self.controls.up()) > 0.999);
                let (_, up) = UPS[current.map_or(0, |place| (place + 1) % UPS.len())];
                self.act(Action::Up(up), now);
            }
            Key::V => self.act(Action::View(self.view.next()), now),
            Key::C => self.act(Action::Compare(self.compare.next()), now),
            Key::K => self.act(Action::AddKey, now),
            Key::Backspace => self.act(Action::RemoveKey, now),
            Key::Space => self.act(Action::Play, now),
            Key::P => self.act(Action::Shoot(1), now),
            Key::H => self.panels.toggle_help(),
            Key::M => self.panels.toggle_menu(),
            Key::I => self.panels.toggle_figures(),
            Key::Escape => match self.message.take() {
                Some(_) => {}
                None if self.tour.playing().is_some() => self.tour.stop(),
                None => self.panels.close(),
            },
            _ => {}
        }
    }

    fn act(&mut self, action: Action, now: Duration) {
        (self.is_woken, self.has_failed) = (true, false);
        match action {
            Action::View(view) => {
                (self.view, self.is_stale) = (view, true);
                self.rest.is_native &= view == View::Picture;
                self.tell(format!("view: {}", view.name()), now);
            }
            Action::Compare(compare) => {
                (self.compare, self.is_stale) = (compare, true);
                self.dividers = Dividers::even(compare);
                // References are made with the next frame.
                self.rest.is_native = false;
                self.tell(format!("compare: {}", compare.name()), now);
            }
            Action::Fps(fps) => self.interval = interval(fps),
            Action::Fov(fov) => self.controls.set_fov(fov),
            Action::Up(up) => self.controls.set_up(up),
            Action::AddKey => {
                if let Ok(camera) = self.controls.shown().camera(self.size) {
                    self.tour.add(camera);
                    self.tell(format!("keyframe {}", self.tour.keys()), now);
                }
            }
            Action::RemoveKey => {
                self.tour.remove_last();
                self.tell(format!("keyframes: {}", self.tour.keys()), now);
            }
            Action::Play => {
                if self.tour.playing().is_some() {
                    self.tour.stop();
                } else {
                    self.tour.play();
                    if self.tour.playing().is_none() {
                        self.tell("playing needs two keyframes: K adds one".to_owned(), now);
                    }
                }
            }
            Action::Scrub(seconds) => {
                self.tour.stop();
                if let Some(camera) = self.tour.at(seconds) {
                    self.jump(&camera);
                }
            }
            Action::SaveTour => self.save_tour(None),
            Action::Shoot(scale) => self.shoot(Shot { file: None, panels: false, scale, camera: None }),
            Action::Frame => {
                self.tour.stop();
                self.controls.frame(&self.bulk);
            }
            Action::Reset => {
                self.tour.stop();
                self.controls.reset();
            }
            Action::Dismiss => self.message = None,
        }
    }

    fn tell(&mut self, note: String, now: Duration) {
        self.note = Some((note, now + NOTE));
        self.is_woken = true;
    }

    /// Shows what `camera` sees, with the pivot as far before it as it is now.
    fn jump(&mut self, camera: &Camera) {
        let distance = self.controls.shown().offset.length();
        self.controls.jump(Rig::of(camera, distance));
    }

    fn move_camera(&mut self, seconds: f64) {
        if let Some(camera) = self.tour.advance(seconds) {
            self.jump(&camera);
        }
        let speed = flight_speed(self.modifiers.shift, self.modifiers.ctrl);
        self.controls.advance(seconds, speed);
    }

    /// Frames that a resting camera takes until its history holds every pixel.
    fn frames_to_rest(&self) -> usize {
        self.session.pipeline().jitter_period()
    }

    fn is_rendering_due(&self) -> bool {
        let camera = self.controls.shown().camera(self.size).ok();
        // What failed is not tried again until something changes.
        camera.is_some()
            && !self.has_failed
            && (self.rest.camera != camera
                || self.rest.frames < self.frames_to_rest()
                || (self.view == View::Picture && !self.rest.is_native))
    }

    /// Renders at most one frame. Whether it did, and how long the session took.
    fn render(&mut self, clock: &dyn Fn() -> Duration) -> (bool, Duration) {
        if !self.is_rendering_due() {
            return (false, Duration::ZERO);
        }
        let started = clock();
        let made = self.make_frame();
        for notice in self.session.take_notices() {
            self.tell(notice, started);
        }
        if let Err(error) = made {
            self.rest = Rest::default();
            self.has_failed = true;
            self.message = Some(error.to_string());
            self.is_woken = true;
            return (false, Duration::ZERO);
        }
        self.is_stale = true;
        (true, clock().saturating_sub(started))
    }

    fn make_frame(&mut self) -> Result<(), ViewerError> {
        let camera = self.controls.shown().camera(self.size)?;
        if self.rest.camera != Some(camera) {
            self.rest = Rest { camera: Some(camera), frames: 0, is_native: false };
        }
        if self.rest.frames < self.frames_to_rest() {
            if matches!(self.session.settings().pipeline.refine, Refine::FrameTime(_)) {
                let interval = self.interval.as_secs_f64();
                let budget = (interval - self.overhead).max(LEAST_SHARE * interval);
                self.session.set_refine(Refine::FrameTime(Duration::from_secs_f64(budget)))?;
            }
            self.session.render(&camera)?;
            self.rest.frames += 1;
            if self.view.reads_gbuffer() {
                self.session.fetch_gbuffer()?;
            }
        } else {
            self.session.reference(Mode::Native, &camera)?;
            self.rest.is_native = true;
        }
        for method in self.compare.methods() {
            if let Method::Reference(mode) = method {
                self.session.reference(*mode, &camera)?;
            }
        }
        if self.compare == Compare::Difference {
            self.session.reference(Mode::Native, &camera)?;
        }
        Ok(())
    }

    /// Puts what is shown of the last frame into `frame`.
    fn compose(&mut self) {
        if !std::mem::take(&mut self.is_stale) {
            return;
        }
        let pipeline = self.session.pipeline();
        let rendered = pipeline.last_image();
        let size = [rendered.width(), rendered.height()];
        if size != self.size.map(|side| side as usize) {
            // A frame of the new size is on its way; until then there is none to show.
            self.frame.resize(self.size.map(|side| side as usize));
            self.frame.pixels.fill(0);
            return;
        }
        self.frame.resize(size);
        let native = self.session.last_reference(Mode::Native);
        let shown = native.filter(|_| self.rest.is_native).unwrap_or(rendered);
        if self.view != View::Picture {
            return show_view(self.view, pipeline, &mut self.frame);
        }
        if let (Compare::Difference, Some(native)) = (self.compare, native) {
            return show_difference(shown, native, DIFFERENCE_GAIN, &mut self.frame);
        }
        let mut from = 0;
        let mut ends = self.dividers.columns(self.compare, size[0]);
        for method in self.compare.methods() {
            let end = ends.next().unwrap_or(size[0]);
            let image = match method {
                Method::Reference(mode) => self.session.last_reference(*mode).unwrap_or(shown),
                Method::Gs3 => shown,
            };
            show_image(image, from..end, &mut self.frame);
            from = end;
        }
    }

    /// Puts the panels over the frame.
    fn paint(&mut self, now: Duration, is_rendered: bool) -> Vec<Action> {
        let facts = self.facts(is_rendered);
        self.picture.clone_from(&self.frame);
        self.panels.paint(&facts, self.scale, now, &mut self.picture)
    }

    fn facts(&self, is_rendered: bool) -> Facts {
        Facts {
            figures: self.lines(is_rendered),
            message: self.message.clone(),
            note: self.note.as_ref().map(|(note, _)| note.clone()),
            opening: self.opening.clone(),
            is_hovering: self.is_hovering,
            view: self.view,
            compare: self.compare,
            dividers: self.dividers.columns(self.compare, self.size[0] as usize).collect(),
            fps: 1.0 / self.interval.as_secs_f64(),
            fov: self.controls.fov(),
            up: self.controls.up(),
            keys: self.tour.keys(),
            tour_seconds: self.tour.seconds(),
            playing: self.tour.playing(),
        }
    }

    /// The figures, a line each.
    fn lines(&self, is_rendered: bool) -> Vec<String> {
        let pipeline = self.session.pipeline();
        let count = thousands(self.gaussians());
        let visible =
            pipeline.visible_count().map(|n| format!(", {} visible", thousands(n))).unwrap_or_default();
        let mut lines = vec![format!("{}: {count} Gaussians{visible}", self.name)];
        let is_resting = !(is_rendered || self.is_rendering_due());
        lines.push(match (is_resting, self.figures.rates()) {
            (false, Some(rates)) => format!(
                "{:.1} frames a second displayed, {:.1} rendered; interval {:.0} ms, 95 % within {:.0} ms",
                rates.displayed, rates.rendered, rates.median, rates.percentile_95
            ),
            (false, None) => "the first frame".to_owned(),
            (true, _) => "no more frames are made until something happens".to_owned(),
        });
        let times = pipeline.times();
        let stages = Stage::ALL.iter().filter_map(|stage| {
            let time = times.get(*stage)?;
            Some(format!("{} {:.1}", stage.name().replace('_', " "), time.as_secs_f64() * 1e3))
        });
        let stages: Vec<String> = stages.collect();
        if !stages.is_empty() {
            let total = times.total().as_secs_f64() * 1e3;
            lines.push(format!("{total:.1} ms a frame: {}", stages.join(", ")));
        }
        let scale = pipeline.settings().scale.max(1);
        let [width, height] = self.size;
        lines.push(format!(
            "{width}×{height} from {}×{}, {:.1} % exact besides",
            width.div_ceil(scale),
            height.div_ceil(scale),
            pipeline.refined_share() * 100.0
        ));
        let machine = self.session.adapter().unwrap_or_else(|| "CPU".to_owned());
        let memory = self.memory.map(|bytes| format!(", {} MB of memory", bytes >> 20)).unwrap_or_default();
        lines.push(format!("{machine}{memory}"));
        let frames = self.frames_to_rest();
        lines.push(match self.rest {
            Rest { is_native: true, .. } => "at rest: the native image".to_owned(),
            _ if self.controls.is_moving() || self.tour.playing().is_some() => "moving".to_owned(),
            rest => format!("at rest: {} of {frames} frames of the native image", rest.frames.min(frames)),
        });
        lines
    }

    /// Asks for a screenshot, which the next step takes.
    pub fn shoot(&mut self, shot: Shot) {
        self.shots.push(shot);
        self.is_idle = false;
    }

    fn take_shots(&mut self) {
        for shot in std::mem::take(&mut self.shots) {
            match self.take_shot(&shot) {
                Ok(bytes) => {
                    let numbered = Place::Numbered { stem: "gs3", extension: "png" };
                    self.effects.push(Effect::Save(shot.file.map_or(numbered, Place::File), bytes));
                }
                Err(message) => {
                    self.message = Some(message);
                    self.is_woken = true;
                    continue;
                }
            }
            if let (Some(file), Some(camera)) = (shot.camera, self.rest.camera)
                && let Ok(path) = CameraPath::new(vec![camera], 30.0, false)
                && let Ok(path) = moved(&path, self.session.scene().details().origin)
            {
                self.effects.push(Effect::Save(Place::File(file), camera_path_json(&path, self.size)));
            }
        }
    }

    fn take_shot(&mut self, shot: &Shot) -> Result<Vec<u8>, String> {
        let encode = |size: [u32; 2], rgb: &[u8]| png(size, rgb).map_err(|e| format!("screenshot: {e}"));
        if shot.scale <= 1 {
            let picture = if shot.panels { &self.picture } else { &self.frame };
            return encode(picture.size.map(|side| side as u32), &picture.to_rgb8());
        }
        let size = self.size.map(|side| side.saturating_mul(shot.scale));
        let rig = self.controls.shown();
        let camera = rig.camera(size).map_err(|e| format!("screenshot: {e}"))?;
        let image = self.session.reference(Mode::Native, &camera).map_err(|e| format!("screenshot: {e}"))?;
        let bytes = encode(size, &image.to_rgb8());
        // The last native frame is this one now.
        self.rest.is_native = false;
        bytes
    }

    /// Writes the keyframes to `file`; none is a numbered file.
    pub fn save_tour(&mut self, file: Option<PathBuf>) {
        // Files are in the frame of the scene's file.
        let origin = self.session.scene().details().origin;
        let Some(bytes) = self.tour.to_camera_path(self.size, origin) else {
            self.message = Some("keyframes: expected at least 1 to write, found 0".to_owned());
            self.is_woken = true;
            return;
        };
        let numbered = Place::Numbered { stem: "camera_path", extension: "json" };
        self.effects.push(Effect::Save(file.map_or(numbered, Place::File), bytes));
    }

    /// Writes figures of the frames displayed last to `file`, as JSON.
    pub fn save_figures(&mut self, file: PathBuf) {
        let pipeline = self.session.pipeline();
        let rates = self.figures.rates();
        let json = serde_json::json!({
            "displayed": self.figures.displayed(),
            "rendered": self.figures.rendered(),
            "displayed_per_second": rates.map(|rates| rates.displayed),
            "rendered_per_second": rates.map(|rates| rates.rendered),
            "interval_median_ms": rates.map(|rates| rates.median),
            "interval_95_percent_ms": rates.map(|rates| rates.percentile_95),
            "frame_ms": pipeline.times().total().as_secs_f64() * 1e3,
            "overhead_ms": self.overhead * 1e3,
            "exact_share": pipeline.refined_share(),
            "width": self.size[0],
            "height": self.size[1],
            "backend": self.session.backend().name(),
        });
        self.effects.push(Effect::Save(Place::File(file), format!("{json:#}\n").into_bytes()));
    }

    /// Tells how much of what is being opened is there, `[0, 1]`.
    pub fn progress(&mut self, share: f32) {
        if let Some((_, done)) = &mut self.opening {
            *done = share;
            self.is_woken = true;
        }
    }

    /// Shows what was opened, or says why it cannot be; then the old scene stays.
    pub fn opened(&mut self, opened: Result<Opened, String>, now: Duration) {
        self.opening = None;
        (self.is_woken, self.is_idle, self.has_failed) = (true, false, false);
        let shown = opened.and_then(|opened| self.show(opened, now).map_err(|error| error.to_string()));
        if let Err(message) = shown {
            self.message = Some(message);
        }
    }

    fn show(&mut self, opened: Opened, now: Duration) -> Result<(), ViewerError> {
        match opened {
            Opened::Scene { name, scene, cameras } => {
                let camera = first_camera(&scene, cameras.as_ref(), self.size)?;
                let bulk = Bulk::of(&scene);
                // What the file has that is not shown is told.
                let dropped = scene.dropped().total();
                let mut told = format!("opened {name}");
                if dropped > 0 {
                    told += &format!("; {dropped} invalid Gaussians are left out");
                }
                for note in &scene.details().notes {
                    told += &format!("; {note}");
                }
                self.session.set_scene(scene)?;
                self.controls = Controls::new(&camera, &bulk);
                self.tour = cameras.as_ref().map(Tour::along).unwrap_or_default();
                (self.bulk, self.rest) = (bulk, Rest::default());
                self.tell(told, now);
                self.name = name;
            }
            Opened::Cameras { name, path } if path.facts().is_panorama => {
                self.message =
                    Some(format!("{name}: expected perspective cameras, found equirectangular ones"));
            }
            Opened::Cameras { name, path } => {
                let path = moved(&path, -self.session.scene().details().origin)?;
                self.tour = Tour::along(&path);
                let first = path.cameras()[0].resized(self.size[0], self.size[1])?;
                self.jump(&first);
                self.tell(format!("{name}: {} cameras; Space plays them", self.tour.keys()), now);
            }
        }
        Ok(())
    }

    /// Tells where an [`Effect::Save`] went, or why nowhere.
    pub fn saved(&mut self, saved: Result<PathBuf, String>, now: Duration) {
        match saved {
            Ok(file) => self.tell(format!("written: {}", file.display()), now),
            Err(message) => {
                self.message = Some(message);
                self.is_woken = true;
            }
        }
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

/// A number with commas between its thousands.
fn thousands(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
