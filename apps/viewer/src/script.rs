//! Scripts: what a hand would do, from a file, through the same inputs.

use std::collections::VecDeque;
use std::path::PathBuf;

use gs3::scene::Size;
use serde::Deserialize;

use crate::input::{Button, Input, Key, Modifiers, Touch};
use crate::video::VideoWish;
use crate::viewer::{Destination, Shot, Viewer};

/// Loops in which a script waits for rest at most: five minutes at 30 frames a second.
const MOST_WAITS: usize = 10_000;

/// Most loops that a single step may take.
const MOST_FRAMES: u32 = 1_000_000;

/// The text that is no script.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}")]
pub struct ScriptError {
    /// Where: the text, or the step by its number from 0.
    pub place: String,
    /// What was expected and what was found.
    pub message: String,
}

/// What a script met that it did not expect.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("steps[{step}]: expected {expected}, found {actual}")]
pub struct ScriptFailure {
    /// The step by its number from 0.
    pub step: usize,
    /// What it expects.
    pub expected: String,
    /// The text found.
    pub actual: String,
}

/// One step as it is written. Positions are shares of the picture's width and height from its top left corner.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
enum Step {
    /// Lets so many loops pass.
    Wait { frames: u32 },
    /// Waits until no more frames are made.
    WaitIdle {},
    /// Moves the pointer.
    Move { to: [f32; 2] },
    /// Presses a button where the pointer is.
    Press { button: Button },
    /// Lets a button go.
    Release { button: Button },
    /// Drags with a button held, a part of the way in each of so many loops.
    Drag {
        button: Button,
        from: [f32; 2],
        to: [f32; 2],
        #[serde(default = "ten")]
        frames: u32,
    },
    /// Clicks twice with the left button.
    DoubleClick { at: [f32; 2] },
    /// Puts a finger on the screen, moves it or lifts it.
    Touch { finger: u64, phase: Touch, at: [f32; 2] },
    /// Turns the wheel.
    Wheel { lines: f32, at: Option<[f32; 2]> },
    /// Presses a key and lets it go.
    Key { key: String },
    /// Holds a key for so many loops.
    Hold {
        key: String,
        frames: u32,
        #[serde(default)]
        shift: bool,
        #[serde(default)]
        ctrl: bool,
    },
    /// Drops a file or folder; the next step comes once it is open, or its error is shown.
    Drop { file: PathBuf },
    /// Writes a PNG file; with `camera` also the camera, as a `camera_path.json`.
    Screenshot {
        file: PathBuf,
        #[serde(default)]
        panels: bool,
        #[serde(default = "one")]
        scale: u32,
        camera: Option<PathBuf>,
    },
    /// Writes the keyframes, in the format of the file's name.
    SavePath { file: PathBuf },
    /// Shows the camera at this share of the keyframes' path.
    Scrub { at: f64 },
    /// Begins to render the keyframes' path to an MP4 file.
    Video { file: PathBuf, size: Option<[u32; 2]>, fps: Option<f64>, frames: Option<u32> },
    /// Waits until no video is under way.
    WaitVideo {},
    /// Ends the video under way without a file.
    StopVideo {},
    /// Writes figures of the frames displayed last as JSON.
    Figures { file: PathBuf },
    /// Ends with an error unless all of it is so.
    Expect {
        idle: Option<bool>,
        playing: Option<bool>,
        gaussians: Option<usize>,
        keys: Option<usize>,
        video: Option<bool>,
        message: Option<String>,
        note: Option<String>,
    },
    /// Closes the viewer.
    End {},
}

const fn ten() -> u32 {
    10
}

const fn one() -> u32 {
    1
}

/// What the player does.
#[derive(Clone, Debug)]
enum Op {
    Input(Input),
    /// A position as shares of the picture.
    Move([f32; 2]),
    /// A finger at such a position.
    Touch(u64, Touch, [f32; 2]),
    /// Lets the loop go round.
    Frame,
    WaitIdle,
    Shot(Shot),
    SavePath(PathBuf),
    /// Goes to a share of the keyframes' path.
    Scrub(f64),
    Video(VideoWish),
    WaitVideo,
    StopVideo,
    Figures(PathBuf),
    Expect(Expected),
    End,
}

#[derive(Clone, Debug)]
struct Expected {
    idle: Option<bool>,
    playing: Option<bool>,
    gaussians: Option<usize>,
    keys: Option<usize>,
    video: Option<bool>,
    message: Option<String>,
    note: Option<String>,
}

/// Whether a script goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Playing {
    /// The viewer is to go round once, and to ask again.
    On,
    /// The script wants the viewer closed.
    End,
    /// There are no steps left; hands take over.
    Over,
}

/// Plays a script.
#[derive(Clone, Debug)]
pub struct Script {
    /// What is left, with the step that it belongs to.
    ops: VecDeque<(usize, Op)>,
    waited: usize,
}

impl Script {
    /// Reads a script: `{"steps": [{"do": "wait", "frames": 3}, …]}`. `docs/viewer.md` lists the steps.
    ///
    /// # Errors
    /// [`ScriptError`], naming the step, what was expected and what was found.
    pub fn parse(json: &[u8]) -> Result<Self, ScriptError> {
        let error = |place: &str, message: String| ScriptError { place: place.to_owned(), message };
        let text = |e: serde_json::Error| error("script", format!("expected JSON, found {e}"));
        let root: serde_json::Value = serde_json::from_slice(json).map_err(text)?;
        let steps = root.get("steps").and_then(serde_json::Value::as_array).ok_or_else(|| {
            error("script", "expected an object with an array \"steps\", found none".to_owned())
        })?;
        let mut ops = VecDeque::new();
        for (index, value) in steps.iter().enumerate() {
            let place = format!("steps[{index}]");
            let step = Step::deserialize(value).map_err(|e| error(&place, format!("{e}, found {value}")))?;
            let expanded = expand(step).map_err(|message| error(&place, message))?;
            ops.extend(expanded.into_iter().map(|op| (index, op)));
        }
        Ok(Self { ops, waited: 0 })
    }

    /// Gives `viewer` the inputs of one loop. To be called before a [`Viewer::step`], as often as the viewer aims to show pictures.
    ///
    /// # Errors
    /// [`ScriptFailure`] if something is not as a step expects.
    pub fn tick(&mut self, viewer: &mut Viewer) -> Result<Playing, ScriptFailure> {
        // A hand waits until a scene is there, too.
        while !viewer.is_opening() {
            let Some((step, op)) = self.ops.front().cloned() else { return Ok(Playing::Over) };
            if matches!(op, Op::WaitIdle) && !viewer.is_idle() {
                self.waited += 1;
                if self.waited > MOST_WAITS {
                    let actual = format!("frames after {MOST_WAITS} loops");
                    return Err(ScriptFailure { step, expected: "rest".to_owned(), actual });
                }
                return Ok(Playing::On);
            }
            // A video ends in time of its own, by itself or by an error.
            if matches!(op, Op::WaitVideo) && viewer.video().is_some() {
                return Ok(Playing::On);
            }
            self.ops.pop_front();
            match op {
                Op::WaitIdle => self.waited = 0,
                Op::WaitVideo => {}
                Op::Frame => return Ok(Playing::On),
                Op::Input(input) => viewer.input(input),
                Op::Move(at) => viewer.input(Input::PointerMoved(pixels(at, viewer))),
                Op::Touch(finger, touch, at) => {
                    viewer.input(Input::Touch(finger, touch, pixels(at, viewer)));
                }
                Op::Shot(shot) => viewer.shoot(shot),
                Op::SavePath(file) => viewer.save_tour(Destination::File(file)),
                Op::Scrub(at) => {
                    if viewer.tour().way().is_none() {
                        let actual = format!("{}", viewer.tour().keys());
                        return Err(ScriptFailure {
                            step,
                            expected: "at least 2 keyframes".to_owned(),
                            actual,
                        });
                    }
                    viewer.scrub(at * viewer.tour().seconds());
                }
                Op::Video(wish) => viewer.make_video(wish),
                Op::StopVideo => viewer.stop_video(),
                Op::Figures(file) => viewer.save_figures(file),
                Op::Expect(expected) => expected.check(viewer, step)?,
                Op::End => return Ok(Playing::End),
            }
        }
        Ok(Playing::On)
    }
}

impl Expected {
    fn check(&self, viewer: &Viewer, step: usize) -> Result<(), ScriptFailure> {
        let check = |what: &str, expected: Option<String>, actual: String| match expected {
            Some(expected) if expected != actual => {
                let (expected, actual) = (format!("{what} {expected}"), format!("{what} {actual}"));
                Err(ScriptFailure { step, expected, actual })
            }
            _ => Ok(()),
        };
        let text = |v: bool| v.to_string();
        check("idle", self.idle.map(text), text(viewer.is_idle()))?;
        check("playing", self.playing.map(text), text(viewer.tour().playing().is_some()))?;
        check("gaussians", self.gaussians.map(|v| v.to_string()), viewer.gaussians().to_string())?;
        check("keys", self.keys.map(|v| v.to_string()), viewer.tour().keys().to_string())?;
        check("video", self.video.map(text), text(viewer.video().is_some()))?;
        let contains = |what: &str, part: &Option<String>, shown: &str| match part {
            Some(part) if !shown.contains(part.as_str()) || (part.is_empty() && !shown.is_empty()) => {
                let expected = format!("a {what} with {part:?}");
                Err(ScriptFailure { step, expected, actual: format!("{shown:?}") })
            }
            _ => Ok(()),
        };
        contains("message", &self.message, viewer.message().unwrap_or_default())?;
        contains("note", &self.note, viewer.note().unwrap_or_default())
    }
}

/// A position given as shares of the picture, in pixels.
fn pixels(at: [f32; 2], viewer: &Viewer) -> [f32; 2] {
    let size = viewer.size();
    [at[0] * size.width as f32, at[1] * size.height as f32]
}

/// A step as what the player does.
fn expand(step: Step) -> Result<Vec<Op>, String> {
    let inside = |at: [f32; 2]| {
        let is_inside = at.iter().all(|v| (0.0..=1.0).contains(v));
        is_inside.then_some(at).ok_or_else(|| {
            format!("expected a position of two shares from 0 to 1, found [{}, {}]", at[0], at[1])
        })
    };
    let place = |at: [f32; 2]| inside(at).map(Op::Move);
    let loops = |frames: u32| {
        (1..=MOST_FRAMES)
            .contains(&frames)
            .then_some(frames)
            .ok_or_else(|| format!("frames: expected 1 to {MOST_FRAMES}, found {frames}"))
    };
    let key = |name: &str| {
        Key::from_name(name)
            .ok_or_else(|| format!("key: expected a key as W, Space or Escape, found {name:?}"))
    };
    let button = |button: Button, is_down: bool| Op::Input(Input::Button(button, is_down));
    Ok(match step {
        Step::Wait { frames } => vec![Op::Frame; loops(frames)? as usize],
        Step::WaitIdle {} => vec![Op::Frame, Op::WaitIdle],
        Step::Move { to } => vec![place(to)?, Op::Frame],
        Step::Press { button: which } => vec![button(which, true), Op::Frame],
        Step::Release { button: which } => vec![button(which, false), Op::Frame],
        Step::Drag { button: which, from, to, frames } => {
            let frames = loops(frames)?;
            let mut ops = vec![place(from)?, Op::Frame, button(which, true), Op::Frame];
            place(to)?;
            for k in 1..=frames {
                let t = k as f32 / frames as f32;
                ops.push(Op::Move([0, 1].map(|axis| from[axis] + t * (to[axis] - from[axis]))));
                ops.push(Op::Frame);
            }
            ops.extend([button(which, false), Op::Frame]);
            ops
        }
        Step::DoubleClick { at } => {
            let mut ops = vec![place(at)?, Op::Frame];
            for is_down in [true, false, true, false] {
                ops.extend([button(Button::Left, is_down), Op::Frame]);
            }
            ops
        }
        Step::Touch { finger, phase, at } => vec![Op::Touch(finger, phase, inside(at)?), Op::Frame],
        Step::Wheel { lines, at } => {
            if !lines.is_finite() {
                return Err(format!("lines: expected a finite number, found {lines}"));
            }
            let mut ops: Vec<Op> = at.map(place).transpose()?.into_iter().collect();
            ops.extend([Op::Input(Input::Wheel(lines)), Op::Frame]);
            ops
        }
        Step::Key { key: name } => {
            let key = key(&name)?;
            let pressed = |is_down| Op::Input(Input::Key(key, is_down));
            vec![pressed(true), Op::Frame, pressed(false), Op::Frame]
        }
        Step::Hold { key: name, frames, shift, ctrl } => {
            let key = key(&name)?;
            let modifiers = |modifiers| Op::Input(Input::Modifiers(modifiers));
            let mut ops =
                vec![modifiers(Modifiers { shift, ctrl, alt: false }), Op::Input(Input::Key(key, true))];
            ops.extend(vec![Op::Frame; loops(frames)? as usize]);
            ops.extend([Op::Input(Input::Key(key, false)), modifiers(Modifiers::default()), Op::Frame]);
            ops
        }
        Step::Drop { file } => vec![Op::Input(Input::Dropped(file)), Op::Frame],
        Step::Screenshot { file, panels, scale, camera } => {
            if !(1..=8).contains(&scale) {
                return Err(format!("scale: expected 1 to 8, found {scale}"));
            }
            if panels && scale > 1 {
                return Err(format!("scale: expected 1 with panels, found {scale}"));
            }
            vec![Op::Shot(Shot { file: Some(file), panels, scale, camera }), Op::Frame]
        }
        Step::SavePath { file } => vec![Op::SavePath(file), Op::Frame],
        Step::Scrub { at } => {
            if !(0.0..=1.0).contains(&at) {
                return Err(format!("at: expected a share from 0 to 1, found {at}"));
            }
            vec![Op::Scrub(at), Op::Frame]
        }
        Step::Video { file, size, fps, frames } => {
            vec![
                Op::Video(VideoWish { file: Some(file), size: size.map(Size::from), fps, frames }),
                Op::Frame,
            ]
        }
        Step::WaitVideo {} => vec![Op::WaitVideo],
        Step::StopVideo {} => vec![Op::StopVideo, Op::Frame],
        Step::Figures { file } => vec![Op::Figures(file), Op::Frame],
        Step::Expect { idle, playing, gaussians, keys, video, message, note } => {
            vec![Op::Expect(Expected { idle, playing, gaussians, keys, video, message, note })]
        }
        Step::End {} => vec![Op::End],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(steps: &str) -> String {
        Script::parse(format!(r#"{{"steps": [{{"do": "wait", "frames": 1}}, {steps}]}}"#).as_bytes())
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_no_script_is_told_with_expected_and_found() {
        for (text, expected) in [
            ("{", "script: expected JSON, found EOF"),
            ("[]", "script: expected an object with an array \"steps\", found none"),
            ("{\"steps\": 3}", "script: expected an object with an array \"steps\", found none"),
        ] {
            let error = Script::parse(text.as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        for (step, parts) in [
            (
                r#"{"do": "jump"}"#,
                &["steps[1]: unknown variant `jump`, expected one of `wait`", "found {"][..],
            ),
            (r#"{"do": "wait"}"#, &["missing field `frames`"]),
            (r#"{"do": "wait", "frames": "x"}"#, &["invalid type: string \"x\", expected u32"]),
            (r#"{"do": "wait", "frames": 0}"#, &["frames: expected 1 to 1000000, found 0"]),
            (r#"{"do": "wait", "frames": 2, "speed": 3}"#, &["unknown field `speed`, expected `frames`"]),
            (r#"{"do": "wait_idle", "frames": 2}"#, &["unknown field `frames`"]),
            (r#"{"do": "key", "key": "Hyper"}"#, &["key: expected a key as W", "found \"Hyper\""]),
            (r#"{"do": "move", "to": [0.5, 1.5]}"#, &["two shares from 0 to 1, found [0.5, 1.5]"]),
            (r#"{"do": "press", "button": "fourth"}"#, &["unknown variant `fourth`, expected one of `left`"]),
            (r#"{"do": "scrub", "at": 1.5}"#, &["at: expected a share from 0 to 1, found 1.5"]),
            (r#"{"do": "video"}"#, &["missing field `file`"]),
            (r#"{"do": "screenshot", "file": "a.png", "scale": 9}"#, &["scale: expected 1 to 8, found 9"]),
            (
                r#"{"do": "screenshot", "file": "a.png", "scale": 2, "panels": true}"#,
                &["scale: expected 1 with panels"],
            ),
        ] {
            let error = refused(step);
            assert!(error.starts_with("steps[1]: "), "{error}");
            for part in parts {
                assert!(error.contains(part), "{error} lacks {part}");
            }
        }
    }

    #[test]
    fn every_step_is_read() {
        let script = br#"{"steps": [
            {"do": "wait", "frames": 2}, {"do": "wait_idle"}, {"do": "move", "to": [0.5, 0.5]},
            {"do": "press", "button": "left"}, {"do": "release", "button": "left"},
            {"do": "drag", "button": "right", "from": [0.1, 0.1], "to": [0.4, 0.2], "frames": 3},
            {"do": "touch", "finger": 1, "phase": "began", "at": [0.5, 0.5]},
            {"do": "double_click", "at": [0.5, 0.5]}, {"do": "wheel", "lines": -2},
            {"do": "wheel", "lines": 2, "at": [0.1, 0.1]}, {"do": "key", "key": "F"},
            {"do": "hold", "key": "W", "frames": 4, "shift": true}, {"do": "drop", "file": "a.ply"},
            {"do": "screenshot", "file": "a.png", "camera": "a.json"}, {"do": "save_path", "file": "p.json"},
            {"do": "figures", "file": "f.json"}, {"do": "expect", "idle": true, "message": "", "note": "w", "video": false},
            {"do": "scrub", "at": 0.25}, {"do": "video", "file": "a.mp4"}, {"do": "wait_video"}, {"do": "stop_video"},
            {"do": "video", "file": "a.mp4", "size": [64, 36], "fps": 24, "frames": 9}, {"do": "end"}
        ]}"#;
        let script = Script::parse(script).unwrap();
        let steps: std::collections::BTreeSet<usize> = script.ops.iter().map(|(step, _)| *step).collect();
        assert_eq!(steps.len(), 23);
        let frames = script.ops.iter().filter(|(_, op)| matches!(op, Op::Frame)).count();
        // 2 + 1 + 1 + 1 + 1 + (3 + 3) + 1 + 5 + 1 + 1 + 2 + (4 + 1) + 1 + 1 + 1 + 1, and 4 of the last lines.
        assert_eq!(frames, 35);
    }
}
