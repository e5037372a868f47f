//! What a reader knows beside the bytes of its file: what the caller states, and files beside it.

use std::cell::RefCell;
#[cfg(feature = "fs")]
use std::path::{Path, PathBuf};

#[cfg(feature = "fs")]
use gs3_files::read_within;

use super::CaptureOptions;
#[cfg(feature = "fs")]
use super::{MAX_JSON_BYTES, picture};
use crate::format::unused_note;
use crate::size::Size;

/// Where a file of cameras lies, and what its reader has to tell.
pub(super) struct Context<'a> {
    pub(super) options: &'a CaptureOptions,
    /// The folder of the file; none of bytes in memory, which have no files beside them.
    #[cfg(feature = "fs")]
    folder: Option<PathBuf>,
    notes: RefCell<Vec<String>>,
}

impl<'a> Context<'a> {
    /// The context of bytes in memory: no files beside them.
    pub(super) const fn in_memory(options: &'a CaptureOptions) -> Self {
        Self {
            options,
            #[cfg(feature = "fs")]
            folder: None,
            notes: RefCell::new(Vec::new()),
        }
    }

    /// Adds a note, unless the same note has been added.
    pub(super) fn note(&self, note: String) {
        let mut notes = self.notes.borrow_mut();
        if !notes.contains(&note) {
            notes.push(note);
        }
    }

    /// Tells that fields called `names` are not used.
    pub(super) fn note_unknown(&self, mut names: Vec<String>) {
        names.sort_unstable();
        names.dedup();
        if let Some(note) = unused_note("fields", &names) {
            self.note(note);
        }
    }

    /// All that there is to tell.
    pub(super) fn into_notes(self) -> Vec<String> {
        self.notes.into_inner()
    }
}

#[cfg(feature = "fs")]
impl<'a> Context<'a> {
    /// The context of the file at `path`: its folder is looked into.
    pub(super) fn beside(path: &Path, options: &'a CaptureOptions) -> Self {
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Self { folder: Some(folder), ..Self::in_memory(options) }
    }

    /// The bytes of the file called `name` beside this one, where there is one.
    pub(super) fn sibling(&self, name: &str) -> Option<Vec<u8>> {
        let file = self.folder.as_ref()?.join(name);
        file.is_file().then(|| read_within(&file, MAX_JSON_BYTES).ok()).flatten()
    }

    /// The size of the picture called `name`, a path from the file's folder or from its `images`; the extension
    /// may be missing. Only pictures within those folders are looked at.
    pub(super) fn picture_size(&self, name: &str) -> Option<Size> {
        let folder = self.folder.as_ref()?;
        let relative = Path::new(name.trim_start_matches("./"));
        let is_inside = relative.components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if name.is_empty() || !is_inside {
            return None;
        }
        let files = [folder.join(relative), folder.join("images").join(relative)];
        files.into_iter().flat_map(|file| with_extensions(&file)).find_map(|file| picture::size(&file))
    }
}

/// Without a file system there is nothing beside bytes.
#[cfg(not(feature = "fs"))]
impl Context<'_> {
    #[expect(clippy::unused_self, reason = "a folder would answer")]
    pub(super) const fn sibling(&self, _: &str) -> Option<Vec<u8>> {
        None
    }

    #[expect(clippy::unused_self, reason = "a folder would answer")]
    pub(super) const fn picture_size(&self, _: &str) -> Option<Size> {
        None
    }
}

/// `file`, and the same with the extensions that captures leave out.
#[cfg(feature = "fs")]
fn with_extensions(file: &Path) -> Vec<PathBuf> {
    let with = |extension: &str| PathBuf::from(format!("{}.{extension}", file.display()));
    std::iter::once(file.to_owned()).chain(["png", "jpg", "jpeg", "JPG", "PNG"].map(with)).collect()
}
