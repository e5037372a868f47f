//! Bytes to read from: a file, a part of an archive, or memory, with one way to say what is missing.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
#[cfg(feature = "fs")]
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
#[cfg(feature = "fs")]
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use super::error::{LoadError, quoted, spelled};

/// Random access to named bytes, from many threads at once.
pub struct Source<'a> {
    name: String,
    len: u64,
    bytes: Bytes<'a>,
    stop: Option<&'a AtomicBool>,
}

impl fmt::Debug for Source<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Source").field("name", &self.name).field("len", &self.len).finish_non_exhaustive()
    }
}

enum Bytes<'a> {
    #[cfg(feature = "fs")]
    File(File),
    Memory(Cow<'a, [u8]>),
}

impl<'a> Source<'a> {
    /// The file at `path`.
    ///
    /// # Errors
    /// [`LoadError::Io`] if it cannot be opened, [`LoadError::Invalid`] if it is not a regular file.
    #[cfg(feature = "fs")]
    pub fn open(path: &Path) -> Result<Self, LoadError> {
        let name = spelled(&path.display().to_string());
        let io_error = |source| LoadError::Io { file: name.clone(), source };
        // Before opening: opening a pipe would wait for its writer.
        if !std::fs::metadata(path).map_err(io_error)?.is_file() {
            return Err(LoadError::invalid(&name, "path", "a regular file", "something else"));
        }
        let file = File::open(path).map_err(io_error)?;
        let len = file.metadata().map_err(io_error)?.len();
        Ok(Self { name, len, bytes: Bytes::File(file), stop: None })
    }

    /// Bytes in memory; `name` is for messages and, where the content has no signature, for its extension.
    pub fn memory(name: impl Into<String>, bytes: impl Into<Cow<'a, [u8]>>) -> Self {
        let bytes = bytes.into();
        Self { name: spelled(&name.into()), len: bytes.len() as u64, bytes: Bytes::Memory(bytes), stop: None }
    }

    /// The same bytes, which cannot be read any more once `stop` is set.
    #[must_use]
    pub fn until(self, stop: &'a AtomicBool) -> Self {
        Self { stop: Some(stop), ..self }
    }

    /// What messages call it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its length in bytes.
    #[must_use]
    pub const fn len(&self) -> u64 {
        self.len
    }

    /// Whether it has no bytes.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Fills `buffer` from `offset`; `field` says what is being read.
    pub(crate) fn read_at(&self, offset: u64, buffer: &mut [u8], field: &str) -> Result<(), LoadError> {
        if buffer.is_empty() {
            // Also beyond the end, where seeking may lead.
            return Ok(());
        }
        self.check_extent(offset, buffer.len() as u64, field)?;
        if self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
            return Err(LoadError::Stopped { file: self.name.clone() });
        }
        match &self.bytes {
            #[cfg(feature = "fs")]
            Bytes::File(file) => read_exact_at(file, buffer, offset)
                .map_err(|source| LoadError::Io { file: self.name.clone(), source }),
            Bytes::Memory(bytes) => {
                // In range by the check above, which is for at least one byte.
                let start = offset as usize;
                buffer.copy_from_slice(&bytes[start..start + buffer.len()]);
                Ok(())
            }
        }
    }

    /// Refuses a range that does not lie within the source.
    pub(crate) fn check_extent(&self, offset: u64, wanted: u64, field: &str) -> Result<(), LoadError> {
        let available = self.len.saturating_sub(offset);
        if wanted > available {
            return Err(LoadError::Truncated {
                file: self.name.clone(),
                field: field.to_owned(),
                expected: wanted,
                actual: available,
            });
        }
        Ok(())
    }

    /// The first bytes, at most `count`.
    pub(crate) fn head(&self, count: usize) -> Result<Vec<u8>, LoadError> {
        let mut head = vec![0; count.min(usize::try_from(self.len).unwrap_or(usize::MAX))];
        self.read_at(0, &mut head, "start of the file")?;
        Ok(head)
    }

    /// All bytes.
    pub(crate) fn bytes(&self) -> Result<Cow<'_, [u8]>, LoadError> {
        match &self.bytes {
            Bytes::Memory(bytes) => Ok(Cow::Borrowed(bytes)),
            #[cfg(feature = "fs")]
            Bytes::File(_) => {
                let len = usize::try_from(self.len).map_err(|_| LoadError::TooLarge {
                    file: self.name.clone(),
                    field: "size".to_owned(),
                    expected: usize::MAX as u64,
                    actual: self.len,
                })?;
                let mut bytes = vec![0; len];
                self.read_at(0, &mut bytes, "file")?;
                Ok(Cow::Owned(bytes))
            }
        }
    }

    /// A reader over all bytes with its own position.
    pub(crate) const fn cursor(&self) -> Cursor<'_> {
        Cursor { source: self, position: 0 }
    }
}

/// How much memory a file of `file_bytes` may unpack to. Trained scenes stay below 30 times the size of their file.
/// So 100 times the size, and a quarter of a gibibyte for the smallest files, allow unusual scenes and exclude
/// decompression bombs.
pub(crate) fn allowance(file_bytes: u64) -> u64 {
    file_bytes.saturating_mul(100).max(256 << 20)
}

/// Refuses parts that would unpack beyond [`allowance`].
pub(crate) fn check_allowance(
    file: &str,
    field: &str,
    file_bytes: u64,
    wanted: Option<u64>,
) -> Result<usize, LoadError> {
    let expected = allowance(file_bytes);
    // A size that overflows 64 bits is reported as the largest one that does not.
    let actual = wanted.unwrap_or(u64::MAX);
    match usize::try_from(actual) {
        Ok(bytes) if actual <= expected => Ok(bytes),
        _ => Err(LoadError::TooLarge { file: file.to_owned(), field: field.to_owned(), expected, actual }),
    }
}

/// [`Read`] and [`Seek`] over a [`Source`], cheap to clone.
#[derive(Clone)]
pub(crate) struct Cursor<'a> {
    source: &'a Source<'a>,
    position: u64,
}

impl Read for Cursor<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let available = self.source.len.saturating_sub(self.position);
        let count = buffer.len().min(usize::try_from(available).unwrap_or(usize::MAX));
        self.source.read_at(self.position, &mut buffer[..count], "data").map_err(|error| match error {
            LoadError::Io { source, .. } => source,
            other => io::Error::new(io::ErrorKind::UnexpectedEof, other),
        })?;
        self.position += count as u64;
        Ok(count)
    }
}

impl Seek for Cursor<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(offset) => self.source.len.checked_add_signed(offset),
            SeekFrom::Current(offset) => self.position.checked_add_signed(offset),
        };
        self.position = position.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.position)
    }
}

/// Files that belong together and name one another: a folder, an archive, or memory.
pub trait Files: Sync {
    /// The file called `name`, a relative path with `/` between its parts.
    ///
    /// # Errors
    /// [`LoadError`] if there is none or it cannot be read.
    fn open(&self, name: &str) -> Result<Source<'_>, LoadError>;
}

impl Files for BTreeMap<String, Vec<u8>> {
    fn open(&self, name: &str) -> Result<Source<'_>, LoadError> {
        let bytes = self.get(name).ok_or_else(|| LoadError::Io {
            file: spelled(name),
            source: io::Error::from(io::ErrorKind::NotFound),
        })?;
        Ok(Source::memory(name, bytes))
    }
}

/// `name`, which a file gives, relative to `folder`. It must stay inside: a scene must not make gs3 open
/// other files of its reader.
pub(crate) fn inside(file: &str, field: &str, folder: &str, name: &str) -> Result<String, LoadError> {
    let plain =
        |part: &str| !part.is_empty() && part != ".." && part != "." && !part.contains(['\\', ':', '\0']);
    if !name.split('/').all(plain) {
        let expected = "a relative path inside the scene's folder";
        return Err(LoadError::invalid(file, field, expected, quoted(name)));
    }
    Ok(if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") })
}

#[cfg(all(feature = "fs", unix))]
fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset)
}

#[cfg(all(feature = "fs", windows))]
fn read_exact_at(file: &File, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        let count = std::os::windows::fs::FileExt::seek_read(file, buffer, offset)?;
        if count == 0 {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof));
        }
        buffer = &mut buffer[count..];
        offset += count as u64;
    }
    Ok(())
}

/// Elsewhere one position is shared; reads are one after another.
#[cfg(all(feature = "fs", not(any(unix, windows))))]
fn read_exact_at(mut file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    file.seek(SeekFrom::Start(offset))?;
    file.read_exact(buffer)
}
