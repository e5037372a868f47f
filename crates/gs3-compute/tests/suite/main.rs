//! Devices and kernels. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod ceilings;
mod common;
mod device;
mod primitives;
