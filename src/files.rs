//! Files that are never overwritten: live takes under their own name, everything else beside it first.

use std::{
    ffi::OsString,
    fs::{File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use rustix::fs::{CWD, RenameFlags, renameat_with};

/// Opens a file to read.
///
/// # Errors
/// That it is not there, is a folder, or may not be read: each says so.
pub fn open(path: &Path) -> anyhow::Result<File> {
    let file = File::open(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => anyhow!("{} does not exist", path.display()),
        io::ErrorKind::PermissionDenied => {
            anyhow!("no permission to read {}: try ls -l on it", path.display())
        }
        _ => anyhow!("cannot open {}: {error}", path.display()),
    })?;
    if file.metadata().is_ok_and(|meta| meta.is_dir()) {
        bail!("{} is a folder, not a file", path.display());
    }
    Ok(file)
}

/// Creates a file that must not exist yet.
///
/// # Errors
/// That it exists, or why it cannot be created.
pub fn create_new(path: &Path) -> anyhow::Result<File> {
    create_new_for(path, path)
}

/// The same; errors speak of `wanted`, which it is for.
fn create_new_for(path: &Path, wanted: &Path) -> anyhow::Result<File> {
    let name = wanted.display();
    OpenOptions::new().write(true).create_new(true).open(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(wanted),
        io::ErrorKind::NotFound => anyhow!("the folder of {name} does not exist: create it first"),
        io::ErrorKind::PermissionDenied => {
            anyhow!("no permission to create {name}: choose a folder that you may write to")
        }
        _ => anyhow!("cannot create {name}: {error}"),
    })
}

fn exists(path: &Path) -> anyhow::Error {
    anyhow!("{} exists and is not overwritten: choose another name or move it", path.display())
}

/// A file that gets its name only when it is complete. Dropped before, it is removed.
#[derive(Debug)]
pub struct NewFile {
    file: Option<File>,
    hidden: PathBuf,
    path: PathBuf,
}

impl NewFile {
    /// Creates a hidden file beside `path`.
    ///
    /// # Errors
    /// That `path` exists, or that nothing can be created there.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(exists(path));
        }
        let name =
            path.file_name().with_context(|| format!("{} is no file name", path.display()))?;
        let mut hidden_name = OsString::from(".");
        hidden_name.push(name);
        hidden_name.push(format!(".{}.part", std::process::id()));
        let hidden = path.with_file_name(hidden_name);
        let file = create_new_for(&hidden, path)?;
        Ok(Self { file: Some(file), hidden, path: path.to_owned() })
    }

    /// Gives it its name. Nothing that appeared there meanwhile is overwritten.
    ///
    /// # Errors
    /// That a file of that name appeared, or the disk's.
    pub fn keep(mut self) -> anyhow::Result<()> {
        if let Some(file) = self.file.take() {
            file.sync_all().with_context(|| format!("cannot write {}", self.path.display()))?;
        }
        match renameat_with(CWD, &self.hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
            // Some network file systems know no such rename: a hard link refuses to overwrite, too.
            Err(rustix::io::Errno::INVAL | rustix::io::Errno::NOSYS) => {
                std::fs::hard_link(&self.hidden, &self.path).map_err(|_| exists(&self.path))
            }
            Err(rustix::io::Errno::EXIST) => Err(exists(&self.path)),
            other => other.with_context(|| format!("cannot name {}", self.path.display())),
        }
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.file {
            Some(file) => file.write(bytes),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // After `keep` it is gone already, or a second link to the kept file.
        std::fs::remove_file(&self.hidden).ok();
    }
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
