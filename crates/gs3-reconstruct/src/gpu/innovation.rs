//! The innovation, the difference of a frame's samples from the history: `innovation.wgsl`, or `innovation_none.wgsl`
//! without.

/// Whether a super sampler computes the innovation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Innovation {
    /// The innovation is computed, for a network.
    Wanted,
    /// The innovation is not computed.
    NotWanted,
}
