//! Networks of super sampling and interpolation: graphs as data, and what interprets them.
//!
//! A network is defined once, as a [`Graph`] of named layers ([`model`]). Layer names are the names of their weights.
//! Images go in and out as planes of numbers; nothing here knows how they were rendered.

pub mod arrays;
mod error;
mod graph;
pub mod model;
mod random;
mod shape;
mod weights;

pub use error::{GraphError, WeightError};
pub use graph::{
    Activation, Border, Conv2d, Filter, Graph, GraphBuilder, Layer, Op, Output, Parameter, Tensor,
};
pub use random::Random;
pub use shape::Shape;
pub use weights::{Header, Weights};
