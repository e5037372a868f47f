//! Frame interpolation refined by a network.

use std::sync::Arc;

use gs3_neural::model::Network;
use gs3_neural::{Arithmetic, Weights};
use gs3_reconstruct::{Depth, Interpolator, Neighbor, Warped};
use gs3_scene::{Camera, Image};

use super::features::{CameraDepth, InterpolateFeatures};
use super::recurrent::Recurrent;
use crate::error::NetworkError;

/// Fuses both neighbours of an in-between frame, warped to its pose, by a network.
#[derive(Debug)]
pub struct LearnedInterpolator {
    scale: u32,
    network: Recurrent,
    features: InterpolateFeatures,
    warped: Warped,
    /// The in-between frame made last.
    last: Warped,
    last_camera: Option<Camera>,
}

impl LearnedInterpolator {
    /// The interpolator of `weights`, which must be for `scale`. It computes with `arithmetic`.
    ///
    /// # Errors
    /// [`NetworkError`] if the weights are of another network or another scale.
    pub fn new(weights: Arc<Weights>, scale: u32, arithmetic: Arithmetic) -> Result<Self, NetworkError> {
        let network = Recurrent::new(weights, Network::Interpolate, scale, arithmetic)?;
        let features = InterpolateFeatures::default();
        let (warped, last) = (Warped::default(), Warped::default());
        Ok(Self { scale, network, features, warped, last, last_camera: None })
    }

    /// Drops the hidden state.
    pub fn reset(&mut self) {
        self.network.reset();
        self.last_camera = None;
    }

    /// Interpolates the image of `camera` at time `t` ∈ (0, 1) between `before` and `after` into `out`, with
    /// `interpolator` for warping. Frames must be requested in the order of time: each takes the hidden state of the
    /// frame before.
    ///
    /// # Errors
    /// [`NetworkError`] if sizes do not match, geometry is missing, or `t` is outside (0, 1).
    pub fn interpolate(
        &mut self,
        interpolator: &mut Interpolator,
        before: Neighbor<'_>,
        after: Neighbor<'_>,
        t: f32,
        camera: &Camera,
        out: &mut Image,
    ) -> Result<(), NetworkError> {
        interpolator.warp(before, after, t, camera, &mut self.warped)?;
        let has_state = self.network.has_state();
        let last = self.last_camera.as_ref().filter(|last| has_state && last.size() == camera.size());
        let last = last.map(|camera| CameraDepth { camera, depth: Depth::Inverse(&self.last.inverse_depth) });
        let Warped { before, after, share, inverse_depth, .. } = &self.warped;
        self.features.set(camera, inverse_depth, t, last, self.scale)?;
        out.resize(before.width(), before.height());
        let lr = [inverse_depth.height(), inverse_depth.width()];
        let hr = [before.height(), before.width()];
        let [before, after] = [before, after].map(|image| image.pixels().as_flattened());
        let images = self.features.named(before, after, share.plane(0));
        self.network.run(lr, hr, &images, out.pixels_mut().as_flattened_mut())?;
        std::mem::swap(&mut self.warped, &mut self.last);
        self.last_camera = Some(*camera);
        Ok(())
    }
}
