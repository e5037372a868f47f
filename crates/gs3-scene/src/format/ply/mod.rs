//! PLY: the training format of 3D Gaussian Splatting, and PlayCanvas' compressed variant of it.

mod column;
mod comments;
mod compressed;
mod header;
mod text;
mod vertices;
mod write;
mod write_compressed;

use super::error::{LoadError, quoted};
use super::progress::Progress;
use super::source::Source;
use super::{Decoded, unused_note};
use crate::gaussians::Gaussians;
use header::{Element, Header};
pub(super) use write::write;
pub(super) use write_compressed::{is_sh_cut, write as write_compressed};

/// Reads both kinds; the element `chunk` distinguishes them.
pub(super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    let header = Header::read(source)?;
    if header.elements.iter().any(|element| element.name == "chunk") {
        compressed::read(source, &header, progress)
    } else {
        vertices::read(source, &header, progress)
    }
}

impl Header {
    /// What the comments say, with the Gaussians.
    fn decoded(&self, gaussians: Gaussians, notes: Vec<String>) -> Decoded {
        let comments = &self.comments;
        Decoded {
            up: comments.up,
            notes: comments.notes.iter().cloned().chain(notes).collect(),
            ..Decoded::new(gaussians, comments.opacity_mode)
        }
    }

    /// That elements other than `used` are not, if there are any with rows.
    fn unused_elements(&self, used: &[&str]) -> Option<String> {
        let unused = |element: &&Element| element.count > 0 && !used.contains(&element.name.as_str());
        let names: Vec<String> =
            self.elements.iter().filter(unused).map(|element| quoted(&element.name)).collect();
        unused_note("elements", &names)
    }
}
