//! What the samples of a frame say that the past did not: `innovation.wgsl`, or `innovation_none.wgsl` without.

/// Whether a super sampler tells what its samples say that the past did not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Innovation {
    /// It does, for a network.
    Wanted,
    /// It does not.
    NotWanted,
}
