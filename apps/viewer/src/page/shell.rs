//! What JavaScript calls.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gs3::scene::Size;
use js_sys::{Array, Object, Reflect, Uint8Array};
use wasm_bindgen::prelude::*;
use web_time::Instant;

use super::{CameraPlace, PageSettings};
use crate::input::{Button, Input, Key, Modifiers, Touch};
use crate::opening::{FileMap, Opening, OpeningStep, nothing};
use crate::panels::Action;
use crate::viewer::{Destination, Effect, Next, Opened, Viewer};

/// The viewer of a page. Positions are pixels of the picture; JSON is text.
#[wasm_bindgen]
#[derive(Debug)]
pub struct PageViewer {
    viewer: Viewer,
    started: Instant,
    budget: Option<u64>,
    /// What is being opened, by numbers that grow.
    openings: BTreeMap<u32, Opening>,
}

/// The number of threads that render.
#[wasm_bindgen(js_name = threadCount)]
#[must_use]
pub fn thread_count() -> usize {
    rayon::current_num_threads()
}

fn failure(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

#[wasm_bindgen]
impl PageViewer {
    /// A promise of a viewer without a scene. `settings` is a `PageSettings`.
    ///
    /// # Errors
    /// One line with what was expected and what was found.
    pub async fn open(settings: String) -> Result<Self, JsError> {
        console_error_panic_hook::set_once();
        let settings = PageSettings::parse(&settings).map_err(failure)?;
        let (budget, settings) = (settings.budget, settings.viewer().map_err(failure)?);
        let nothing = Arc::new(nothing().map_err(failure)?);
        let viewer = Viewer::new_async("no scene", nothing, None, settings).await.map_err(failure)?;
        Ok(Self { viewer, started: Instant::now(), budget, openings: BTreeMap::new() })
    }

    /// Goes on to now: a promise of whether the picture is another. Until it is settled, nothing else may be called.
    pub async fn step(&mut self) -> bool {
        let started = self.started;
        self.viewer.step_async(&|| started.elapsed()).await.is_new
    }

    /// The machine that renders: `cpu` or `gpu`.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn backend(&self) -> String {
        self.viewer.backend().to_string()
    }

    /// Milliseconds until the next step is due; negative if that takes an input.
    #[wasm_bindgen(js_name = untilNext)]
    pub fn until_next(&self) -> f64 {
        match self.viewer.next_step() {
            Next::At(due) => due.saturating_sub(self.started.elapsed()).as_secs_f64() * 1e3,
            Next::Idle => -1.0,
        }
    }

    /// Tells how many milliseconds the picture took to the screen.
    pub fn presented(&mut self, milliseconds: f64) {
        self.viewer.presented(Duration::from_secs_f64((milliseconds / 1e3).clamp(0.0, 60.0)));
    }

    /// The picture, RGBA, row by row.
    #[must_use]
    pub fn rgba(&self) -> wasm_bindgen::Clamped<Vec<u8>> {
        wasm_bindgen::Clamped(self.viewer.picture().to_rgba8())
    }

    /// Width of [`Self::rgba`].
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn width(&self) -> u32 {
        self.viewer.picture().size[0] as u32
    }

    /// Height of [`Self::rgba`].
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn height(&self) -> u32 {
        self.viewer.picture().size[1] as u32
    }

    /// The pointer is here.
    #[wasm_bindgen(js_name = pointerMoved)]
    pub fn pointer_moved(&mut self, x: f32, y: f32) {
        self.viewer.input(Input::PointerMoved([x, y]));
    }

    /// The pointer is elsewhere.
    #[wasm_bindgen(js_name = pointerGone)]
    pub fn pointer_gone(&mut self) {
        self.viewer.input(Input::PointerGone);
    }

    /// A button goes down or up: 0 left, 1 middle, 2 right, as in a `MouseEvent`. Others do nothing.
    pub fn button(&mut self, button: u32, is_pressed: bool) {
        let button = match button {
            0 => Button::Left,
            1 => Button::Middle,
            2 => Button::Right,
            _ => return,
        };
        self.viewer.input(Input::Button(button, is_pressed));
    }

    /// A finger touches the screen (`pointerdown`), moves (`pointermove`), or leaves (all else).
    pub fn touch(&mut self, finger: u32, event: &str, x: f32, y: f32) {
        let touch = match event {
            "pointerdown" => Touch::Began,
            "pointermove" => Touch::Moved,
            _ => Touch::Ended,
        };
        self.viewer.input(Input::Touch(u64::from(finger), touch, [x, y]));
    }

    /// The wheel turns, in lines; positive is away from the hand.
    pub fn wheel(&mut self, lines: f32) {
        self.viewer.input(Input::Wheel(lines));
    }

    /// A key goes down or up, as `KeyboardEvent.key` names it. Whether the viewer knows it.
    pub fn key(&mut self, key: &str, is_pressed: bool) -> bool {
        let key = match key {
            " " => Some(Key::Space),
            _ => Key::from_name(&key.to_uppercase()).or_else(|| Key::from_name(key)),
        };
        key.map(|key| self.viewer.input(Input::Key(key, is_pressed))).is_some()
    }

    /// The keys that are held.
    pub fn modifiers(&mut self, shift: bool, ctrl: bool, alt: bool) {
        self.viewer.input(Input::Modifiers(Modifiers { shift, ctrl, alt }));
    }

    /// The picture has this width and height.
    pub fn resized(&mut self, width: u32, height: u32) {
        self.viewer.input(Input::Resized(Size::new(width, height)));
    }

    /// So many pixels of the picture are one point of a panel's text.
    pub fn scale(&mut self, scale: f32) {
        self.viewer.input(Input::Scale(scale));
    }

    /// A file is held over the page, or no longer.
    pub fn hovering(&mut self, is_hovering: bool) {
        self.viewer.input(Input::Hovering(is_hovering));
    }

    /// The page gets the keyboard, or loses it.
    pub fn focused(&mut self, is_focused: bool) {
        self.viewer.input(Input::Focused(is_focused));
    }

    /// Asks for `name` to be opened: an effect asks for its files.
    #[wasm_bindgen(js_name = ask)]
    pub fn open_name(&mut self, name: &str) {
        self.viewer.input(Input::Dropped(PathBuf::from(name)));
    }

    /// Tells how much of what is being opened is there, 0 to 1.
    pub fn progress(&mut self, share: f32) {
        self.viewer.progress(share);
    }

    /// Takes the scene or the cameras in `files`, an array of `[path, Uint8Array]`, as opening `number`, which is above all
    /// before; `demo` needs none. If `can_fetch`, there is one file, and what it names can be fetched.
    pub fn begin(&mut self, number: u32, name: &str, files: &Array, can_fetch: bool) {
        let files = files.iter().filter_map(|entry| {
            let entry: Array = entry.dyn_into().ok()?;
            let bytes: Uint8Array = entry.get(1).dyn_into().ok()?;
            Some((entry.get(0).as_string()?, bytes.to_vec()))
        });
        let opening = Opening::new(name, files.collect::<FileMap>(), can_fetch, self.budget);
        self.openings.insert(number, opening);
    }

    /// Takes a file that [`Self::go_on`] asked for. Returns whether opening `number` is still under way.
    pub fn supply(&mut self, number: u32, path: &str, bytes: Vec<u8>) -> bool {
        let Some(opening) = self.openings.get_mut(&number) else { return false };
        opening.supply(path, bytes);
        true
    }

    /// Goes on with opening `number`, as far as its files are there: the paths of files that are missing, from the folder of
    /// the first one; an empty array once a coarse scene is shown; nothing at its end. A scene ends all openings before it.
    #[wasm_bindgen(js_name = goOn)]
    pub fn go_on(&mut self, number: u32) -> Option<Array> {
        let opening = self.openings.get_mut(&number)?;
        let step = match opening.go_on(self.viewer.size()) {
            Ok(OpeningStep::Missing(names)) => return Some(names.into_iter().map(JsValue::from).collect()),
            other => other,
        };
        let is_coarse = matches!(step, Ok(OpeningStep::Coarse(_)));
        let opened = step.map(|step| match step {
            OpeningStep::Coarse(opened) | OpeningStep::Done(opened) => Some(opened),
            OpeningStep::Missing(_) => None,
        });
        let opened = opened.transpose()?;
        let is_scene = matches!(opened, Ok(Opened::Scene { .. }));
        let is_shown = self.viewer.opened(opened, self.started.elapsed());
        if is_scene && is_shown {
            self.openings.retain(|other, _| *other >= number);
        }
        let goes_on = is_coarse && is_shown;
        if !goes_on {
            self.openings.remove(&number);
        }
        self.tell_of_openings();
        goes_on.then(Array::new)
    }

    /// Says why opening `number` is given up; the old scene stays.
    pub fn failed(&mut self, number: u32, message: &str) {
        if self.openings.remove(&number).is_some() {
            self.viewer.opened(Err(message.to_owned()), self.started.elapsed());
            self.tell_of_openings();
        }
    }

    /// Shows that something is still being opened.
    fn tell_of_openings(&mut self) {
        if let Some((_, opening)) = self.openings.last_key_value() {
            self.viewer.expect(opening.name());
        }
    }

    /// Says why the user cannot be asked for files, or what else cannot be.
    #[wasm_bindgen(js_name = notChosen)]
    pub fn not_chosen(&mut self, message: &str) {
        self.viewer.not_chosen(message.to_owned());
    }

    /// What the viewer wants: an array of `{kind: "open", name}`, `{kind: "save", stem, extension, bytes}` and
    /// `{kind: "choose"}`.
    #[wasm_bindgen(js_name = takeEffects)]
    pub fn take_effects(&mut self) -> Array {
        self.viewer.take_effects().into_iter().filter_map(describe).map(JsValue::from).collect()
    }

    /// Tells under which name a file went to the downloads.
    pub fn saved(&mut self, name: &str) {
        self.viewer.saved(Ok(PathBuf::from(name)), self.started.elapsed());
    }

    /// The camera as JSON.
    ///
    /// # Errors
    /// None that a camera has.
    pub fn camera(&self) -> Result<String, JsError> {
        let (rig, origin) = (self.viewer.rig(), self.viewer.scene().details().origin);
        serde_json::to_string(&CameraPlace::of(rig, origin)).map_err(failure)
    }

    /// Moves the camera to a place as JSON.
    ///
    /// # Errors
    /// One line with what was expected and what was found; the camera stays.
    #[wasm_bindgen(js_name = setCamera)]
    pub fn set_camera(&mut self, json: &str) -> Result<(), JsError> {
        let origin = self.viewer.scene().details().origin;
        let place = CameraPlace::parse(json).map_err(failure)?;
        let rig = place.rig(self.viewer.rig(), self.viewer.up(), origin).map_err(failure)?;
        self.viewer.look(rig);
        Ok(())
    }

    /// Displayed frames per second to aim at.
    #[wasm_bindgen(js_name = setFps)]
    pub fn set_fps(&mut self, fps: f64) {
        self.viewer.act(Action::Fps(fps), self.started.elapsed());
    }

    /// Whether there are panels over the picture.
    #[wasm_bindgen(js_name = setPanels)]
    pub fn set_panels(&mut self, are_shown: bool) {
        self.viewer.set_panels(are_shown);
    }

    /// The figures of the frames displayed last, as JSON, with the message that is shown and whether the viewer rests.
    #[must_use]
    pub fn figures(&self) -> String {
        self.viewer.figures_json().to_string()
    }
}

/// None of an effect that no page is asked for: it offers no videos.
fn describe(effect: Effect) -> Option<Object> {
    let object = Object::new();
    // An object made here takes any field.
    let set = |key: &str, value: JsValue| _ = Reflect::set(&object, &key.into(), &value);
    match effect {
        Effect::Choose => set("kind", "choose".into()),
        Effect::Video(..) | Effect::StopVideo => return None,
        Effect::Open(name) => {
            set("kind", "open".into());
            set("name", name.display().to_string().into());
        }
        Effect::Save(place, bytes) => {
            let (stem, extension) = match place {
                Destination::Numbered { stem, extension } => (stem.to_owned(), extension.to_owned()),
                Destination::File(file) => {
                    let text = |part: Option<&std::ffi::OsStr>| {
                        part.unwrap_or_default().to_string_lossy().into_owned()
                    };
                    (text(file.file_stem()), text(file.extension()))
                }
            };
            set("kind", "save".into());
            set("stem", stem.into());
            set("extension", extension.into());
            set("bytes", Uint8Array::from(&bytes[..]).into());
        }
    }
    Some(object)
}
