//! Super sampling refined by a network.

use std::sync::Arc;

use gs3_neural::Weights;
use gs3_scene::{Camera, GBuffer, Image};

use super::error::NetworkError;
use super::features::{Seen, SuperSampleFeatures};
use super::recurrent::Recurrent;

/// Refines analytic frames: adds what a network has learned to add to them.
#[derive(Debug)]
pub struct LearnedSuperSampler {
    scale: u32,
    network: Recurrent,
    features: SuperSampleFeatures,
}

impl LearnedSuperSampler {
    /// The super sampler of `weights`, which must be for `scale`.
    ///
    /// # Errors
    /// [`NetworkError`] if they are those of another network or another scale.
    pub fn new(weights: Arc<Weights>, scale: u32) -> Result<Self, NetworkError> {
        let network = Recurrent::new(weights, "super_sample", scale)?;
        Ok(Self { scale, network, features: SuperSampleFeatures::default() })
    }

    /// Forgets the hidden state.
    pub fn reset(&mut self) {
        self.network.reset();
    }

    /// Refines `history`, the analytic frame of `camera` with its uncertainty in the fourth channel, into `out`, whose
    /// fourth channel stays the uncertainty. `gbuffer` is the LR frame and `previous` the frame refined last, whose
    /// hidden state is carried on; without it the state begins anew.
    ///
    /// # Errors
    /// [`NetworkError`] if sizes do not match or `gbuffer` lacks gradients or geometry.
    pub fn refine(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        previous: Option<Seen<'_>>,
        history: &Image,
        out: &mut Image,
    ) -> Result<(), NetworkError> {
        let previous = previous.filter(|_| self.network.has_state());
        self.features.set(camera, gbuffer, previous, self.scale)?;
        out.resize(history.width(), history.height());
        let images = self.features.named(history.pixels().as_flattened());
        self.network.run([gbuffer.height(), gbuffer.width()], &images, out.pixels_mut().as_flattened_mut())
    }
}
