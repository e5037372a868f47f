//! Which networks refine the frames, and the weights that come with the library.

use std::sync::Arc;

use gs3_neural::model::{Network, Tier};
use gs3_neural::{Arithmetic, Weights};

use crate::error::NetworkError;

/// Weights of the networks that refine frames. Without weights, the analytic frame stays as it is.
#[derive(Clone, Debug, Default)]
pub struct Networks {
    /// Weights of the super-sampling network.
    pub super_sample: Option<Arc<Weights>>,
    /// Weights of the interpolation network.
    pub interpolate: Option<Arc<Weights>>,
    /// The arithmetic of the networks on the CPU.
    pub arithmetic: Arithmetic,
}

/// All weights files of the library: scale, tier, bytes. The header of each file names its network. Model cards lie beside the files.
const SHIPPED: &[(u32, Tier, &[u8])] = &[
    (2, Tier::Balanced, include_bytes!("../../weights/super_sample_balanced_x2.safetensors")),
    (4, Tier::Fast, include_bytes!("../../weights/super_sample_fast_x4.safetensors")),
    (4, Tier::Fast, include_bytes!("../../weights/interpolate_fast_x4.safetensors")),
    (4, Tier::Balanced, include_bytes!("../../weights/super_sample_balanced_x4.safetensors")),
    (4, Tier::Balanced, include_bytes!("../../weights/interpolate_balanced_x4.safetensors")),
    (4, Tier::High, include_bytes!("../../weights/super_sample_high_x4.safetensors")),
    (4, Tier::High, include_bytes!("../../weights/interpolate_high_x4.safetensors")),
];

impl Networks {
    /// The weights that come with the library: for super sampling, and for interpolation if there are any.
    ///
    /// # Errors
    /// [`NetworkError::NotShipped`] if there are no weights of `tier` for `scale`.
    pub fn shipped(scale: u32, tier: Tier) -> Result<Self, NetworkError> {
        let mut networks = Self::default();
        for (.., bytes) in SHIPPED.iter().filter(|(s, t, _)| (*s, *t) == (scale, tier)) {
            networks.add(Weights::from_bytes(bytes)?)?;
        }
        match networks.super_sample {
            Some(_) => Ok(networks),
            None => {
                let mut available: Vec<String> =
                    SHIPPED.iter().map(|(scale, tier, _)| format!("{} ×{scale}", tier.name())).collect();
                // Some tiers and scales have two networks.
                available.dedup();
                let available = if available.is_empty() { "none".to_owned() } else { available.join(", ") };
                Err(NetworkError::NotShipped { tier: tier.name(), scale, available })
            }
        }
    }

    /// Adds the weights of one network. The weights' header names the network.
    ///
    /// # Errors
    /// [`NetworkError`] if the network is neither of the two, or already has weights.
    pub fn add(&mut self, weights: Weights) -> Result<(), NetworkError> {
        let network = weights.header.network.clone();
        let place = match Network::from_name(&network) {
            Some(Network::SuperSample) => &mut self.super_sample,
            Some(Network::Interpolate) => &mut self.interpolate,
            None => {
                return Err(NetworkError::Other { expected: "super_sample or interpolate", actual: network });
            }
        };
        match place.replace(Arc::new(weights)) {
            None => Ok(()),
            Some(_) => Err(NetworkError::Twice { network }),
        }
    }
}
