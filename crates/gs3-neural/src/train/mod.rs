//! What training needs and inference does not: derivatives of a network's result, and the optimiser. No other room of this
//! crate knows this one.

mod adam;
pub mod adjoint;
mod differentiate;

pub use adam::Adam;
pub use differentiate::{Differentiator, Packed, Scratch, Tape};
