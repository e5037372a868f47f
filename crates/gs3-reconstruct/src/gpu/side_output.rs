//! What super sampling computes besides the image: `innovation.wgsl`, `expected_errors.wgsl`, or `side_output_none.wgsl`. A
//! kernel of a browser has no storage binding for both.

/// What a super sampler computes besides the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SideOutput {
    /// Nothing.
    None,
    /// The innovation, for a network ([`crate::SuperSampler::innovation`]).
    Innovation,
    /// The expected errors of blocks, which [`super::GpuBlockSelector`] reads.
    ExpectedErrors,
}
