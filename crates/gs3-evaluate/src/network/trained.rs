//! Published networks with weights of gs3's own trainer: what their design does on the very frames that gs3's networks
//! were trained on.

use gs3::neural::model::{PublishedNetwork, graph_of};
use gs3::neural::{self, RunError};
use gs3_scene::{GBuffer, Image};

use super::runner::{Runner, color_of, write};
use crate::upscale::{UpscaleError, Upscaler, check_size};

/// LR sides are made multiples of this: RT4KSR works on blocks of 2×2 pixels.
const MULTIPLE: usize = 2;

/// A trained published network.
#[derive(Clone, Debug)]
pub struct Trained {
    peer: PublishedNetwork,
    scale: u32,
    network: Runner,
    image: Vec<f32>,
}

impl Trained {
    /// `peer` with `weights`, as `gs3 train baseline` writes them.
    ///
    /// # Errors
    /// [`RunError`] if the weights do not fit the network.
    pub fn new(peer: PublishedNetwork, weights: neural::Weights) -> Result<Self, RunError> {
        let actual = weights.header.network.clone();
        if actual != peer.name() {
            let (field, expected) = ("network", peer.name().to_owned());
            return Err(neural::WeightError::Header { field, expected, actual }.into());
        }
        let graph = graph_of(&weights.header)?;
        let scale = weights.header.scale;
        Ok(Self { peer, scale, network: Runner::new(peer.name(), graph, weights)?, image: Vec::new() })
    }

    /// The weights that come with the crate.
    #[must_use]
    pub fn shipped(peer: PublishedNetwork, scale: u32) -> Option<&'static [u8]> {
        SHIPPED.iter().find(|file| file.0 == peer && file.1 == scale).map(|file| file.2)
    }
}

/// Networks, their scales and their weights. Model cards lie beside them.
const SHIPPED: &[(PublishedNetwork, u32, &[u8])] = &[
    (PublishedNetwork::Ecbsr, 4, include_bytes!("../../weights/ecbsr_x4.safetensors")),
    (PublishedNetwork::Rt4ksr, 4, include_bytes!("../../weights/rt4ksr_x4.safetensors")),
    (PublishedNetwork::Ninasr, 4, include_bytes!("../../weights/ninasr_x4.safetensors")),
];

impl Upscaler for Trained {
    fn jitter(&self) -> [f32; 2] {
        self.peer.jitter(self.scale as usize)
    }

    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale != self.scale {
            let (expected, actual) = (self.scale, scale);
            return Err(UpscaleError::Scale { method: self.peer.name(), expected, actual });
        }
        check_size(lr, scale, out)?;
        let (color, size) = color_of(lr, MULTIPLE);
        self.image.resize((scale * scale) as usize * color.len(), 0.0);
        self.network.run(size, &[("color", &color)], &mut [("color", &mut self.image)])?;
        write(&self.image, scale as usize * size[1], out);
        Ok(())
    }
}
