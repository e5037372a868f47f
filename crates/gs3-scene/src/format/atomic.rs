//! Files that appear whole or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Writes the file at `path` through `write`. The bytes go to a temporary file beside it, which takes the
/// place of `path` once all of them are on disk; after an error or a panic it is gone and `path` is as it
/// was.
///
/// # Errors
/// What `write` or the system reports.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let (temporary, file) = Temporary::beside(path)?;
    let mut writer = BufWriter::with_capacity(1 << 20, file);
    write(&mut writer)?;
    writer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
    temporary.rename(path)
}

/// A file that is removed when dropped.
struct Temporary(PathBuf);

impl Temporary {
    fn beside(path: &Path) -> io::Result<(Self, File)> {
        // With the process and a number in its name no two writers meet.
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let name = path.file_name().ok_or_else(|| io::Error::other("the path names no file"))?;
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let mut hidden = std::ffi::OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}.{number}.partial", std::process::id()));
        let temporary = path.with_file_name(hidden);
        let file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
        Ok((Self(temporary), file))
    }

    fn rename(mut self, to: &Path) -> io::Result<()> {
        fs::rename(&self.0, to)?;
        self.0 = PathBuf::new();
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.0.as_os_str().is_empty() {
            // Nothing can be done where even this fails; the error that led here is already on its way.
            let _ = fs::remove_file(&self.0);
        }
    }
}

/// Writes `bytes` in rows that `fill` makes, a block of rows at a time, rows of a block on all cores.
pub(super) fn write_rows(
    writer: &mut impl Write,
    count: usize,
    row_bytes: usize,
    fill: impl Fn(usize, &mut [u8]) + Sync,
) -> io::Result<()> {
    use rayon::prelude::*;
    const BLOCK: usize = 1 << 15;
    let mut bytes = vec![0; BLOCK.min(count) * row_bytes];
    for first in (0..count).step_by(BLOCK) {
        let rows = &mut bytes[..BLOCK.min(count - first) * row_bytes];
        rows.par_chunks_exact_mut(row_bytes).with_min_len(256).enumerate().for_each(|(i, row)| {
            fill(first + i, row);
        });
        writer.write_all(rows)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_leaves_the_target_and_its_folder_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        fs::write(&path, b"before").unwrap();
        let result = write_atomically(&path, |writer| {
            writer.write_all(&[0; 4_000_000])?;
            Err(io::Error::other("full"))
        });
        assert_eq!(result.unwrap_err().to_string(), "full");
        assert_eq!(fs::read(&path).unwrap(), b"before");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file is left over");
        write_atomically(&path, |writer| writer.write_all(b"after")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"after");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
