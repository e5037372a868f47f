//! What is trained.

use gs3_neural::model::{PublishedNetwork, Tier};
use gs3_neural::{Graph, GraphError};

use crate::clip::{ClipFrame, Network};

/// A network that can be trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainedNetwork {
    /// One of ours.
    Own {
        /// Which.
        network: Network,
        /// Its size.
        tier: Tier,
    },
    /// A published single-image network, trained on the frames that super sampling is fed, each on its own.
    Published(PublishedNetwork),
}

impl TrainedNetwork {
    /// Its graph.
    ///
    /// # Errors
    /// [`GraphError::Scale`] if there is no network for `scale`.
    pub fn graph(self, scale: u32) -> Result<Graph, GraphError> {
        match self {
            Self::Own { network, tier } => network.graph(scale, tier),
            Self::Published(peer) => peer.graph(scale as usize),
        }
    }

    /// The network that its training clips are made for.
    #[must_use]
    pub const fn clips(self) -> Network {
        match self {
            Self::Own { network, .. } => network,
            Self::Published(_) => Network::SuperSample,
        }
    }

    /// Its size, as in the header of a weights file.
    #[must_use]
    pub fn size(self) -> &'static str {
        match self {
            Self::Own { tier, .. } => tier.name(),
            Self::Published(peer) => peer.size(),
        }
    }

    /// The planes of its clips that it needs; all if none.
    pub(crate) const fn planes(self) -> Option<&'static [&'static str]> {
        match self {
            Self::Own { .. } => None,
            Self::Published(_) => Some(&["color", JITTER]),
        }
    }

    /// Displacement of the network's image for `frame` from its right place, left and up, in HR pixels.
    ///
    /// Single-image networks do not know where a frame was sampled within its block of HR pixels. They could only
    /// learn a blur over all places. So they are trained to place samples at pixel [`PublishedNetwork::sample`] of
    /// the block. Their image is then displaced from the native image by whole pixels.
    pub(crate) fn displacement(self, frame: &ClipFrame, scale: usize) -> [isize; 2] {
        let Self::Published(peer) = self else { return [0; 2] };
        let jitter = frame.inputs.iter().find(|plane| plane.name == JITTER);
        let Some([x, y, ..]) = jitter.map(|plane| &plane.values[..]) else { return [0; 2] };
        // LR pixel 0 samples HR position S (½ + jitter), the centre of an HR pixel.
        [x, y].map(|jitter| {
            let pixel = scale as f32 * (0.5 + jitter.to_f32()) - 0.5;
            pixel.round() as isize - peer.sample(scale) as isize
        })
    }
}

/// Where a frame was sampled.
const JITTER: &str = "jitter";
