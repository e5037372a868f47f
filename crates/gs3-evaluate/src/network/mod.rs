//! Published single-image super-resolution networks, run from their own weights, for comparison. Small planar CPU kernels; the
//! networks of gs3 itself live elsewhere.

mod activation;
mod conv;
mod features;
mod rt4ksr;
mod safmn;
mod span;
mod weights;

pub use rt4ksr::Rt4ksr;
pub use safmn::Safmn;
pub use span::Span;
pub use weights::{WeightError, Weights};
