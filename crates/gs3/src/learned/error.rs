//! Errors of networks in a pipeline.

use gs3_neural::{RunError, WeightError};
use gs3_reconstruct::ReconstructError;
use thiserror::Error;

/// A network that cannot be used, or frames that do not fit it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// Weights of another network.
    #[error("weights: expected those of {expected}, found those of {actual}")]
    Other {
        /// The network expected.
        expected: &'static str,
        /// The network that the weights are of.
        actual: String,
    },
    /// Weights for another scale.
    #[error("weights: expected those for scale {expected}, found those for scale {actual}")]
    Scale {
        /// The pipeline's scale.
        expected: u32,
        /// The weights' scale.
        actual: u32,
    },
    /// Two weights files for one network.
    #[error("weights: expected at most one file for {network}, found two")]
    Twice {
        /// The network.
        network: String,
    },
    /// No weights of this tier and scale are part of this version.
    #[error("tier {tier} at scale {scale}: expected one of {available}, which come with this version")]
    NotShipped {
        /// Tier asked for.
        tier: &'static str,
        /// Scale asked for.
        scale: u32,
        /// Tiers and scales that there are.
        available: String,
    },
    /// Weights that do not fit their network.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The network refuses its inputs.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The GPU cannot run the network.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] gs3_neural::GpuRunError),
    /// The reconstruction refuses its inputs.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
}
