//! The effects of inputs: on the camera, the pivot, and by keys.

use std::path::PathBuf;
use std::time::Duration;

use gs3::PipelineError;
use gs3::glam::DVec2;
use gs3::scene::Camera;
use gs3::scene::camera::MAX_SIDE;

use super::touch::Fingers;
use super::{Destination, Effect, Rest, Shot, Viewer, interval};
use crate::compare::Dividers;
use crate::controls::{Flight, Rig, flight_speed};
use crate::input::{Button, Input, Key};
use crate::panels::{Action, UPS};
use crate::video::VideoWish;
use crate::views::View;

/// Two clicks within this time and this many points are a double click: the usual setting of desktops.
const DOUBLE_CLICK: (Duration, f32) = (Duration::from_millis(500), 4.0);

/// Reach of a divider for the pointer, points.
const REACH: f32 = 6.0;

/// How long a note stays.
const NOTE: Duration = Duration::from_secs(4);

impl Viewer {
    pub(super) fn handle(&mut self, input: Input, now: Duration) {
        self.panels.input(&input, self.scale);
        match input {
            Input::PointerMoved(to) => self.point(to),
            Input::PointerGone => self.pointer = None,
            Input::Button(button, is_pressed) => self.button(button, is_pressed, now),
            Input::Touch(finger, touch, at) => self.touch(finger, touch, at, now),
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
                self.forget_frames();
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
                    self.fingers = Fingers::default();
                }
            }
        }
    }

    /// Requests to open a file or folder.
    pub fn open(&mut self, file: PathBuf) {
        let name =
            file.file_name().map_or_else(|| file.display().to_string(), |n| n.to_string_lossy().into_owned());
        self.opening = Some((name, 0.0));
        self.message = None;
        self.is_woken = true;
        self.effects.push(Effect::Open(file));
    }

    /// Reports why the user cannot be asked for files ([`Effect::Choose`]).
    pub fn not_chosen(&mut self, message: String) {
        self.message = Some(message);
        self.is_woken = true;
    }

    pub(super) fn is_over_panel(&self) -> bool {
        self.pointer.is_some_and(|at| self.panels.are_at(at, self.scale))
    }

    pub(super) fn point(&mut self, to: [f32; 2]) {
        let from = self.pointer.replace(to).unwrap_or(to);
        if self.dividers.drag(to[0], self.size.width as usize) {
            self.is_stale = true;
            return;
        }
        let delta = [0, 1].map(|axis| f64::from(to[axis] - from[axis]));
        let height = f64::from(self.size.height);
        match self.drag {
            Some(Button::Left) => self.controls.orbit(delta, height),
            Some(Button::Right) => self.controls.pan(delta, height),
            Some(Button::Middle) | None => return,
        }
        self.tour.stop();
    }

    pub(super) fn button(&mut self, button: Button, is_pressed: bool, now: Duration) {
        if !is_pressed {
            self.dividers.release();
            self.drag = self.drag.filter(|held| *held != button);
            return;
        }
        let Some(at) = self.pointer.filter(|_| !self.is_over_panel()) else { return };
        if button == Button::Left {
            if self.dividers.grab(self.compare, at[0], REACH * self.scale, self.size.width as usize) {
                return;
            }
            let is_near = |from: [f32; 2]| {
                (0..2).all(|axis| (at[axis] - from[axis]).abs() <= DOUBLE_CLICK.1 * self.scale)
            };
            let last = self.last_click.replace((now, at));
            if last.is_some_and(|(then, from)| now.saturating_sub(then) <= DOUBLE_CLICK.0 && is_near(from)) {
                self.last_click = None;
                self.pivot_at = Some(at);
                return;
            }
        }
        self.drag = Some(button);
    }

    /// Makes the G-buffer of `camera` the session's last one.
    async fn fetch_gbuffer_of(&mut self, camera: &Camera) -> Result<(), PipelineError> {
        // A frame that is native from the start has none.
        let is_native_alone = self.is_native_alone();
        let session = self.desk.session();
        session.set_in_between(0)?;
        if is_native_alone {
            session.render_async(camera).await?;
        }
        let backend = session.backend();
        session.fetch_gbuffer_async().await?;
        if session.backend() != backend {
            // The machine that took over has made no frame yet, and nothing is at rest.
            self.rest = Rest { camera: Some(*camera), ..Rest::default() };
            session.render_async(camera).await?;
        }
        Ok(())
    }

    /// Makes the surface at `at` the pivot.
    pub(super) async fn set_pivot(&mut self, at: [f32; 2], now: Duration) {
        self.wait_for_frame(now);
        let Some(camera) = self.rest.camera else { return };
        if let Err(error) = self.fetch_gbuffer_of(&camera).await {
            self.message = Some(error.to_string());
            return;
        }
        let pipeline = self.desk.session().pipeline();
        let geometry = pipeline.gbuffer().geometry.as_ref();
        let scale = pipeline.scale().max(1) as usize;
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

    pub(super) fn key(&mut self, key: Key, is_pressed: bool, now: Duration) {
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
            Key::O => self.act(Action::Open, now),
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

    /// Performs an action of a panel.
    pub fn act(&mut self, action: Action, now: Duration) {
        (self.is_woken, self.has_failed) = (true, false);
        match action {
            Action::View(view) => {
                (self.view, self.is_stale) = (view, true);
                self.rest.is_native &= view == View::Picture;
                self.drop_pictures(now);
                self.tell(format!("view: {}", view.name()), now);
            }
            Action::Compare(compare) => {
                (self.compare, self.is_stale) = (compare, true);
                self.dividers = Dividers::even(compare);
                // References are made with the next frame.
                self.rest.is_native = false;
                self.drop_pictures(now);
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
            Action::Scrub(seconds) => self.scrub(seconds),
            Action::SaveTour(format) => {
                let extension = format.extension();
                self.save_tour(Destination::Numbered { stem: "camera_path", extension });
            }
            Action::Video => self.make_video(VideoWish::default()),
            Action::StopVideo => self.stop_video(),
            Action::Open => self.effects.push(Effect::Choose),
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

    /// Shows the keyframes' path `seconds` after its beginning, or at the nearer end.
    pub fn scrub(&mut self, seconds: f64) {
        (self.is_woken, self.is_idle, self.has_failed) = (true, false, false);
        if let Some(camera) = self.tour.scrub(seconds) {
            self.jump(&camera);
        }
    }

    pub(super) fn tell(&mut self, note: String, now: Duration) {
        self.note = Some((note, now + NOTE));
        self.is_woken = true;
    }

    /// Shows the view of `camera`. The pivot keeps its distance from the camera.
    pub(super) fn jump(&mut self, camera: &Camera) {
        let distance = self.controls.shown().offset.length();
        self.controls.jump(Rig::of(camera, distance));
    }

    pub(super) fn move_camera(&mut self, seconds: f64) {
        if let Some(camera) = self.tour.advance(seconds) {
            self.jump(&camera);
        }
        let speed = flight_speed(self.modifiers.shift, self.modifiers.ctrl);
        self.controls.advance(seconds, speed);
    }
}
