//! Super sampling and interpolation against analytic worlds. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod common;
#[cfg(feature = "gpu")]
mod gpu;
mod interpolate;
mod motion;
mod moving;
mod reconstructor;
mod refine;
mod super_sample;
mod upsample;
mod world;
