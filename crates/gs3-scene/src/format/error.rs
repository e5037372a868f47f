//! Why a scene file cannot be read or written: one readable line with file, field, expected and actual.

use std::io;
use std::path::PathBuf;

use crate::scene::SceneError;

/// What [`super::load`] reads, for messages.
const READ: &str = "PLY, compressed PLY, SPZ, SOG, glTF with KHR_gaussian_splatting, .rad, LCC2, or a name ending in .splat or .ksplat";

/// Why a scene cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The file cannot be opened or read.
    #[error("{file}: cannot be read: {source}")]
    Io {
        /// The file.
        file: String,
        /// What the system says.
        source: io::Error,
    },
    /// The caller has stopped loading ([`super::load_until`]).
    #[error("{file}: stopped before it was loaded")]
    Stopped {
        /// The file that was being read.
        file: String,
    },
    /// A folder is no scene.
    #[error(
        "{}: expected a scene file, or a folder with lod-meta.json, meta.json or meta.lcc2, found a folder without \
         them{}",
        folder.display(),
        match plys { 0 | 1 => String::new(), n => format!(" (of a sequence of {n} PLY files each is a scene)") }
    )]
    NoScene {
        /// The folder.
        folder: PathBuf,
        /// PLY files in it.
        plys: usize,
    },
    /// The content is known and has no Gaussians, or not in a way that is read.
    #[error("{file}: format: expected 3D Gaussians ({READ}), found {actual}")]
    NotGaussians {
        /// The file.
        file: String,
        /// What it is.
        actual: String,
    },
    /// The content is of no format that is read.
    #[error("{file}: format: expected 3D Gaussians ({READ}), found {actual}")]
    UnknownFormat {
        /// The file.
        file: String,
        /// What the content starts with.
        actual: String,
    },
    /// The file ends before its data does.
    #[error("{file}: {field}: expected {expected} bytes, found {actual}")]
    Truncated {
        /// The file.
        file: String,
        /// Which part is cut off.
        field: String,
        /// How many bytes the part needs.
        expected: u64,
        /// How many bytes there are.
        actual: u64,
    },
    /// A part would need implausibly much memory for the size of its file.
    #[error("{file}: {field}: expected at most {expected} bytes for a file of this size, found {actual}")]
    TooLarge {
        /// The file.
        file: String,
        /// Which part.
        field: String,
        /// The most bytes that a file of this size may unpack to.
        expected: u64,
        /// How many bytes the part asks for.
        actual: u64,
    },
    /// The system has not enough memory for the scene.
    #[error("{file}: Gaussians: expected {expected} bytes of free memory, found less")]
    Memory {
        /// The file.
        file: String,
        /// How many bytes the Gaussians take.
        expected: u64,
    },
    /// A field does not hold what the format asks for.
    #[error("{file}: {field}: expected {expected}, found {actual}")]
    Invalid {
        /// The file.
        file: String,
        /// The field's name in the format.
        field: String,
        /// What the format asks for.
        expected: String,
        /// What is there.
        actual: String,
    },
    /// The Gaussians do not make a scene.
    #[error("{file}: {source}")]
    Scene {
        /// The file.
        file: String,
        /// Why.
        source: SceneError,
    },
}

impl LoadError {
    pub(crate) fn invalid(
        file: &str,
        field: impl Into<String>,
        expected: impl Into<String>,
        actual: impl Into<String>,
    ) -> Self {
        Self::Invalid {
            file: file.to_owned(),
            field: field.into(),
            expected: expected.into(),
            actual: actual.into(),
        }
    }
}

/// Why a scene cannot be saved. Nothing is left at the target that was not there before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SaveError {
    /// The file cannot be written.
    #[error("{}: cannot be written: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The extension names no format that is written.
    #[error("{}: extension: expected .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json, found {actual:?}", file.display())]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// Its extension.
        actual: String,
    },
    /// The scene does not fit the format.
    #[error("{}: {field}: expected {expected}, found {actual}", file.display())]
    Unrepresentable {
        /// The file.
        file: PathBuf,
        /// Which part of the scene.
        field: &'static str,
        /// What the format can hold.
        expected: String,
        /// What the scene has.
        actual: String,
    },
}

/// The name of a file for a message. Control characters, which names in archives may have, are spelled: they would break the
/// line, or change the terminal. Names in archives have up to 65,535 bytes: of a long one the beginning and the end are left.
pub(crate) fn spelled(name: &str) -> String {
    const LONGEST: usize = 400;
    let spell = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    let spelled: String = name.chars().map(spell).collect();
    let count = spelled.chars().count();
    if count <= LONGEST {
        return spelled;
    }
    let begin: String = spelled.chars().take(LONGEST / 2).collect();
    let end: String = spelled.chars().skip(count - LONGEST / 2).collect();
    format!("{begin}…{end}")
}

/// `text` from outside, fit for one line of a message: quoted, control characters escaped, cut at 60
/// characters.
pub(crate) fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    if text.chars().count() > LONGEST {
        format!("{:?}…", text.chars().take(LONGEST).collect::<String>())
    } else {
        format!("{text:?}")
    }
}

#[cfg(test)]
mod tests {
    use super::spelled;

    #[test]
    fn names_are_one_line_of_a_readable_length() {
        assert_eq!(spelled("gärten/a\n\u{1b}[2J.ply"), "gärten/a\\n\\u{1b}[2J.ply");
        let long = format!("{}/{}.ply", "a".repeat(30_000), "\u{0}".repeat(30_000));
        let short = spelled(&long);
        assert_eq!(short.chars().count(), 401);
        assert!(short.starts_with("aaaa") && short.ends_with("\\u{0}.ply"), "{short}");
    }
}
