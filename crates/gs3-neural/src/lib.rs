//! Networks of super sampling and interpolation: graphs as data, and what interprets them.
//!
//! A network is defined once, as a [`Graph`] of named layers ([`model`]). Layer names are the names of their weights.
//! Images go in and out as planes of numbers; nothing here knows how they were rendered.

pub mod arrays;
mod engine;
mod error;
#[cfg(feature = "gpu")]
mod gpu;
mod graph;
mod images;
pub mod model;
pub mod onnx;
mod random;
pub mod reference;
mod train;
mod weights;

pub use engine::{Arithmetic, Engine};
pub use error::{RunError, WeightError};
#[cfg(feature = "gpu")]
pub use gpu::{
    BoundEngine, GpuEngine, GpuEngineSettings, GpuRunError, GpuTensorImage, ImageFormat, MatrixUnit,
    Precision,
};
pub use graph::{
    Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Layer, Op, Output, Parameter, Shape, Tensor,
};
pub use images::Named;
pub use random::Random;
pub use train::{Adam, Differentiator, Packed, Scratch, Tape, adjoint};
pub use weights::{Header, Weights};
