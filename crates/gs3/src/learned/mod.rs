//! The networks within the pipeline: what they are fed, and what they remember.

mod features;

pub use features::{InterpolateFeatures, Seen, SuperSampleFeatures};
