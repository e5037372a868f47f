//! How good and how fast is it? Image and video quality metrics, baselines, and a protocol that compares them.
//!
//! [`metrics`] are pure functions on images and sequences, each checked against its reference implementation.
//! [`upscale`] holds the spatial baselines, [`network`] published networks, [`methods`] puts them and gs3 behind one
//! trait, [`protocol`] runs and judges them, [`photos`] compares renders with the photos of a capture, [`report`] shows
//! the results. [`simplify`] makes the smaller scenes of its acceleration columns.

mod digest;
pub mod methods;
pub mod metrics;
pub mod network;
pub mod photos;
pub mod protocol;
pub mod report;
pub mod simplify;
pub mod upscale;
