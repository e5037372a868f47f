//! Trains the networks of gs3 on frames rendered from scenes.
//!
//! A [`Clip`] holds what a network is fed along a camera path, and the native frames it should give.

pub mod clip;

pub use clip::{Clip, ClipError, ClipFile, Frame, Network, Plane, Window};
