//! Files that are never overwritten: live takes under their own name, everything else beside it first.

mod behind;
mod file_state;
mod folder;
mod mounts;
mod scratch;
mod sparse;
mod take_file;
mod text;

use std::{
    ffi::{OsStr, OsString},
    fs::{File, OpenOptions},
    io::{self, Write},
    os::fd::AsRawFd,
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow};
use mocapd_drivers::plain_file::{self, NotAFile};
use rustix::{
    fs::{AtFlags, CWD, Mode, OFlags, RenameFlags, linkat, openat, renameat_with},
    io::Errno,
};

use self::behind::Behind;
pub use self::{
    file_state::{Displaced, FileState, Settled},
    folder::NewFolder,
    scratch::scratch,
    sparse::SparseFile,
    take_file::{FileId, TakeFile},
    text::{path_as_text, path_as_text_or_null},
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

/// A file that gets its name only when it is complete. Dropped before, it is removed; where the file system
/// knows files without a name, it is gone as well when the process is killed.
#[derive(Debug)]
pub struct NewFile {
    file: Option<File>,
    behind: Behind,
    /// The name that it has until then, if any.
    hidden: Option<PathBuf>,
    path: PathBuf,
}

impl NewFile {
    /// Creates a file without a name in the folder of `path`, or a hidden one.
    ///
    /// # Errors
    /// That `path` exists, or that nothing can be created there.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(exists(path));
        }
        let name =
            path.file_name().with_context(|| format!("{} is no file name", path.display()))?;
        if let Some(file) = without_a_name(path)? {
            return Ok(Self::new(file, None, path));
        }
        let hidden = path.with_file_name(hidden_name(name));
        let created = OpenOptions::new().write(true).create_new(true).open(&hidden);
        let file = created.map_err(|error| cannot_create(path, &error))?;
        Ok(Self::new(file, Some(hidden), path))
    }

    fn new(file: File, hidden: Option<PathBuf>, path: &Path) -> Self {
        Self { file: Some(file), behind: Behind::default(), hidden, path: path.to_owned() }
    }

    /// Gives it its name. Nothing that appeared there meanwhile is overwritten.
    ///
    /// # Errors
    /// That a file of that name appeared, or the disk's.
    pub fn keep(mut self) -> anyhow::Result<()> {
        let Some(file) = self.file.take() else { return Ok(()) };
        let synced = self.behind.finish().and_then(|()| file.sync_all());
        synced.with_context(|| format!("cannot write {}", self.path.display()))?;
        let named = match &self.hidden {
            None => linkat(CWD, own_link(&file), CWD, &self.path, AtFlags::SYMLINK_FOLLOW),
            Some(hidden) => {
                match renameat_with(CWD, hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
                    // Some network file systems know no such rename: a link refuses to overwrite, too.
                    Err(Errno::INVAL | Errno::NOSYS) => {
                        linkat(CWD, hidden, CWD, &self.path, AtFlags::empty())
                    }
                    other => other,
                }
            }
        };
        match named {
            Err(Errno::EXIST) => Err(exists(&self.path)),
            Ok(()) => {
                sync_name(&self.path);
                Ok(())
            }
            other => other.with_context(|| format!("cannot name {}", self.path.display())),
        }
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(file) = &mut self.file else { return Err(io::ErrorKind::BrokenPipe.into()) };
        let n_bytes = file.write(bytes)?;
        self.behind.wrote(file, n_bytes)?;
        Ok(n_bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // After `keep` it is gone already, or a second link to the kept file.
        if let Some(hidden) = &self.hidden {
            std::fs::remove_file(hidden).ok();
        }
    }
}

/// What something is called until it is complete.
fn hidden_name(name: &OsStr) -> OsString {
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.part", std::process::id()));
    hidden
}

/// A file without a name in the folder of `path`; `None` where there are none.
fn without_a_name(path: &Path) -> anyhow::Result<Option<File>> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
    match openat(CWD, folder.unwrap_or(Path::new(".")), flags, Mode::from_raw_mode(0o666)) {
        Ok(file) => {
            let file = File::from(file);
            // Without /proc it could never be named.
            Ok(own_link(&file).exists().then_some(file))
        }
        // Network file systems, and kernels that take the flag for a folder to be opened.
        Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL) => Ok(None),
        Err(error) => Err(cannot_create(path, &error.into())),
    }
}

/// Where the kernel shows an open file as a link.
fn own_link(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut dropped = NewFile::create(&path).unwrap();
        dropped.write_all(b"half").unwrap();
        drop(dropped);
        assert_eq!(dir.path().read_dir().unwrap().count(), 0);

        let mut kept = NewFile::create(&path).unwrap();
        kept.write_all(b"whole").unwrap();
        kept.keep().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn nothing_is_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let late = NewFile::create(&path).unwrap();
        std::fs::write(&path, b"mine").unwrap();
        assert!(NewFile::create(&path).unwrap_err().to_string().contains("not overwritten"));
        assert!(late.keep().unwrap_err().to_string().contains("not overwritten"));
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    }
}
