//! Super sampling refined by a network.

use std::sync::Arc;

use gs3_neural::model::Network;
use gs3_neural::{Arithmetic, Weights};
use gs3_reconstruct::Neighbor;
use gs3_scene::Image;

use super::features::SuperSampleFeatures;
use super::recurrent::Recurrent;
use crate::error::NetworkError;

/// Refines analytic frames: adds the correction of a network.
#[derive(Debug)]
pub struct LearnedSuperSampler {
    network: Recurrent,
    features: SuperSampleFeatures,
}

impl LearnedSuperSampler {
    /// The super sampler of `weights`, which must be for `scale`. It computes with `arithmetic`.
    ///
    /// # Errors
    /// [`NetworkError`] if the weights are of another network or another scale.
    pub fn new(weights: Arc<Weights>, scale: u32, arithmetic: Arithmetic) -> Result<Self, NetworkError> {
        let network = Recurrent::new(weights, Network::SuperSample, scale, arithmetic)?;
        Ok(Self { network, features: SuperSampleFeatures::new(scale)? })
    }

    /// Drops the hidden state.
    pub fn reset(&mut self) {
        self.network.reset();
    }

    /// Refines the analytic frame `now` into `out`; both have the uncertainty in the fourth channel. `innovation` is
    /// the difference of the samples from the history ([`gs3_reconstruct::SuperSampler::innovation`]). `previous` is
    /// the last frame as it was refined; without it the hidden state starts anew.
    ///
    /// # Errors
    /// [`NetworkError`] if sizes do not match, or gradients or geometry are missing.
    pub fn refine(
        &mut self,
        now: Neighbor<'_>,
        innovation: &[[f32; 4]],
        previous: Option<Neighbor<'_>>,
        out: &mut Image,
    ) -> Result<(), NetworkError> {
        let previous = previous.filter(|_| self.network.has_state());
        self.features.set(now, innovation, previous)?;
        out.resize(now.image.width(), now.image.height());
        let images = self.features.named(now.image);
        let hr = [now.image.height(), now.image.width()];
        self.network.run(
            [now.gbuffer.height(), now.gbuffer.width()],
            hr,
            &images,
            out.pixels_mut().as_flattened_mut(),
        )
    }
}
