//! Metrics, methods and protocols of the evaluation. One binary for all of them: each would link everything again.
#![allow(clippy::unwrap_used, reason = "a step that fails is a test that fails")]

mod common;
mod metrics;
mod networks;
mod protocol;
mod silhouettes;
mod trained;
mod upscale;
mod warping;
