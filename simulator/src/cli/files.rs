//! Files as the recorder handles them: only regular ones are read, none is overwritten, and a folder appears when it is
//! complete.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use mocapd_drivers::plain_file::{self, NotAFile};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;

/// Opens a file for reading.
pub(super) fn open(path: &Path) -> anyhow::Result<File> {
    plain_file::open(path).map_err(|error| cannot_read(path, error))
}

/// Why a file cannot be read, and what to do.
pub(super) fn cannot_read(path: &Path, error: io::Error) -> anyhow::Error {
    let name = path.display();
    match (NotAFile::why(&error), error.kind()) {
        (Some(what), _) => anyhow!("{name} is {what}"),
        (None, ErrorKind::NotFound) => anyhow!("{name} does not exist"),
        (None, ErrorKind::PermissionDenied) => {
            anyhow!("no permission to read {name}: check it with ls -l")
        }
        (None, _) => anyhow::Error::new(error).context(format!("cannot read {name}")),
    }
}

/// Creates a file that must not exist yet.
pub(super) fn create(path: &Path) -> anyhow::Result<File> {
    let created = OpenOptions::new().write(true).create_new(true).open(path);
    created.map_err(|error| cannot_create(path, error))
}

fn cannot_create(path: &Path, error: io::Error) -> anyhow::Error {
    let name = path.display();
    match error.kind() {
        ErrorKind::AlreadyExists => {
            anyhow!("{name} exists already: choose another name or move it")
        }
        ErrorKind::NotFound => {
            anyhow!("the folder {} does not exist: create it first", folder_of(path).display())
        }
        ErrorKind::PermissionDenied => {
            anyhow!("no permission to create {name}: choose a folder that you may write to")
        }
        _ => anyhow::Error::new(error).context(format!("cannot create {name}")),
    }
}

fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// A folder that gets its name only when it is complete. Dropping it earlier removes it with its content.
#[derive(Debug)]
pub(super) struct NewFolder {
    /// Its temporary name, until it is kept.
    hidden: Option<PathBuf>,
    path: PathBuf,
}

impl NewFolder {
    /// Creates a hidden folder beside `path`, which must not exist.
    pub(super) fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(cannot_create(path, ErrorKind::AlreadyExists.into()));
        }
        let Some(name) = path.file_name() else { bail!("{} is not a folder name", path.display()) };
        let name = format!(".{}.{}.part", name.display(), std::process::id());
        let hidden = path.with_file_name(name);
        fs::create_dir(&hidden).map_err(|error| cannot_create(path, error))?;
        Ok(Self { hidden: Some(hidden), path: path.to_owned() })
    }

    /// Writes a file into it.
    pub(super) fn write(&self, name: &str, content: &[u8]) -> anyhow::Result<()> {
        let Some(hidden) = &self.hidden else { return Ok(()) };
        let written = create(&hidden.join(name)).and_then(|mut file| Ok(file.write_all(content)?));
        written.with_context(|| format!("cannot write {}", self.path.join(name).display()))
    }

    /// Gives the folder its name. A folder that appeared there meanwhile is not overwritten.
    pub(super) fn keep(mut self) -> anyhow::Result<()> {
        let Some(hidden) = &self.hidden else { return Ok(()) };
        let named = match renameat_with(CWD, hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
            // Some network file systems do not support this rename. The plain one refuses folders that are not empty.
            Err(Errno::INVAL | Errno::NOSYS) if self.path.symlink_metadata().is_err() => {
                fs::rename(hidden, &self.path)
            }
            other => other.map_err(io::Error::from),
        };
        named.map_err(|error| cannot_create(&self.path, error))?;
        self.hidden = None;
        Ok(())
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(hidden) = &self.hidden {
            // What cannot be removed has a name that says what it is.
            fs::remove_dir_all(hidden).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_appears_whole_or_not_at_all() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("jumps");
        let dropped = NewFolder::create(&path).unwrap();
        dropped.write("a.c3d", b"half").unwrap();
        drop(dropped);
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);

        let kept = NewFolder::create(&path).unwrap();
        kept.write("a.c3d", b"whole").unwrap();
        assert!(kept.write("a.c3d", b"again").is_err());
        kept.keep().unwrap();
        assert_eq!(fs::read(path.join("a.c3d")).unwrap(), b"whole");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
        let refused = NewFolder::create(&path).unwrap_err().to_string();
        assert!(refused.ends_with("exists already: choose another name or move it"), "{refused}");
    }

    #[test]
    fn a_folder_that_appeared_meanwhile_stays() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("jumps");
        let late = NewFolder::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(late.keep().unwrap_err().to_string().contains("exists already"));
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn messages_say_what_to_do() {
        let place = tempfile::tempdir().unwrap();
        let nowhere = place.path().join("none/a.csv");
        let message = create(&nowhere).unwrap_err().to_string();
        assert!(message.ends_with("none does not exist: create it first"), "{message}");
        let message = open(&nowhere).unwrap_err().to_string();
        assert!(message.ends_with("none/a.csv does not exist"), "{message}");
        let message = open(place.path()).unwrap_err().to_string();
        assert!(message.ends_with(&format!("is {}", NotAFile::Folder)), "{message}");
    }
}
