//! Published single-image super-resolution networks, for comparison: run from their own weights by small planar CPU
//! kernels, or with weights of gs3's trainer by its engine ([`Trained`]). The networks of gs3 itself live elsewhere.

mod activation;
mod conv;
mod features;
mod rt4ksr;
mod safmn;
mod span;
mod trained;
mod weights;

pub use rt4ksr::Rt4ksr;
pub use safmn::Safmn;
pub use span::Span;
pub use trained::Trained;
pub use weights::{WeightError, Weights};
