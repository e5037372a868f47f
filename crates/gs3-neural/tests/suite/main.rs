//! Engine, gradients and weights. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod adam;
mod agreement;
mod common;
mod derivatives;
mod differentiate;
mod engine;
#[cfg(feature = "gpu")]
mod gpu;
mod graphs;
mod grow;
mod operations;
mod weights;
