//! The terminal side of the command: options and their values, the machine that they name, errors, exit codes, notes and
//! Ctrl-C. It knows neither files of frames nor commands.

pub mod backend;
pub mod error;
pub mod exit;
pub mod interrupt;
pub mod memory;
pub mod options;
pub mod rasterizer;
pub mod terminal;
pub mod threads;
pub mod usage;
pub mod values;
