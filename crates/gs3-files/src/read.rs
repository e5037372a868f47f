//! Reading.

use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Why a file cannot be read; what it is called, the caller knows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// What the system says.
    #[error("cannot read: {0}")]
    Io(#[from] io::Error),
    /// A folder or a device.
    #[error("path: expected a regular file or a pipe, found something else")]
    NoFile,
    /// It has more bytes than its reader takes.
    #[error("size: expected at most {most} bytes, found {}", .actual.map_or("more".to_owned(), |n| n.to_string()))]
    TooLarge {
        /// Bytes at most.
        most: u64,
        /// Bytes of the file; nothing of a pipe, which may have no end.
        actual: Option<u64>,
    },
}

impl From<ReadError> for io::Error {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Io(error) => error,
            ReadError::NoFile => Self::new(ErrorKind::InvalidInput, error),
            ReadError::TooLarge { .. } => Self::new(ErrorKind::FileTooLarge, error),
        }
    }
}

/// All bytes of a regular file or a pipe that ends within `most` bytes; no more is ever read, nor room made for it.
///
/// # Errors
/// [`ReadError`]; of anything but a file or a pipe before it is opened, which does things to some devices.
pub fn read_within(path: &Path, most: u64) -> Result<Vec<u8>, ReadError> {
    let found = fs::metadata(path)?;
    if !(found.is_file() || is_pipe(&found)) {
        return Err(ReadError::NoFile);
    }
    if found.len() > most {
        return Err(ReadError::TooLarge { most, actual: Some(found.len()) });
    }
    // The size was read earlier, and a pipe has none. A file that grows meanwhile is read to its end, like a pipe.
    let mut bytes = Vec::with_capacity(usize::try_from(found.len()).unwrap_or(0));
    File::open(path)?.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(ReadError::TooLarge { most, actual: None });
    }
    Ok(bytes)
}

#[cfg(unix)]
fn is_pipe(found: &Metadata) -> bool {
    std::os::unix::fs::FileTypeExt::is_fifo(&found.file_type())
}

#[cfg(not(unix))]
const fn is_pipe(_: &Metadata) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_the_bound_and_not_beyond() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, b"12345").unwrap();
        assert_eq!(read_within(&path, 5).unwrap(), b"12345");
        let error = read_within(&path, 4).unwrap_err();
        assert_eq!(error.to_string(), "size: expected at most 4 bytes, found 5");
        assert_eq!(io::Error::from(error).kind(), ErrorKind::FileTooLarge);
        // A sparse file of a terabyte: refused by its size, without allocating memory for it.
        File::options().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(matches!(read_within(&path, 1 << 30), Err(ReadError::TooLarge { .. })));
        assert!(matches!(read_within(folder.path(), 5), Err(ReadError::NoFile)));
        assert!(matches!(read_within(&folder.path().join("missing"), 5), Err(ReadError::Io(_))));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn pipes_are_read_and_devices_are_not() {
        assert!(matches!(read_within(Path::new("/dev/zero"), 5), Err(ReadError::NoFile)));
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for (most, holds) in [(5, true), (4, false)] {
            let writer = std::thread::spawn({
                let pipe = pipe.clone();
                move || fs::write(pipe, b"12345")
            });
            match read_within(&pipe, most) {
                Ok(bytes) => assert!(holds && bytes == b"12345"),
                Err(error) => {
                    assert!(!holds && error.to_string() == "size: expected at most 4 bytes, found more");
                }
            }
            // Whether the reader took all of it, or left early.
            let _ = writer.join().unwrap();
        }
    }
}
