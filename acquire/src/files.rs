//! Files that never overwrite others: a live take has its own name from the start, other files get theirs when
//! complete.

mod dataset;
mod new_file;
mod staging;
mod take_file;

use std::{
    fs::{File, OpenOptions},
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
    os::{fd::AsRawFd, unix::fs::FileExt},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::{Context, anyhow, ensure};
use mocapd_drivers::plain_file::{self, NotAFile};
use mocapd_take::foreign::content::ScratchFile;
use rustix::{
    fs::{self, seek},
    io::Errno,
};
use serde::{Serialize, Serializer};

pub use self::{
    dataset::{DatasetError, NewRecording},
    new_file::{Kept, NewFile, remove_incomplete_outputs},
    staging::rename_new,
    take_file::{
        DisplacedFile, FileId, FileState, SettledFile, TakeFile, TakeOutput, is_being_written,
    },
};

/// Why a file cannot be opened or created. The message is one line that says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The file does not exist.
    #[error("{} does not exist", .0.display())]
    NotFound(PathBuf),
    /// It is not a regular file.
    #[error("{} is {}", .0.display(), .1)]
    NotAFile(PathBuf, NotAFile),
    /// The user has no permission to read it.
    #[error("no permission to read {}: check its owner and mode with ls -l", .0.display())]
    NotReadable(PathBuf),
    /// Its folder does not exist.
    #[error("the folder {} does not exist: create it first", .0.display())]
    NoFolder(PathBuf),
    /// The user has no permission to create it.
    #[error("no permission to create {}: choose a folder that you may write to", .0.display())]
    NotWritable(PathBuf),
}

/// Opens a file for reading.
///
/// # Errors
/// A [`FileError`] when it does not exist, is a folder, a pipe or a device, or may not be read.
pub fn open(path: &Path) -> anyhow::Result<File> {
    plain_file::open(path).map_err(|error| match (NotAFile::why(&error), error.kind()) {
        (Some(what), _) => FileError::NotAFile(path.to_owned(), what).into(),
        (None, io::ErrorKind::NotFound) => FileError::NotFound(path.to_owned()).into(),
        (None, io::ErrorKind::PermissionDenied) => FileError::NotReadable(path.to_owned()).into(),
        (None, _) => anyhow!("cannot open {}: {error}", path.display()),
    })
}

/// Reads a file of at most `len_max` bytes.
///
/// # Errors
/// When it is longer or cannot be read.
pub fn read_bounded(path: &Path, len_max: usize) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut file = open(path)?.take(len_max as u64 + 1);
    file.read_to_end(&mut bytes).with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(
        bytes.len() <= len_max,
        "{} has more than {len_max} bytes, the limit for such a file: check that it is the right one",
        path.display()
    );
    Ok(bytes)
}

/// Creates a file that must not exist yet.
///
/// # Errors
/// [`NameTaken`] when it exists; otherwise why it cannot be created.
pub fn create_new(path: &Path) -> anyhow::Result<File> {
    let created = OpenOptions::new().write(true).create_new(true).open(path);
    created.map_err(|error| cannot_create(path, &error))
}

/// Makes the name of a new file survive a power cut, as a sync does for its content. A file system that cannot sync
/// folders keeps names by its own means.
pub fn sync_name(path: &Path) {
    if let Ok(folder) = File::open(folder_of(path)) {
        folder.sync_all().ok();
    }
}

/// The folder that contains `path`.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

fn cannot_create(path: &Path, error: &io::Error) -> anyhow::Error {
    match error.kind() {
        io::ErrorKind::AlreadyExists => name_taken(path),
        io::ErrorKind::NotFound => FileError::NoFolder(folder_of(path).to_owned()).into(),
        io::ErrorKind::PermissionDenied => FileError::NotWritable(path.to_owned()).into(),
        _ => anyhow!("cannot create {}: {error}", path.display()),
    }
}

/// A file or folder of this name exists already.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{} exists already: choose another name or move it", path.display())]
pub struct NameTaken {
    /// The name.
    pub path: PathBuf,
}

fn name_taken(path: &Path) -> anyhow::Error {
    NameTaken { path: path.to_owned() }.into()
}

/// The link in `/proc` to an open file.
fn proc_link(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

/// Serialises a path as text, for `serialize_with`.
///
/// # Errors
/// The serializer's.
pub fn path_as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// Serialises an optional path as text or null, for `serialize_with`.
///
/// # Errors
/// The serializer's.
pub fn path_as_text_or_null<S: Serializer>(
    path: &Option<PathBuf>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    path.as_deref().map(Path::to_string_lossy).serialize(serializer)
}

#[derive(Debug)]
struct Scratch {
    file: File,
    dir: PathBuf,
}

impl ScratchFile for Scratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(bytes, at)
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all_at(bytes, at).map_err(|error| scratch_error(&self.dir, &error))
    }
}

/// A file without a name, which disappears with the process. It is created in `$TMPDIR`, else in `/var/tmp`, which is
/// on a disk where `/tmp` is often memory.
///
/// # Errors
/// When it cannot be created. The message says what to do.
pub fn scratch() -> io::Result<Arc<dyn ScratchFile>> {
    let (file, dir) = unnamed()?;
    Ok(Arc::new(Scratch { file, dir }))
}

/// A file without a name, as [`scratch`] creates, for reading and writing.
///
/// # Errors
/// When it cannot be created. The message says what to do.
pub fn temporary() -> io::Result<File> {
    Ok(unnamed()?.0)
}

/// A file without a name, as [`temporary`] creates, for this many bytes.
///
/// # Errors
/// If it cannot be created, or its disk has less space; the message says what to do.
pub fn temporary_for(bytes: u64) -> io::Result<File> {
    let (file, dir) = unnamed()?;
    let disk = fs::fstatvfs(&file).ok().filter(|disk| disk.f_blocks > 0);
    let free = disk.map_or(u64::MAX, |disk| disk.f_bavail.saturating_mul(disk.f_frsize));
    if free >= bytes {
        return Ok(file);
    }
    let message = format!(
        "{bytes} bytes are needed in {}, which has {free} free: set TMPDIR to another folder",
        dir.display()
    );
    Err(io::Error::new(io::ErrorKind::StorageFull, message))
}

/// A file without a name, and its folder.
fn unnamed() -> io::Result<(File, PathBuf)> {
    let chosen = std::env::var_os("TMPDIR").filter(|dir| !dir.is_empty()).map(PathBuf::from);
    let on_disk = || Some(PathBuf::from("/var/tmp")).filter(|dir| dir.is_dir());
    let dir = chosen.or_else(on_disk).unwrap_or_else(std::env::temp_dir);
    let file = tempfile::tempfile_in(&dir).map_err(|error| scratch_error(&dir, &error))?;
    Ok((file, dir))
}

fn scratch_error(dir: &Path, error: &io::Error) -> io::Error {
    let message = format!(
        "cannot create a temporary file in {} ({error}): set TMPDIR to another folder",
        dir.display()
    );
    io::Error::new(error.kind(), message)
}

/// Reads a sparse file and returns the zeros of its holes without reading them: a file system would fill memory with
/// them, over the whole length that the file claims, in ten times the time.
#[derive(Debug)]
pub struct SparseFile {
    file: File,
    at: u64,
    hole: Range<u64>,
    data: Range<u64>,
}

impl SparseFile {
    /// Opens a file.
    ///
    /// # Errors
    /// A [`FileError`] when it cannot be opened.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        open(path).map(Self::of)
    }

    /// Wraps an open file, and reads it from its beginning.
    #[must_use]
    pub fn of(file: File) -> Self {
        Self { file, at: 0, hole: 0..0, data: 0..0 }
    }

    /// Length in bytes, including holes.
    ///
    /// # Errors
    /// The system's.
    pub fn len_bytes(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Finds the extent at the current position: data or a hole, and its end.
    fn locate_extent(&mut self) -> io::Result<()> {
        let at = self.at;
        (self.hole, self.data) = match seek(&self.file, fs::SeekFrom::Data(at)) {
            Ok(data) if data > at => (at..data, 0..0),
            Ok(_) => {
                let end = seek(&self.file, fs::SeekFrom::Hole(at)).unwrap_or(u64::MAX);
                (0..0, at..end)
            }
            // A hole up to the end of the file, or the end itself.
            Err(Errno::NXIO) => (at..self.len_bytes()?, 0..0),
            // A file system without holes.
            Err(_) => (0..0, at..u64::MAX),
        };
        Ok(())
    }
}

impl Read for SparseFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if !self.hole.contains(&self.at) && !self.data.contains(&self.at) {
            self.locate_extent()?;
        }
        let up_to = |end: u64| {
            let left = usize::try_from(end - self.at).unwrap_or(usize::MAX);
            bytes.len().min(left)
        };
        let n = if self.hole.contains(&self.at) {
            let n = up_to(self.hole.end);
            bytes[..n].fill(0);
            n
        } else if self.data.contains(&self.at) {
            let n = up_to(self.data.end);
            self.file.read_at(&mut bytes[..n], self.at)?
        } else {
            0
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for SparseFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let beyond = || io::Error::from(io::ErrorKind::InvalidInput);
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) => self.at.checked_add_signed(by).ok_or_else(beyond)?,
            SeekFrom::End(by) => self.len_bytes()?.checked_add_signed(by).ok_or_else(beyond)?,
        };
        Ok(self.at)
    }
}

/// A file that counts the bytes read from it, for a progress display.
#[derive(Debug)]
pub struct CountingFile {
    file: SparseFile,
    read: Arc<AtomicU64>,
}

impl CountingFile {
    /// Adds the bytes that are read to `read`.
    #[must_use]
    pub fn new(file: SparseFile, read: &Arc<AtomicU64>) -> Self {
        Self { file, read: Arc::clone(read) }
    }
}

impl Read for CountingFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(bytes)?;
        self.read.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
}

impl Seek for CountingFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_temporary_file_is_refused_that_does_not_fit() {
        let mut file = temporary_for(1000).unwrap();
        file.write_all(&[0; 1000]).unwrap();
        let error = temporary_for(u64::MAX).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(error.to_string().contains("set TMPDIR to another folder"), "{error}");
    }

    #[test]
    fn holes_are_zeros_and_data_is_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("holes");
        let mut file = File::create(&path).unwrap();
        file.write_all(b"first").unwrap();
        file.seek(SeekFrom::Start(300_000)).unwrap();
        file.write_all(b"second").unwrap();
        file.set_len(700_000).unwrap();
        let mut expected = Vec::new();
        File::open(&path).unwrap().read_to_end(&mut expected).unwrap();
        let mut holes = SparseFile::open(&path).unwrap();
        assert_eq!(holes.len_bytes().unwrap(), 700_000);
        for from in [0, 3, 299_999, 300_003, 699_999, 700_000, 800_000] {
            assert_eq!(holes.seek(SeekFrom::Start(from as u64)).unwrap(), from as u64);
            let mut read = Vec::new();
            holes.read_to_end(&mut read).unwrap();
            assert!(read == expected.get(from..).unwrap_or_default(), "from byte {from}");
        }
        assert_eq!(holes.seek(SeekFrom::End(-400_000)).unwrap(), 300_000);
        assert_eq!(holes.seek(SeekFrom::Current(2)).unwrap(), 300_002);
        let mut read = [0; 4];
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"cond");
        // Data appended meanwhile is found.
        file.seek(SeekFrom::End(0)).unwrap();
        holes.seek(SeekFrom::End(0)).unwrap();
        assert_eq!(holes.read(&mut read).unwrap(), 0);
        file.write_all(b"more").unwrap();
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"more");
    }
}
