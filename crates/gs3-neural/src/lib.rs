//! Networks of super sampling and interpolation: graphs as data, and what interprets them.
//!
//! A network is defined once, as a [`Graph`] of named layers ([`model`]). Layer names are the names of their weights.
//! Images go in and out as planes of numbers; nothing here knows how they were rendered.

mod adam;
pub mod adjoint;
pub mod arrays;
mod differentiate;
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
mod shape;
mod weights;

pub use adam::Adam;
pub use differentiate::{Differentiator, Packed, Scratch, Tape};
pub use engine::{Arithmetic, Engine};
pub use error::{GraphError, RunError, WeightError};
#[cfg(feature = "gpu")]
pub use gpu::{
    BoundEngine, GpuEngine, GpuEngineSettings, GpuRunError, GpuTensorImage, ImageFormat, MatrixUnit,
    Precision,
};
pub use graph::{Activation, Border, Conv2d, Graph, GraphBuilder, Layer, Op, Output, Parameter, Tensor};
pub use images::Named;
pub use random::Random;
pub use shape::Shape;
pub use weights::{Header, Weights};
