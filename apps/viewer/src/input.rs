//! Input events of a user, from any window or script.

use std::path::PathBuf;

use gs3::scene::Size;

pub use egui::Key;

/// A button of a mouse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Button {
    /// Turns the camera around the pivot.
    Left,
    /// No use.
    Middle,
    /// Moves the camera sideways.
    Right,
}

/// Keys that are held to change what others do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Modifiers {
    /// Flies faster.
    pub shift: bool,
    /// Flies slower.
    pub ctrl: bool,
    /// No use.
    pub alt: bool,
}

impl Modifiers {
    pub(crate) fn to_egui(self) -> egui::Modifiers {
        let Self { shift, ctrl, alt } = self;
        egui::Modifiers { alt, ctrl, shift, mac_cmd: false, command: ctrl }
    }
}

/// What a finger on a screen does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Touch {
    /// Touches the screen.
    Began,
    /// Moves on the screen.
    Moved,
    /// Leaves the screen, or the system takes the touch away.
    Ended,
}

/// An input. Positions and sizes are in pixels of the picture, from its top left corner.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// The pointer is here.
    PointerMoved([f32; 2]),
    /// The pointer is elsewhere.
    PointerGone,
    /// A button goes down or up where the pointer is.
    Button(Button, bool),
    /// A finger, by its number, is here: one finger is the left button, two pan and pinch.
    Touch(u64, Touch, [f32; 2]),
    /// The wheel turns, in lines; positive is away from the hand.
    Wheel(f32),
    /// A key goes down or up, by the letter on it.
    Key(Key, bool),
    /// The keys that are held.
    Modifiers(Modifiers),
    /// The picture has this size.
    Resized(Size),
    /// So many pixels are one point of a panel's text: 1 on most screens, 2 on dense ones.
    Scale(f32),
    /// A file is held over the window, or no longer.
    Hovering(bool),
    /// A file or folder is dropped into the window.
    Dropped(PathBuf),
    /// The window gets the keyboard, or loses it.
    Focused(bool),
}
