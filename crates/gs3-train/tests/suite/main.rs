//! Clips, losses and training. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod clip;
mod common;
mod losses;
mod perceptual;
mod session;
mod symmetry;
mod training;
