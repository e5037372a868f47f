//! How good and how fast is it? Image and video quality metrics, baselines, and a protocol that compares them.
//!
//! [`metrics`] are pure functions on images and sequences, each checked against its reference implementation.
//! [`upscale`] holds the spatial baselines.

pub mod metrics;
pub mod upscale;
