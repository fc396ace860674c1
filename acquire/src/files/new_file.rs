//! Files that get their names only when they are complete, and the hidden names that outputs have until then, so that a
//! program that is interrupted can remove them.

use std::{
    collections::BTreeMap,
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions},
    io::{self, BufRead, BufReader, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

use anyhow::{Context, bail};
use crossbeam_channel::{Sender, TrySendError, bounded};
use mocapd_drivers::plain_file;
use rustix::{
    fs::{Advice, AtFlags, CWD, Mode, OFlags, RenameFlags, fadvise, linkat, openat, renameat_with},
    io::Errno,
};

use super::{cannot_create, folder_of, name_taken, proc_link, sync_name};
use crate::threads;

/// A file that gets its name only when it is complete. Dropping it earlier removes it; on a file system with
/// unnamed files it also disappears when the process is killed.
#[derive(Debug)]
pub struct NewFile {
    file: Option<File>,
    sync: BackgroundSync,
    /// Its temporary name, if it needs one.
    hidden: Option<HiddenPath>,
    path: PathBuf,
}

/// Whether a new file got its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// The file has its name.
    New,
    /// A file of that name with the same content existed, and stays.
    Unchanged,
}

impl NewFile {
    /// Creates an unnamed file in the folder of `path`, or a hidden one.
    ///
    /// # Errors
    /// When `path` exists, or nothing can be created there.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(name_taken(path));
        }
        Self::create_or_compare(path)
    }

    /// Creates a file as [`create`](Self::create) does, where `path` may exist: it is compared with the new content at
    /// the end, by [`keep_or_compare`](Self::keep_or_compare).
    ///
    /// # Errors
    /// When nothing can be created there.
    pub fn create_or_compare(path: &Path) -> anyhow::Result<Self> {
        let Some(name) = path.file_name() else { bail!("{} is not a file name", path.display()) };
        if let Some(file) = unnamed_file(path)? {
            return Ok(Self::new(file, None, path));
        }
        let hidden = path.with_file_name(hidden_name(name));
        let create = |hidden: &Path| OpenOptions::new().write(true).create_new(true).open(hidden);
        let created = HiddenPath::create(hidden, Kind::File, create);
        let (file, hidden) = created.map_err(|error| cannot_create(path, &error))?;
        Ok(Self::new(file, Some(hidden), path))
    }

    fn new(file: File, hidden: Option<HiddenPath>, path: &Path) -> Self {
        Self { file: Some(file), sync: BackgroundSync::default(), hidden, path: path.to_owned() }
    }

    /// Syncs what was written, so that giving the file its name takes no time.
    ///
    /// # Errors
    /// When the disk fails.
    pub fn sync(&mut self) -> io::Result<()> {
        self.sync.finish()?;
        self.file.as_ref().map_or(Ok(()), File::sync_all)
    }

    /// Gives the file its name. A file that appeared there meanwhile is not overwritten.
    ///
    /// # Errors
    /// When a file of that name appeared, or the disk fails.
    pub fn keep(self) -> anyhow::Result<()> {
        let path = self.path.clone();
        match self.keep_or_compare()? {
            Kept::New => Ok(()),
            Kept::Unchanged => Err(name_taken(&path)),
        }
    }

    /// Gives the file its name, unless a file of that name has the same content. Nothing is overwritten.
    ///
    /// # Errors
    /// When a file of that name has another content, or the disk fails.
    pub fn keep_or_compare(mut self) -> anyhow::Result<Kept> {
        let Some(file) = self.file.take() else { return Ok(Kept::New) };
        let synced = self.sync.finish().and_then(|()| file.sync_all());
        synced.with_context(|| format!("cannot write {}", self.path.display()))?;
        let named = match self.hidden.as_ref().map(HiddenPath::path) {
            None => linkat(CWD, proc_link(&file), CWD, &self.path, AtFlags::SYMLINK_FOLLOW),
            Some(hidden) => {
                match renameat_with(CWD, hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
                    // Some network file systems do not support this rename; a link refuses to overwrite as well.
                    Err(Errno::INVAL | Errno::NOSYS) => {
                        linkat(CWD, hidden, CWD, &self.path, AtFlags::empty())
                    }
                    other => other,
                }
            }
        };
        match named {
            Err(Errno::EXIST) if has_same_content(&self.path, &file) => Ok(Kept::Unchanged),
            Err(Errno::EXIST) => Err(name_taken(&self.path)),
            Ok(()) => {
                sync_name(&self.path);
                Ok(Kept::New)
            }
            other => {
                other.with_context(|| format!("cannot name {}", self.path.display()))?;
                Ok(Kept::New)
            }
        }
    }
}

/// Whether the file at `path` has the content of `new`. `new` may be open for writing only.
fn has_same_content(path: &Path, new: &File) -> bool {
    let read = || -> io::Result<bool> {
        let there = plain_file::open(path)?;
        if there.metadata()?.len() != new.metadata()?.len() {
            return Ok(false);
        }
        let mut there = BufReader::with_capacity(COMPARED_BYTES, there);
        let mut new = BufReader::with_capacity(COMPARED_BYTES, File::open(proc_link(new))?);
        loop {
            let (old, found) = (there.fill_buf()?, new.fill_buf()?);
            let n = old.len().min(found.len());
            if old[..n] != found[..n] {
                return Ok(false);
            }
            if n == 0 {
                return Ok(old.len() == found.len());
            }
            there.consume(n);
            new.consume(n);
        }
    };
    read().unwrap_or(false)
}

/// Bytes of one read of a comparison: large enough to make the cost of a call negligible.
const COMPARED_BYTES: usize = 1 << 18;

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(file) = &mut self.file else { return Err(io::ErrorKind::BrokenPipe.into()) };
        let n_bytes = file.write(bytes)?;
        self.sync.count(file, n_bytes)?;
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

/// The temporary name of an incomplete file.
fn hidden_name(name: &OsStr) -> OsString {
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.part", std::process::id()));
    hidden
}

/// Creates an unnamed file in the folder of `path`; `None` where the file system has none.
pub(super) fn unnamed_file(path: &Path) -> anyhow::Result<Option<File>> {
    let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
    match openat(CWD, folder_of(path), flags, Mode::from_raw_mode(0o666)) {
        Ok(file) => {
            let file = File::from(file);
            // Without /proc it could never be given a name.
            Ok(proc_link(&file).exists().then_some(file))
        }
        // Network file systems, and kernels that ignore the flag and open the folder.
        Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL) => Ok(None),
        Err(error) => Err(cannot_create(path, &error.into())),
    }
}

/// Bytes written between two syncs: half a second of a slow disk, so that the wait at the end is short, and enough to
/// make the cost of a call negligible.
const SYNC_STEP_BYTES: u64 = 32 << 20;

/// Syncs a file while it is being written, on a thread that starts with the first sync.
#[derive(Debug, Default)]
struct BackgroundSync {
    unsynced_bytes: u64,
    syncer: Option<SyncThread>,
}

#[derive(Debug)]
struct SyncThread {
    wake: Sender<()>,
    thread: JoinHandle<io::Result<()>>,
}

impl BackgroundSync {
    /// Counts bytes written to `file` and starts a sync when one is due. Never waits for the disk.
    ///
    /// # Errors
    /// The error of an earlier sync, which the disk reports once only.
    fn count(&mut self, file: &File, n_bytes: usize) -> io::Result<()> {
        self.unsynced_bytes += n_bytes as u64;
        if self.unsynced_bytes < SYNC_STEP_BYTES {
            return Ok(());
        }
        self.unsynced_bytes = 0;
        if self.syncer.is_none() {
            self.syncer = start(file);
        }
        let has_ended = match &self.syncer {
            // Without a thread, everything is synced at the end.
            None => false,
            // Full: a sync has yet to start, and will include these bytes.
            Some(syncer) => matches!(syncer.wake.try_send(()), Err(TrySendError::Disconnected(()))),
        };
        if has_ended { self.finish() } else { Ok(()) }
    }

    /// Waits for the running sync.
    ///
    /// # Errors
    /// The error of any sync.
    fn finish(&mut self) -> io::Result<()> {
        let Some(SyncThread { wake, thread }) = self.syncer.take() else { return Ok(()) };
        drop(wake);
        threads::join(thread).map_err(io::Error::other)?
    }
}

/// Starts the thread; `None` if the system provides no thread or no second handle of the file.
fn start(file: &File) -> Option<SyncThread> {
    let file = file.try_clone().ok()?;
    // One queued wake-up is enough.
    let (wake, wakes) = bounded(1);
    let sync = move || wakes.iter().try_for_each(|()| sync(&file));
    let thread = threads::spawn("mocapd-sync", sync).ok()?;
    Some(SyncThread { wake, thread })
}

/// Syncs the data and drops it from the page cache: a file of gigabytes would take that memory from other programs, and
/// recently freed memory is written fastest.
fn sync(file: &File) -> io::Result<()> {
    file.sync_data()?;
    // The system may ignore the advice.
    fadvise(file, 0, None, Advice::DontNeed).ok();
    Ok(())
}

/// How to remove a hidden path.
#[derive(Debug, Clone)]
enum Kind {
    File,
    /// The staging folder of this data set, and what removes it and what was added from it.
    Staging {
        dataset: PathBuf,
        discard: fn(&Path, &Path),
    },
}

impl Kind {
    fn remove(&self, path: &Path) {
        match self {
            Self::File => drop(fs::remove_file(path)),
            Self::Staging { dataset, discard } => discard(path, dataset),
        }
    }
}

/// The hidden paths of this process.
static HIDDEN: Mutex<BTreeMap<PathBuf, Kind>> = Mutex::new(BTreeMap::new());

fn hidden() -> MutexGuard<'static, BTreeMap<PathBuf, Kind>> {
    HIDDEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A hidden file or staging folder, which is removed when this is dropped. Once a file has its final name, nothing is at
/// the hidden path, or a second link to the kept file.
#[derive(Debug)]
pub(super) struct HiddenPath(PathBuf, Kind);

impl HiddenPath {
    /// Creates a staging folder.
    pub(super) fn staging(
        path: PathBuf,
        dataset: PathBuf,
        discard: fn(&Path, &Path),
    ) -> io::Result<Self> {
        let kind = Kind::Staging { dataset, discard };
        Ok(Self::create(path, kind, |path| fs::create_dir(path))?.1)
    }

    /// Creates what is at a path. An interrupt comes before it or after it, and not between the creation and the list.
    fn create<T>(
        path: PathBuf,
        kind: Kind,
        create: impl FnOnce(&Path) -> io::Result<T>,
    ) -> io::Result<(T, Self)> {
        let mut paths = hidden();
        // What exists there is another program's, and not listed.
        let created = create(&path)?;
        paths.insert(path.clone(), kind.clone());
        Ok((created, Self(path, kind)))
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// Renames the folder; from then on only the folder itself is removed, by `remove`, and what was added from it stays.
    /// Waits for ever if the program is being interrupted.
    pub(super) fn commit(&mut self, to: PathBuf, remove: fn(&Path, &Path)) {
        let mut paths = hidden();
        paths.remove(&self.0);
        if fs::rename(&self.0, &to).is_ok() {
            self.0 = to;
        }
        if let Kind::Staging { discard, .. } = &mut self.1 {
            *discard = remove;
        }
        paths.insert(self.0.clone(), self.1.clone());
    }
}

impl Drop for HiddenPath {
    fn drop(&mut self) {
        self.1.remove(&self.0);
        hidden().remove(&self.0);
    }
}

/// Removes every incomplete output, for a process that is about to end. As long as the result is held no other can be
/// created: the thread that tries waits.
#[must_use]
pub fn remove_incomplete_outputs() -> impl Sized {
    let paths = hidden();
    for (path, kind) in paths.iter() {
        kind.remove(path);
    }
    paths
}

#[cfg(test)]
mod tests {
    use std::fs;

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
    fn a_file_with_the_same_content_stays_and_another_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let keep = |content: &[u8]| {
            let mut file = NewFile::create_or_compare(&path).unwrap();
            file.write_all(content).unwrap();
            file.keep_or_compare()
        };
        let long = vec![7; 3 * COMPARED_BYTES];
        assert_eq!(keep(&long).unwrap(), Kept::New);
        assert_eq!(keep(&long).unwrap(), Kept::Unchanged);
        let mut other = long.clone();
        *other.last_mut().unwrap() = 8;
        for content in [&other[..], &long[1..], b""] {
            assert!(keep(content).unwrap_err().is::<NameTaken>());
        }
        assert_eq!(fs::read(&path).unwrap(), long);
        assert_eq!(dir.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn the_background_sync_starts_with_the_first_step_and_ends_on_finish() {
        let file = tempfile::tempfile().unwrap();
        let mut sync = BackgroundSync::default();
        sync.count(&file, SYNC_STEP_BYTES as usize - 1).unwrap();
        assert!(sync.syncer.is_none());
        sync.count(&file, 1).unwrap();
        assert!(sync.syncer.is_some());
        sync.count(&file, SYNC_STEP_BYTES as usize).unwrap();
        sync.finish().unwrap();
        assert!(sync.syncer.is_none());
    }

    #[test]
    fn an_error_of_the_disk_is_reported_once_and_not_lost() {
        // A pipe cannot be synced: the kernel returns EINVAL.
        let (_reader, writer) = io::pipe().unwrap();
        let file = File::from(std::os::fd::OwnedFd::from(writer));
        let mut sync = BackgroundSync::default();
        sync.count(&file, SYNC_STEP_BYTES as usize).unwrap();
        assert_eq!(sync.finish().unwrap_err().kind(), io::ErrorKind::InvalidInput);
        sync.finish().unwrap();
    }
}
