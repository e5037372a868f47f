//! The viewer of gs3: scenes are sharp in motion and native at rest, and a resting viewer uses no CPU time.
//!
//! [`Viewer`] is everything except the window: inputs and time go in; pictures and requests for files ([`Effect`])
//! come out. It reads no clock, file or screen, so that a window, a page, a script and a test drive the same code.
//! `window` is the native window, `page` is the interface of a web page, and [`Script`] plays inputs from a file.

pub mod compare;
pub mod controls;
pub mod figures;
mod heap;
pub mod input;
pub mod opening;
#[cfg(feature = "page")]
pub mod page;
pub mod paint;
pub mod panels;
pub mod path_file;
pub mod script;
pub mod tour;
pub mod video;
pub mod viewer;
pub mod views;
#[cfg(feature = "window")]
pub mod window;

#[cfg(feature = "window")]
pub use heap::use_one_arena;
pub use input::Input;
pub use script::{Playing, Script, ScriptError, ScriptFailure};
pub use viewer::{Destination, Effect, Next, Opened, Shot, Step, Viewer, ViewerError, ViewerSettings};
