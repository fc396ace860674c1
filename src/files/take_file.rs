//! The file of a live take: it has its final name from the first byte, and is known by what it is, not by that name.

use std::{
    fs::{File, Metadata},
    io::{self, Write},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

/// Which file something is, whatever it is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FileId {
    device: u64,
    inode: u64,
}

impl FileId {
    /// Of what this metadata is of.
    #[must_use]
    pub fn of(file: &Metadata) -> Self {
        Self { device: file.dev(), inode: file.ino() }
    }

    /// Whether the name leads to it.
    #[must_use]
    pub fn is_at(self, path: &Path) -> bool {
        path.symlink_metadata().is_ok_and(|found| Self::of(&found) == self)
    }

    /// Takes the name away from it; a file of somebody else that has the name by now keeps it.
    ///
    /// # Errors
    /// The disk's.
    pub fn remove(self, path: &Path) -> io::Result<()> {
        if self.is_at(path) { std::fs::remove_file(path) } else { Ok(()) }
    }
}

/// A new take's file.
#[derive(Debug)]
pub struct TakeFile {
    pub(super) file: File,
    path: PathBuf,
    id: FileId,
}

impl TakeFile {
    /// Creates it under a name that must be free, and makes the name survive a power cut.
    ///
    /// # Errors
    /// That the name is taken, or why it cannot be created.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let file = super::create_new(path)?;
        let id = FileId::of(&file.metadata()?);
        super::sync_name(path);
        Ok(Self { file, path: path.to_owned(), id })
    }

    /// Which file it is.
    #[must_use]
    pub fn id(&self) -> FileId {
        self.id
    }

    /// What it writes to.
    #[must_use]
    pub fn file(&self) -> &File {
        &self.file
    }

    /// The name that it was created under.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Write for TakeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_file_itself_loses_its_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let take = TakeFile::create(&path).unwrap();
        assert!(TakeFile::create(&path).unwrap_err().to_string().contains("not overwritten"));
        let other = dir.path().join("b.take");
        std::fs::rename(&path, &other).unwrap();
        std::fs::write(&path, b"somebody else's").unwrap();
        assert!(take.id().is_at(&other) && !take.id().is_at(&path));
        take.id().remove(&path).unwrap();
        assert!(path.exists(), "it is another file");
        take.id().remove(&other).unwrap();
        assert!(!other.exists());
        take.id().remove(&other).unwrap();
    }
}
