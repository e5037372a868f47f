//! The two networks, as graphs, and published ones to compare with ([`PublishedNetwork`]).
//!
//! Both refine what reconstruction without learning gives (crate `gs3-reconstruct`): exact samples of the past and of
//! the present, joined by tensor cubic Hermite interpolation at the present frame's own jitter. Their last layers
//! start at zero; what they add is weighed by the uncertainty of each pixel, which is zero where the analytic
//! pipeline is exact: at rest the networks change nothing.

mod grow;
mod initial;
mod interpolate;
mod published;
mod super_sample;

pub use grow::grown;
pub use initial::initial_weights;
pub use interpolate::interpolate;
pub use published::PublishedNetwork;
pub use super_sample::super_sample;

use crate::error::{RunError, WeightError};
use crate::graph::{Activation, Graph, GraphBuilder, GraphError, Op, Tensor};
use crate::weights::Header;

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

    /// Channels of the features.
    #[must_use]
    pub fn channels(self) -> usize {
        match self {
            Self::Fast => 16,
            Self::Balanced => 32,
            Self::High => 48,
        }
    }

    /// Channels of the hidden state. It moves through memory twice a frame, so it is narrower than the features; 16 is
    /// what the engine computes together.
    #[must_use]
    pub fn hidden_channels(self) -> usize {
        match self {
            Self::Fast | Self::Balanced => 16,
            Self::High => 32,
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

    /// The tier with that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tier| tier.name() == name)
    }
}

/// A network of gs3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Network {
    /// [`super_sample()`].
    SuperSample,
    /// [`interpolate()`].
    Interpolate,
}

impl Network {
    /// Both.
    pub const ALL: [Self; 2] = [Self::SuperSample, Self::Interpolate];

    /// As in the header of a weights file; also [`Graph::name`].
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SuperSample => "super_sample",
            Self::Interpolate => "interpolate",
        }
    }

    /// The network with that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|network| network.name() == name)
    }

    /// Its graph.
    ///
    /// # Errors
    /// [`GraphError::Scale`] if there is no network for `scale`.
    pub fn graph(self, scale: u32, tier: Tier) -> Result<Graph, GraphError> {
        match self {
            Self::SuperSample => super_sample(scale as usize, tier),
            Self::Interpolate => interpolate(scale as usize, tier),
        }
    }
}

fn unknown(field: &'static str, expected: &str, actual: &str) -> WeightError {
    WeightError::Header { field, expected: expected.to_owned(), actual: actual.to_owned() }
}

/// The tier of the weights of one of gs3's networks.
///
/// # Errors
/// [`WeightError::Header`] if `header` names no tier.
pub fn tier_of(header: &Header) -> Result<Tier, WeightError> {
    Tier::from_name(&header.tier).ok_or_else(|| unknown("tier", "one of fast, balanced, high", &header.tier))
}

/// The network of a weights file with `header`.
///
/// # Errors
/// [`RunError`] if there is no network of this name, tier, scale and version.
pub fn graph_of(header: &Header) -> Result<Graph, RunError> {
    let scale = header.scale as usize;
    if let Some(peer) = PublishedNetwork::from_name(&header.network) {
        let graph = peer.graph(scale)?;
        return match (header.tier == peer.size(), header.version == graph.version()) {
            (true, true) => Ok(graph),
            (false, _) => Err(unknown("tier", peer.size(), &header.tier).into()),
            (_, false) => {
                Err(unknown("version", &graph.version().to_string(), &header.version.to_string()).into())
            }
        };
    }
    let tier = tier_of(header)?;
    let Some(network) = Network::from_name(&header.network) else {
        let expected = "one of super_sample, interpolate, ecbsr, rt4ksr, ninasr";
        return Err(unknown("network", expected, &header.network).into());
    };
    let graph = network.graph(header.scale, tier)?;
    match graph.version() == header.version {
        true => Ok(graph),
        false => Err(unknown("version", &graph.version().to_string(), &header.version.to_string()).into()),
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

/// The last state where it belongs now: input `hidden` moved by input `motion`, 0 where input `validity` is.
fn carried_state(g: &mut GraphBuilder, channels: usize) -> Tensor {
    let hidden = g.input("hidden", channels, 1);
    let [motion, validity] = [g.input("motion", 2, 1), g.input("validity", 1, 1)];
    let moved = g.layer("hidden.moved", Op::Warp, &[hidden, motion]);
    g.layer("hidden.kept", Op::Multiply, &[moved, validity])
}

/// Adds `residual`, weighed by uncertainty, and `known`, as it is, to `image`: blocks of RGB and uncertainty, `[4 ·
/// block]` channels. The uncertainty stays.
fn add_residual(
    g: &mut GraphBuilder,
    image: Tensor,
    residual: Tensor,
    known: Option<Tensor>,
    block: usize,
) -> Tensor {
    let rgb = g.layer("image.rgb", Op::Slice { first: 0, count: 3 * block }, &[image]);
    let uncertainty = g.layer("image.uncertainty", Op::Slice { first: 3 * block, count: block }, &[image]);
    let weights = g.layer("residual.weights", Op::Concat, &[uncertainty; 3]);
    let residual = g.layer("residual.weighed", Op::Multiply, &[residual, weights]);
    let rgb = known.map_or(rgb, |known| g.layer("image.corrected", Op::Add, &[rgb, known]));
    let rgb = g.layer("image.refined", Op::Add, &[rgb, residual]);
    g.layer("image.blocks", Op::Concat, &[rgb, uncertainty])
}
