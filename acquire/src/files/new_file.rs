//! Files and folders that appear whole or not at all: each gets its name when it is complete.

use std::{
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    thread::JoinHandle,
};

use anyhow::{Context, bail};
use crossbeam_channel::{Sender, TrySendError, bounded};
use mocapd_take::interchange::bids::Folder;
use rustix::{
    fs::{Advice, AtFlags, CWD, Mode, OFlags, RenameFlags, fadvise, linkat, openat, renameat_with},
    io::Errno,
};

use super::{cannot_create, exists, folder_of, own_link, sync_name};
use crate::threads;

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

impl Seek for NewFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let Some(file) = &mut self.file else { return Err(io::ErrorKind::BrokenPipe.into()) };
        file.seek(to)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // After `keep` it is gone already, or a second link to the kept file.
        if let Some(hidden) = &self.hidden {
            fs::remove_file(hidden).ok();
        }
    }
}

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

/// What something is called until it is complete.
fn hidden_name(name: &OsStr) -> OsString {
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.part", std::process::id()));
    hidden
}

/// A file without a name in the folder of `path`; `None` where there are none.
fn without_a_name(path: &Path) -> anyhow::Result<Option<File>> {
    let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
    match openat(CWD, folder_of(path), flags, Mode::from_raw_mode(0o666)) {
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

/// How much is written before the disk is told to begin, and between two such calls: half a second of a slow disk, so
/// that the wait at the end is short, and enough that a call costs nothing beside it.
const STEP_BYTES: u64 = 32 << 20;

/// Syncs a file behind its writer, on a thread of its own, which begins with the first step.
#[derive(Debug, Default)]
struct Behind {
    since_bytes: u64,
    syncer: Option<Syncer>,
}

#[derive(Debug)]
struct Syncer {
    wake: Sender<()>,
    thread: JoinHandle<io::Result<()>>,
}

impl Behind {
    /// So many bytes more were written to `file`. Never waits for the disk.
    ///
    /// # Errors
    /// What the disk said to an earlier sync: it says that once only.
    fn wrote(&mut self, file: &File, n_bytes: usize) -> io::Result<()> {
        self.since_bytes += n_bytes as u64;
        if self.since_bytes < STEP_BYTES {
            return Ok(());
        }
        self.since_bytes = 0;
        if self.syncer.is_none() {
            self.syncer = start(file);
        }
        let gone = match &self.syncer {
            // Where there is no thread to be had, everything is synced at the end.
            None => false,
            // Full: a sync is still to begin, and will take these bytes as well.
            Some(syncer) => matches!(syncer.wake.try_send(()), Err(TrySendError::Disconnected(()))),
        };
        if gone { self.finish() } else { Ok(()) }
    }

    /// Waits for the sync that is under way.
    ///
    /// # Errors
    /// What the disk said to any sync.
    fn finish(&mut self) -> io::Result<()> {
        let Some(Syncer { wake, thread }) = self.syncer.take() else { return Ok(()) };
        drop(wake);
        threads::join(thread).map_err(io::Error::other)?
    }
}

/// `None` where the system gives no thread, or no second handle.
fn start(file: &File) -> Option<Syncer> {
    let file = file.try_clone().ok()?;
    // One waiting wake is all that can be of use.
    let (wake, woken) = bounded(1);
    let sync = move || woken.iter().try_for_each(|()| sync(&file));
    let thread = threads::spawn("mocapd-sync", sync).ok()?;
    Some(Syncer { wake, thread })
}

/// Puts on the disk what was written, and gives the memory back that held it: a file of gigabytes would take all there
/// is from the others on the machine, and memory that was just free is written the fastest.
fn sync(file: &File) -> io::Result<()> {
    file.sync_data()?;
    // Whether the system takes advice is its own affair.
    fadvise(file, 0, None, Advice::DontNeed).ok();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::NameTaken;

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut dropped = NewFile::create(&path).unwrap();
        dropped.write_all(b"half").unwrap();
        drop(dropped);
        assert_eq!(dir.path().read_dir().unwrap().count(), 0);

        let mut kept = NewFile::create(&path).unwrap();
        kept.write_all(b"whole").unwrap();
        kept.keep().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn nothing_is_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let late = NewFile::create(&path).unwrap();
        fs::write(&path, b"mine").unwrap();
        assert!(NewFile::create(&path).unwrap_err().is::<NameTaken>());
        assert!(late.keep().unwrap_err().is::<NameTaken>());
        assert_eq!(fs::read(&path).unwrap(), b"mine");
    }

    #[test]
    fn a_folder_appears_whole_or_not_at_all() {
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
        assert!(NewFolder::create(&path).unwrap_err().is::<NameTaken>());
    }

    #[test]
    fn what_appeared_meanwhile_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("set");
        let late = NewFolder::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(late.keep().unwrap_err().is::<NameTaken>());
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn begins_with_the_first_step_and_ends_when_told() {
        let file = tempfile::tempfile().unwrap();
        let mut behind = Behind::default();
        behind.wrote(&file, STEP_BYTES as usize - 1).unwrap();
        assert!(behind.syncer.is_none());
        behind.wrote(&file, 1).unwrap();
        assert!(behind.syncer.is_some());
        behind.wrote(&file, STEP_BYTES as usize).unwrap();
        behind.finish().unwrap();
        assert!(behind.syncer.is_none());
    }

    #[test]
    fn an_error_of_the_disk_is_told_once_and_not_lost() {
        // A pipe cannot be synced: the kernel says EINVAL.
        let (_reader, writer) = io::pipe().unwrap();
        let file = File::from(std::os::fd::OwnedFd::from(writer));
        let mut behind = Behind::default();
        behind.wrote(&file, STEP_BYTES as usize).unwrap();
        assert_eq!(behind.finish().unwrap_err().kind(), io::ErrorKind::InvalidInput);
        behind.finish().unwrap();
    }
}
