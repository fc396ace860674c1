//! Folders of files that appear whole or not at all.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd_take::interchange::bids::Folder;
use rustix::{
    fs::{CWD, RenameFlags, renameat_with},
    io::Errno,
};

use super::{cannot_create, exists, hidden_name, sync_name};

/// A folder that gets its name only when it is complete. Dropped before, it is removed with what is in it.
#[derive(Debug)]
pub struct NewFolder {
    /// The name that it has until then.
    hidden: Option<PathBuf>,
    path: PathBuf,
    files: Vec<PathBuf>,
}

impl NewFolder {
    /// Creates a hidden folder beside `path`.
    ///
    /// # Errors
    /// That `path` exists, or that nothing can be created there.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(exists(path));
        }
        let Some(name) = path.file_name() else { bail!("{} is no folder's name", path.display()) };
        let hidden = path.with_file_name(hidden_name(name));
        fs::create_dir(&hidden).map_err(|error| cannot_create(path, &error))?;
        Ok(Self { hidden: Some(hidden), path: path.to_owned(), files: Vec::new() })
    }

    /// Gives it its name, when all that is in it is on the disk. Nothing that appeared there meanwhile is overwritten.
    ///
    /// # Errors
    /// That something of that name appeared, or the disk's.
    pub fn keep(mut self) -> anyhow::Result<()> {
        let writing = || format!("cannot write {}", self.path.display());
        let Some(hidden) = &self.hidden else { return Ok(()) };
        for file in &self.files {
            File::open(file).and_then(|file| file.sync_all()).with_context(writing)?;
            sync_name(file);
        }
        match renameat_with(CWD, hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
            Ok(()) => {}
            Err(Errno::EXIST) => return Err(exists(&self.path)),
            // Some network file systems know no such rename. The plain one refuses folders that are not empty.
            Err(Errno::INVAL | Errno::NOSYS) if self.path.symlink_metadata().is_err() => {
                fs::rename(hidden, &self.path).with_context(writing)?;
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot name {}", self.path.display()));
            }
        }
        sync_name(&self.path);
        self.hidden = None;
        Ok(())
    }
}

impl Folder for NewFolder {
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>> {
        let hidden = self.hidden.as_ref().ok_or(io::ErrorKind::NotFound)?;
        let path = hidden.join(path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let file = OpenOptions::new().write(true).create_new(true).open(&path)?;
        self.files.push(path);
        Ok(Box::new(BufWriter::new(file)))
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(hidden) = &self.hidden {
            fs::remove_dir_all(hidden).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("set");
        let mut dropped = NewFolder::create(&path).unwrap();
        dropped.file("a/b").unwrap().write_all(b"half").unwrap();
        drop(dropped);
        assert_eq!(dir.path().read_dir().unwrap().count(), 0);

        let mut kept = NewFolder::create(&path).unwrap();
        kept.file("a/b").unwrap().write_all(b"whole").unwrap();
        assert!(kept.file("a/b").is_err());
        kept.keep().unwrap();
        assert_eq!(fs::read(path.join("a/b")).unwrap(), b"whole");
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
        assert!(NewFolder::create(&path).unwrap_err().to_string().contains("not overwritten"));
    }

    #[test]
    fn what_appeared_meanwhile_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("set");
        let late = NewFolder::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(late.keep().unwrap_err().to_string().contains("not overwritten"));
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
    }
}
