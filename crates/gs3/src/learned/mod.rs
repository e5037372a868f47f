//! The networks in the pipeline: their inputs, their states, their weights. `gpu` has the same on a device.

mod features;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
mod interpolator;
mod networks;
mod recurrent;
mod super_sampler;

#[cfg(feature = "gpu")]
pub(crate) use features::UNCERTAIN;
pub use features::{CameraDepth, InterpolateFeatures, SuperSampleFeatures};
pub use interpolator::LearnedInterpolator;
pub use networks::Networks;
pub use super_sampler::LearnedSuperSampler;
