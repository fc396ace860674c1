//! Files that are never overwritten: live takes under their own name, everything else beside it first.

mod file_state;
mod new_file;
mod sparse;
mod take_file;

use std::{
    fs::{File, OpenOptions},
    io,
    os::{fd::AsRawFd, unix::fs::FileExt},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::anyhow;
use mocapd_drivers::plain_file::{self, NotAFile};
use mocapd_take::content::ScratchFile;
use serde::{Serialize, Serializer};

pub use self::{
    file_state::{Displaced, FileState, Settled},
    new_file::{NewFile, NewFolder},
    sparse::SparseFile,
    take_file::{FileId, TakeFile, TakeOutput},
};

/// Opens a file to read.
///
/// # Errors
/// That it is not there, is a folder, a pipe or a device, or may not be read: each says so.
pub fn open(path: &Path) -> anyhow::Result<File> {
    plain_file::open(path).map_err(|error| match (NotAFile::why(&error), error.kind()) {
        (Some(what), _) => anyhow!("{} is {what}", path.display()),
        (None, io::ErrorKind::NotFound) => anyhow!("{} does not exist", path.display()),
        (None, io::ErrorKind::PermissionDenied) => {
            anyhow!("no permission to read {}: try ls -l on it", path.display())
        }
        (None, _) => anyhow!("cannot open {}: {error}", path.display()),
    })
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
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        folder.sync_all().ok();
    }
}

fn cannot_create(path: &Path, error: &io::Error) -> anyhow::Error {
    match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        io::ErrorKind::NotFound => {
            anyhow!("the folder of {} does not exist: create it first", path.display())
        }
        io::ErrorKind::PermissionDenied => {
            anyhow!(
                "no permission to create {}: choose a folder that you may write to",
                path.display()
            )
        }
        _ => anyhow!("cannot create {}: {error}", path.display()),
    }
}

fn exists(path: &Path) -> anyhow::Error {
    anyhow!("{} exists and is not overwritten: choose another name or move it", path.display())
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
