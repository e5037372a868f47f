//! Writing.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::place::Place;

/// Writes the file at `path` through `write`. The bytes go to a temporary file beside it, which takes the
/// place of `path` once all of them are on disk; after an error or a panic it is gone and `path` is as it
/// was. Of a symbolic link it is the file that is replaced. What is there and no file, such as a device or a
/// pipe, is written to as the bytes come.
///
/// # Errors
/// What `write` or the system reports.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    match Place::of(path)? {
        Place::File(path) => {
            let mut file = AtomicFile::at(path)?;
            write(&mut file.writer)?;
            file.commit()
        }
        Place::Stream => {
            let mut writer = BufWriter::with_capacity(1 << 20, OpenOptions::new().write(true).open(path)?);
            write(&mut writer)?;
            writer.flush()
        }
    }
}

/// Writes `bytes` as a file at `path` where nothing is yet: of several writers at once, in processes of several machines too,
/// one succeeds. The file appears whole; file systems without hard links may show a part of it for a moment.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`] if something is there, which stays as it is; else what the system reports.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let (temporary, mut file) = Temporary::beside(path)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    match fs::hard_link(&temporary.0, path) {
        Err(error) if matches!(error.kind(), ErrorKind::Unsupported | ErrorKind::PermissionDenied) => {
            let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
            file.write_all(bytes)?;
            file.sync_all()
        }
        linked => linked,
    }
}

/// A file that is written bit by bit, while other work goes on between, and appears under its name once it is
/// whole. Dropped before, it leaves nothing; [`discard_temporaries`] knows it, too.
#[derive(Debug)]
pub struct AtomicFile {
    path: PathBuf,
    temporary: Temporary,
    writer: BufWriter<File>,
}

impl AtomicFile {
    /// Begins the file at `path`; of a symbolic link that is the file that it leads to.
    ///
    /// # Errors
    /// What the system reports; [`ErrorKind::InvalidInput`] for a device, a pipe or a folder.
    pub fn create(path: &Path) -> io::Result<Self> {
        match Place::of(path)? {
            Place::File(path) => Self::at(path),
            Place::Stream => Err(io::Error::new(ErrorKind::InvalidInput, "expected a file or none yet")),
        }
    }

    fn at(path: PathBuf) -> io::Result<Self> {
        let (temporary, file) = Temporary::beside(&path)?;
        Ok(Self { path, temporary, writer: BufWriter::with_capacity(1 << 20, file) })
    }

    /// Waits until all bytes are on disk and puts the file in its place.
    ///
    /// # Errors
    /// What the system reports; `path` is unchanged then.
    pub fn commit(self) -> io::Result<()> {
        let path = self.path.clone();
        self.commit_as(&path)
    }

    /// The same under another name: `path` lies in the folder of the path that [`Self::create`] was given.
    ///
    /// # Errors
    /// What the system reports; `path` is unchanged then.
    pub fn commit_as(self, path: &Path) -> io::Result<()> {
        self.writer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        self.temporary.rename(path)
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to)
    }
}

/// Checks that [`write_atomically`] can put a file at `path`, before the work for the file is done. Missing folders
/// count as existing.
///
/// # Errors
/// What the system would report.
pub fn check_writable(path: &Path) -> io::Result<()> {
    let Place::File(path) = Place::of(path)? else { return Ok(()) };
    let is_there = |folder: &&Path| folder.as_os_str().is_empty() || folder.exists();
    let folder = path.ancestors().skip(1).find(is_there).unwrap_or(Path::new(""));
    let path = folder.join(path.file_name().unwrap_or_default());
    // A name that is too long is no temporary file's fault.
    match fs::symlink_metadata(&path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Temporary::beside(&path).map(drop),
    }
}

/// Removes the temporary files of all writes under way, for a process that is about to end. Writers block from then
/// on, so that nothing is left behind.
pub fn discard_temporaries() {
    let temporaries = temporaries();
    for temporary in temporaries.iter() {
        // The process ends whether or not this one can be removed.
        let _ = fs::remove_file(temporary);
    }
    std::mem::forget(temporaries);
}

/// The temporary files there are.
fn temporaries() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    static ALL: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    ALL.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that is removed when dropped.
#[derive(Debug)]
struct Temporary(PathBuf);

impl Temporary {
    fn beside(path: &Path) -> io::Result<(Self, File)> {
        // With the process and a number in its name no two writers meet; with nothing else in it, it fits wherever the
        // file's own name does.
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        if path.file_name().is_none() {
            return Err(io::Error::other("the path names no file"));
        }
        loop {
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let temporary = path.with_file_name(format!(".gs3.{}.{number}.partial", std::process::id()));
            let mut all = temporaries();
            match OpenOptions::new().write(true).create_new(true).open(&temporary) {
                // Left by a process of the same number that was killed, or in use by one of another machine.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
                Ok(file) => {
                    all.insert(temporary.clone());
                    return Ok((Self(temporary), file));
                }
            }
        }
    }

    fn rename(mut self, to: &Path) -> io::Result<()> {
        let mut all = temporaries();
        fs::rename(&self.0, to)?;
        all.remove(&self.0);
        self.0 = PathBuf::new();
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.0.as_os_str().is_empty() {
            // Nothing can be done where even this fails; the error that led here is already on its way.
            let _ = fs::remove_file(&self.0);
            temporaries().remove(&self.0);
        }
    }
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

    #[test]
    fn a_file_written_bit_by_bit_appears_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.mp4");
        fs::write(&path, b"before").unwrap();
        for is_whole in [false, true] {
            let mut file = AtomicFile::create(&path).unwrap();
            file.write_all(b"?fter").unwrap();
            file.seek(SeekFrom::Start(0)).unwrap();
            file.write_all(b"a").unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"before");
            if is_whole {
                file.commit().unwrap();
            } else {
                drop(file);
            }
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file is left over");
        }
        assert_eq!(fs::read(&path).unwrap(), b"after");
        assert_eq!(AtomicFile::create(folder.path()).unwrap_err().kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn one_of_many_writers_makes_a_new_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("manifest.json");
        let results: Vec<_> = std::thread::scope(|scope| {
            let write = |k: u8| write_new(&folder.path().join("manifest.json"), &[k; 5000]).map(|()| k);
            let threads: Vec<_> = (0..8).map(|k| scope.spawn(move || write(k))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let winners: Vec<u8> = results.iter().filter_map(|result| result.as_ref().ok().copied()).collect();
        assert_eq!(winners.len(), 1);
        assert_eq!(fs::read(&path).unwrap(), [winners[0]; 5000]);
        let others = results.iter().filter_map(|result| result.as_ref().err());
        others.for_each(|error| assert_eq!(error.kind(), ErrorKind::AlreadyExists));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    #[cfg(unix)]
    fn names_are_as_long_as_the_system_lets_them() {
        let folder = tempfile::tempdir().unwrap();
        // 255 bytes in all common file systems.
        let longest = folder.path().join(format!("{}.ply", "n".repeat(251)));
        check_writable(&longest).unwrap();
        write_atomically(&longest, |writer| writer.write_all(b"text")).unwrap();
        assert_eq!(fs::read(&longest).unwrap(), b"text");
        let longer = "n".repeat(256);
        for path in [folder.path().join(&longer), folder.path().join("missing").join(&longer)] {
            assert!(check_writable(&path).is_err(), "{}", path.display());
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_a_killed_process_left_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        // The numbers that come next, others' tests included.
        let (first, file) = Temporary::beside(&folder.path().join("file")).unwrap();
        drop(file);
        let name = first.0.file_name().unwrap().to_str().unwrap().to_owned();
        let number: u64 = name.split('.').rev().nth(1).unwrap().parse().unwrap();
        for next in number + 1..number + 100 {
            let left = name.replace(&format!(".{number}.partial"), &format!(".{next}.partial"));
            fs::write(folder.path().join(left), b"left").unwrap();
        }
        write_atomically(&folder.path().join("file"), |writer| writer.write_all(b"text")).unwrap();
        assert_eq!(fs::read(folder.path().join("file")).unwrap(), b"text");
    }

    #[test]
    #[cfg(unix)]
    fn links_stay_and_their_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("far")).unwrap();
        fs::write(at("far/file"), b"before").unwrap();
        for (link, target) in [("link", "far/file"), ("chain", "link"), ("dangling", "far/new")] {
            std::os::unix::fs::symlink(target, at(link)).unwrap();
            check_writable(&at(link)).unwrap();
            write_atomically(&at(link), |writer| writer.write_all(link.as_bytes())).unwrap();
            assert_eq!(fs::read_link(at(link)).unwrap(), Path::new(target));
            assert_eq!(fs::read(at(link)).unwrap(), link.as_bytes());
        }
        assert_eq!(fs::read(at("far/file")).unwrap(), b"chain");
        assert_eq!(fs::read_dir(at("far")).unwrap().count(), 2);
        std::os::unix::fs::symlink("circle", at("circle")).unwrap();
        assert!(write_atomically(&at("circle"), |_| Ok(())).is_err());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn devices_and_pipes_are_written_to() {
        use std::os::unix::fs::FileTypeExt;
        let full = Path::new("/dev/full");
        let error = write_atomically(full, |writer| writer.write_all(b"text")).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
        assert!(fs::metadata(full).unwrap().file_type().is_char_device());

        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).unwrap()
        });
        write_atomically(&pipe, |writer| writer.write_all(b"text")).unwrap();
        assert_eq!(reader.join().unwrap(), b"text");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        check_writable(&at("missing/folders/file")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "it leaves nothing");
        fs::write(at("file"), b"no folder").unwrap();
        assert!(check_writable(&at("file/file")).is_err() && check_writable(&at("file/deep/file")).is_err());
    }
}
