//! The two networks, as graphs.

mod initial;
mod interpolate;
mod super_sample;

pub use initial::{hermite_weights, initial_weights, set_hermite};
pub use interpolate::interpolate;
pub use super_sample::super_sample;

use crate::error::GraphError;
use crate::graph::Activation;

/// The largest enlargement.
const MAX_SCALE: usize = 8;

/// How much work a network does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Tier {
    /// 16 channels.
    Fast,
    /// 32 channels.
    Balanced,
    /// 48 channels.
    High,
}

impl Tier {
    /// All tiers, cheapest first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Balanced, Self::High];

    /// Channels of the features and of the hidden state.
    #[must_use]
    pub fn channels(self) -> usize {
        match self {
            Self::Fast => 16,
            Self::Balanced => 32,
            Self::High => 48,
        }
    }

    /// As in the header of a weights file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::High => "high",
        }
    }
}

/// After every convolution of features: as good as smoother ones in small networks, and free.
const FEATURES: Activation = Activation::LeakyRelu { slope: 0.1 };

fn check_scale(scale: usize) -> Result<(), GraphError> {
    match (1..=MAX_SCALE).contains(&scale) {
        true => Ok(()),
        false => Err(GraphError::Scale { actual: scale, max: MAX_SCALE }),
    }
}
