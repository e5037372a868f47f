//! glTF with `KHR_gaussian_splatting`: Gaussians as the points of mesh primitives, in a binary file (GLB) or as JSON with
//! its buffers beside it. The drafts that compress a primitive's Gaussians as SPZ are read, too.
//!
//! Source: glTF 2.0 and the extension's specification, both by Khronos (release candidate of 2026). Axes are
//! left-up-front; what nodes do to positions, rotations and spherical harmonics is done.

mod document;
mod read;
mod values;
mod write;

pub(super) use document::is_gltf;
pub(super) use read::read;
pub(super) use write::{fits, write};

/// The first bytes of a binary file.
pub(super) const MAGIC: &[u8; 4] = b"glTF";

/// The extension's name, also what its attributes' names begin with.
const EXTENSION: &str = "KHR_gaussian_splatting";
