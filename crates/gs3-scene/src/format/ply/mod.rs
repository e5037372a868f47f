//! PLY: the training format of 3D Gaussian Splatting, and PlayCanvas' compressed variant of it.

mod column;
mod compressed;
mod header;
mod text;
mod vertices;
mod write;

use super::Decoded;
use super::error::LoadError;
use super::progress::Progress;
use super::source::Source;
use header::Header;
pub(super) use write::write;

/// Reads either kind, told apart by the element `chunk`.
pub(super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    let header = Header::read(source)?;
    if header.elements.iter().any(|element| element.name == "chunk") {
        compressed::read(source, &header, progress)
    } else {
        vertices::read(source, &header, progress)
    }
}
