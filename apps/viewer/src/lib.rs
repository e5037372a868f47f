//! The viewer of gs3: scenes that are sharp while they move, native at rest, and then leave the processor alone.
//!
//! [`Viewer`] is all of it but the window: inputs and time go in, pictures come out, and wishes for files
//! ([`Effect`]). Nothing in it reads a clock, a file or a screen, so that a window, a page, a script and a test drive the same
//! code. `window` is the native window, `page` what a web page calls, [`Script`] a hand from a file.

pub mod compare;
pub mod controls;
pub mod figures;
pub mod input;
#[cfg(feature = "page")]
pub mod page;
pub mod paint;
pub mod panels;
mod screenshot;
pub mod script;
pub mod tour;
pub mod viewer;
pub mod views;
#[cfg(feature = "window")]
pub mod window;

pub use input::Input;
pub use script::{Playing, Script, ScriptError, ScriptFailure};
pub use viewer::{Effect, Next, Opened, Place, Shot, Step, Viewer, ViewerError, ViewerSettings};
