//! ZIP archives: a bundled SOG, or a file of another format in one.

use std::io::Read;

use zip::ZipArchive;

use super::error::{LoadError, quoted, spelled};
use super::sog::missing;
use super::source::{Cursor, Files, Source, allowance};

/// The entries of an archive, as files.
pub(super) struct Archive<'a> {
    source: &'a Source<'a>,
    zip: ZipArchive<Cursor<'a>>,
    /// Folder within the archive that holds `meta.json`, with its `/`; empty at the root.
    prefix: String,
}

impl<'a> Archive<'a> {
    pub(super) fn open(source: &'a Source<'a>) -> Result<Self, LoadError> {
        let zip = ZipArchive::new(source.cursor()).map_err(|error| {
            LoadError::invalid(source.name(), "archive", "a ZIP archive", error.to_string())
        })?;
        // Some tools put a folder around the files.
        let mut metas = zip.file_names().flatten().filter(|name| name.ends_with("/meta.json"));
        let prefix = match (zip.index_for_name("meta.json"), metas.next(), metas.next()) {
            (None, Some(name), None) => name[..name.len() - "meta.json".len()].to_owned(),
            _ => String::new(),
        };
        drop(metas);
        Ok(Self { source, zip, prefix })
    }

    /// Whether this is a SOG bundle.
    pub(super) fn is_bundle(&self) -> bool {
        self.zip.index_for_name(&format!("{}meta.json", self.prefix)).is_some()
    }

    /// The one scene in an archive that is no SOG bundle.
    pub(super) fn single(&self) -> Result<Source<'_>, LoadError> {
        const SCENES: [&str; 6] = [".ply", ".spz", ".splat", ".ksplat", ".glb", ".rad"];
        let names: Vec<String> = self.zip.file_names().flatten().map(|name| name.to_string()).collect();
        // What macOS adds beside files are no files.
        let is_scene = |name: &&String| {
            let lower = name.to_ascii_lowercase();
            !lower.starts_with("__macosx/") && SCENES.iter().any(|extension| lower.ends_with(extension))
        };
        match names.iter().filter(is_scene).collect::<Vec<_>>()[..] {
            [name] => self.open(name),
            [] => {
                let first = names.first().map_or_else(|| "nothing".to_owned(), |name| quoted(name));
                let expected = "a SOG bundle (meta.json) or a scene";
                Err(LoadError::invalid(self.source.name(), "archive", expected, first))
            }
            [first, second, ..] => {
                let actual = format!("{} and {}", quoted(first), quoted(second));
                Err(LoadError::invalid(self.source.name(), "archive", "one scene", actual))
            }
        }
    }
}

impl Files for Archive<'_> {
    fn open(&self, name: &str) -> Result<Source<'_>, LoadError> {
        let label = spelled(&format!("{}/{name}", self.source.name()));
        let unreadable =
            |error: String| LoadError::invalid(&label, "archive entry", "a readable ZIP entry", error);
        let mut zip = self.zip.clone();
        let index = zip.index_for_name(&format!("{}{name}", self.prefix)).ok_or_else(|| missing(&label))?;
        let entry = zip.by_index(index).map_err(|error| unreadable(error.to_string()))?;
        // The size that the archive states is not believed: reading stops where a bomb begins.
        let limit = allowance(self.source.len());
        let mut bytes = Vec::new();
        entry.take(limit + 1).read_to_end(&mut bytes).map_err(|error| unreadable(error.to_string()))?;
        let actual = bytes.len() as u64;
        if actual > limit {
            let field = "archive entry".to_owned();
            return Err(LoadError::TooLarge { file: label, field, expected: limit, actual });
        }
        Ok(Source::memory(label, bytes))
    }
}
