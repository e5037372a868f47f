//! Reconstruction on CPUs. Modules with a shader of the same stem in `gpu` are the same stage.

pub(crate) mod blend;
pub(crate) mod boxes;
pub(crate) mod carry;
pub(crate) mod displacement;
pub(crate) mod gather;
pub(crate) mod hermite;
pub(crate) mod interpolate;
pub(crate) mod kriging;
pub(crate) mod lanes;
pub(crate) mod middle_depth;
pub(crate) mod motion;
pub(crate) mod nearest;
pub(crate) mod neighbor_depth;
pub(crate) mod past;
pub(crate) mod prefetch;
pub(crate) mod rectification;
pub(crate) mod resample;
pub(crate) mod samples;
pub(crate) mod select;
pub(crate) mod separate;
pub(crate) mod splat;
pub(crate) mod super_sample;
pub(crate) mod surface_motion;
pub(crate) mod tile;
pub(crate) mod tile_size;
pub(crate) mod warp;
