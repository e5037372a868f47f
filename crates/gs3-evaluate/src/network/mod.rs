//! Published single-image super-resolution networks, for comparison: with their own weights, or with weights of gs3's
//! trainer ([`Trained`]). All run on gs3's engine, so their times are due to their designs. The networks of gs3
//! itself are elsewhere.

mod rt4ksr;
mod runner;
mod safmn;
mod span;
mod trained;
mod weights;

pub use rt4ksr::Rt4ksr;
pub use safmn::Safmn;
pub use span::Span;
pub use trained::Trained;
pub use weights::{PublishedWeightError, PublishedWeights};
