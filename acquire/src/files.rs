//! Files that are never overwritten: live takes under their own name, everything else beside it first.

mod file_state;
mod new_file;
mod take_file;

use std::{
    fs::{File, OpenOptions},
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
    os::{fd::AsRawFd, unix::fs::FileExt},
    path::{Path, PathBuf},
    sync::Arc,
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
    file_state::{Displaced, FileState, Settled},
    new_file::{NewFile, NewFolder},
    take_file::{FileId, TakeFile, TakeOutput, is_being_written},
};

/// Why a file cannot be opened or created. The message is one line that says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// Nothing is there.
    #[error("{} does not exist", .0.display())]
    NotFound(PathBuf),
    /// What is there is no plain file.
    #[error("{} is {}", .0.display(), .1)]
    NotAFile(PathBuf, NotAFile),
    /// The user may not read it.
    #[error("no permission to read {}: try ls -l on it", .0.display())]
    NotReadable(PathBuf),
    /// The folder that it would be in is not there.
    #[error("the folder {} does not exist: create it first", .0.display())]
    NoFolder(PathBuf),
    /// The user may not create it.
    #[error("no permission to create {}: choose a folder that you may write to", .0.display())]
    NotWritable(PathBuf),
}

/// Opens a file to read.
///
/// # Errors
/// That it is not there, is a folder, a pipe or a device, or may not be read: each a [`FileError`].
pub fn open(path: &Path) -> anyhow::Result<File> {
    plain_file::open(path).map_err(|error| match (NotAFile::why(&error), error.kind()) {
        (Some(what), _) => FileError::NotAFile(path.to_owned(), what).into(),
        (None, io::ErrorKind::NotFound) => FileError::NotFound(path.to_owned()).into(),
        (None, io::ErrorKind::PermissionDenied) => FileError::NotReadable(path.to_owned()).into(),
        (None, _) => anyhow!("cannot open {}: {error}", path.display()),
    })
}

/// The bytes of a file that has no more of them than `len_max`.
///
/// # Errors
/// That it has more, or cannot be read.
pub fn read_bounded(path: &Path, len_max: usize) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut file = open(path)?.take(len_max as u64 + 1);
    file.read_to_end(&mut bytes).with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(
        bytes.len() <= len_max,
        "{} has more than {len_max} bytes, the most that is read of such a file: is it another one?",
        path.display()
    );
    Ok(bytes)
}

/// Creates a file that must not exist yet.
///
/// # Errors
/// That it exists, or why it cannot be created.
pub fn create_new(path: &Path) -> anyhow::Result<File> {
    let created = OpenOptions::new().write(true).create_new(true).open(path);
    created.map_err(|error| cannot_create(path, &error))
}

/// Makes the name of a new file survive a power cut, as a sync makes its content. Where a file system has no such
/// sync of folders, it keeps names in its own way.
pub fn sync_name(path: &Path) {
    if let Ok(folder) = File::open(folder_of(path)) {
        folder.sync_all().ok();
    }
}

/// The folder that a file at `path` is in, or would be.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

fn cannot_create(path: &Path, error: &io::Error) -> anyhow::Error {
    match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        io::ErrorKind::NotFound => FileError::NoFolder(folder_of(path).to_owned()).into(),
        io::ErrorKind::PermissionDenied => FileError::NotWritable(path.to_owned()).into(),
        _ => anyhow!("cannot create {}: {error}", path.display()),
    }
}

/// Something has the name already.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{} exists and is not overwritten: choose another name or move it", path.display())]
pub struct NameTaken {
    /// The name.
    pub path: PathBuf,
}

fn exists(path: &Path) -> anyhow::Error {
    NameTaken { path: path.to_owned() }.into()
}

/// Where the kernel shows an open file as a link.
fn own_link(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

/// For `serialize_with`.
///
/// # Errors
/// The serializer's.
pub fn path_as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// The same of one that may be missing.
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
        self.file.write_all_at(bytes, at).map_err(|error| failed(&self.dir, &error))
    }
}

/// A file without a name, which is gone with the process. In `$TMPDIR`, or in `/var/tmp`, which is on a disk where `/tmp` is
/// often memory.
///
/// # Errors
/// That there can be none, and what to do.
pub fn scratch() -> io::Result<Arc<dyn ScratchFile>> {
    let chosen = std::env::var_os("TMPDIR").filter(|dir| !dir.is_empty()).map(PathBuf::from);
    let on_disk = || Some(PathBuf::from("/var/tmp")).filter(|dir| dir.is_dir());
    let dir = chosen.or_else(on_disk).unwrap_or_else(std::env::temp_dir);
    let file = tempfile::tempfile_in(&dir).map_err(|error| failed(&dir, &error))?;
    Ok(Arc::new(Scratch { file, dir }))
}

fn failed(dir: &Path, error: &io::Error) -> io::Error {
    let message = format!(
        "no room for a temporary file in {} with what the take keeps of its source ({error}): set TMPDIR to another folder",
        dir.display()
    );
    io::Error::new(error.kind(), message)
}

/// A file to read whose holes are zeros without a read: a file system fills memory with them, for as long as a file
/// claims to be, in ten times the time.
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
    /// As [`open`].
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        open(path).map(Self::of)
    }

    /// A file that is open, from its beginning.
    #[must_use]
    pub fn of(file: File) -> Self {
        Self { file, at: 0, hole: 0..0, data: 0..0 }
    }

    /// How long it is, holes included.
    ///
    /// # Errors
    /// The system's.
    pub fn len_bytes(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// What there is here: data or a hole, and up to where.
    fn look(&mut self) -> io::Result<()> {
        let at = self.at;
        (self.hole, self.data) = match seek(&self.file, fs::SeekFrom::Data(at)) {
            Ok(data) if data > at => (at..data, 0..0),
            Ok(_) => {
                let end = seek(&self.file, fs::SeekFrom::Hole(at)).unwrap_or(u64::MAX);
                (0..0, at..end)
            }
            // Nothing but a hole up to the end, or the end.
            Err(Errno::NXIO) => (at..self.len_bytes()?, 0..0),
            // A file system that knows of no holes.
            Err(_) => (0..0, at..u64::MAX),
        };
        Ok(())
    }
}

impl Read for SparseFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if !self.hole.contains(&self.at) && !self.data.contains(&self.at) {
            self.look()?;
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn holes_are_zeros_and_data_is_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("holes");
        let mut file = File::create(&path).unwrap();
        file.write_all(b"first").unwrap();
        file.seek(SeekFrom::Start(300_000)).unwrap();
        file.write_all(b"second").unwrap();
        file.set_len(700_000).unwrap();
        let mut wanted = Vec::new();
        File::open(&path).unwrap().read_to_end(&mut wanted).unwrap();
        let mut holes = SparseFile::open(&path).unwrap();
        assert_eq!(holes.len_bytes().unwrap(), 700_000);
        for from in [0, 3, 299_999, 300_003, 699_999, 700_000, 800_000] {
            assert_eq!(holes.seek(SeekFrom::Start(from as u64)).unwrap(), from as u64);
            let mut read = Vec::new();
            holes.read_to_end(&mut read).unwrap();
            assert!(read == wanted.get(from..).unwrap_or_default(), "from byte {from}");
        }
        assert_eq!(holes.seek(SeekFrom::End(-400_000)).unwrap(), 300_000);
        assert_eq!(holes.seek(SeekFrom::Current(2)).unwrap(), 300_002);
        let mut read = [0; 4];
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"cond");
        // What is appended meanwhile is found.
        file.seek(SeekFrom::End(0)).unwrap();
        holes.seek(SeekFrom::End(0)).unwrap();
        assert_eq!(holes.read(&mut read).unwrap(), 0);
        file.write_all(b"more").unwrap();
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"more");
    }
}
