//! The file of a live take: it has its final name from the start, and is identified by its inode, not by that name. Also
//! what other programs do to it while it is written.

use std::{
    any::Any,
    fmt,
    fs::{File, Metadata},
    io::{self, Write},
    os::{fd::AsRawFd, unix::fs::MetadataExt},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::Context;
use rustix::{
    fs::{FallocateFlags, FlockOperation, fallocate, flock, fstatvfs},
    io::Errno,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{NewFile, proc_link};

/// Identifies a file, whatever its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FileId {
    device: u64,
    inode: u64,
}

impl FileId {
    /// The identity of the file with this metadata.
    #[must_use]
    pub fn of(file: &Metadata) -> Self {
        Self { device: file.dev(), inode: file.ino() }
    }

    /// Whether `path` leads to the file.
    ///
    /// # Errors
    /// When that cannot be determined. A path that does not exist is not an error.
    pub fn is_at(self, path: &Path) -> io::Result<bool> {
        match path.symlink_metadata() {
            Ok(found) => Ok(Self::of(&found) == self),
            Err(error) => match error.kind() {
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Ok(false),
                _ => Err(error),
            },
        }
    }

    /// Removes `path` if it leads to the file; another file that has this name by now stays.
    ///
    /// # Errors
    /// The disk's.
    pub fn remove(self, path: &Path) -> io::Result<()> {
        if self.is_at(path)? { std::fs::remove_file(path) } else { Ok(()) }
    }
}

/// Whether a recorder is writing the file, shown by its lock.
#[must_use]
pub fn is_being_written(file: &File) -> bool {
    flock(file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK)
}

/// The output of a take.
pub trait TakeOutput: Any + Write + Send {
    /// Makes everything written so far survive a power cut.
    ///
    /// # Errors
    /// The device's.
    fn sync(&mut self) -> io::Result<()>;

    /// Allocates `bytes` from an offset on, so that they can be written even if other programs fill the disk.
    ///
    /// # Errors
    /// `StorageFull` or `QuotaExceeded` when there is no space; `Unsupported` when space cannot be allocated ahead.
    fn allocate(&mut self, _from: u64, _bytes: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Releases unused allocated space; the output has `bytes` bytes.
    ///
    /// # Errors
    /// The device's.
    fn release(&mut self, _bytes: u64) -> io::Result<()> {
        Ok(())
    }

    /// Free bytes on the disk, without those reserved for root; `None` if the system does not say.
    fn free_bytes(&self) -> Option<u64> {
        None
    }

    /// The state of the output, at most half a second old.
    fn poll_state(&mut self) -> FileState {
        FileState::InPlace
    }

    /// The state of the output now.
    fn check_state(&mut self) -> FileState {
        FileState::InPlace
    }

    /// Details, if the output is not in its place.
    fn displaced(&self) -> Option<DisplacedFile> {
        None
    }

    /// Where the output is, after the take has ended. Saves a copy of a removed file.
    fn settle(&mut self) -> SettledFile {
        SettledFile::default()
    }
}

impl fmt::Debug for dyn TakeOutput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TakeOutput")
    }
}

/// Time between two checks of the file: short enough to notice changes within a second.
const POLL_INTERVAL: Duration = Duration::from_millis(400);

/// The number at which the search for a free name for the copy of a removed take ends.
const COPIES_MAX: u32 = 100;

/// The file of a take that is being recorded.
#[derive(Debug)]
pub struct TakeFile {
    file: File,
    path: PathBuf,
    id: FileId,
    /// Its path according to the kernel when it was created.
    link: Option<PathBuf>,
    written: u64,
    last_check: Option<Instant>,
    state: FileState,
}

impl TakeFile {
    /// Creates the file under a name that must be free, and makes the name survive a power cut.
    ///
    /// # Errors
    /// When the name is taken, or the file cannot be created.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let file = super::create_new(path)?;
        let id = FileId::of(&file.metadata()?);
        // Some file systems have no locks; without one, other services take the file for one that was cut off.
        flock(&file, FlockOperation::NonBlockingLockExclusive).ok();
        super::sync_name(path);
        let (path, link) = (path.to_owned(), proc_link(&file).read_link().ok());
        Ok(Self { file, path, id, link, written: 0, last_check: None, state: FileState::InPlace })
    }

    /// The file's identity.
    #[must_use]
    pub fn id(&self) -> FileId {
        self.id
    }

    /// The open file.
    #[must_use]
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Determines the state; `None` when that is impossible.
    fn detect_state(&self) -> Option<FileState> {
        let found = self.file.metadata().ok()?;
        if found.len() < self.written {
            return Some(FileState::Truncated);
        }
        if found.nlink() == 0 {
            return Some(FileState::Removed);
        }
        if self.id.is_at(&self.path).ok()? {
            return Some(FileState::InPlace);
        }
        let link = proc_link(&self.file).read_link().ok();
        // Not a symbolic link: one that now leads elsewhere says nothing about the file.
        if let Some(link) = &link
            && self.id.is_at(link).ok()?
        {
            return Some(FileState::Renamed);
        }
        // The path according to the kernel is unchanged and leads elsewhere: something is mounted over it.
        let is_covered = link.is_some() && link == self.link;
        if is_covered || !is_mounted(&self.file) {
            return Some(FileState::Unmounted);
        }
        Some(FileState::Renamed)
    }

    /// The file's present path, if it has one.
    fn current_path(&self) -> Option<PathBuf> {
        // When that cannot be determined, the file is where it was at the last check.
        let was_there = self.state == FileState::InPlace;
        if self.id.is_at(&self.path).unwrap_or(was_there) {
            return Some(self.path.clone());
        }
        let link = proc_link(&self.file).read_link().ok();
        link.filter(|path| self.id.is_at(path).unwrap_or(false))
    }

    /// Saves a copy beside the original path, under a free name. The kernel cannot give a name to a file that has lost
    /// its last one.
    fn save_copy(&self) -> anyhow::Result<PathBuf> {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = |count: u32| match count {
            1 => format!("{stem}.saved.take"),
            _ => format!("{stem}.saved-{count}.take"),
        };
        let mut names = (1..COPIES_MAX).map(|count| self.path.with_file_name(name(count)));
        let free = names.find(|path| path.symlink_metadata().is_err());
        let path = free.context("every name for a copy is taken")?;
        let mut file = File::open(proc_link(&self.file)).context("cannot reopen it")?;
        let mut copy = NewFile::create(&path)?;
        io::copy(&mut file, &mut copy)
            .with_context(|| format!("cannot write {}", path.display()))?;
        copy.keep()?;
        Ok(path)
    }
}

impl Write for TakeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // A write beyond the end of a truncated file would leave a hole, and the file would have its full length again.
        if self.file.metadata()?.len() < self.written {
            self.state = FileState::Truncated;
            return Err(io::Error::other("another program cut the file short"));
        }
        let n_bytes = self.file.write(bytes)?;
        self.written += n_bytes as u64;
        Ok(n_bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl TakeOutput for TakeFile {
    fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }

    fn allocate(&mut self, from: u64, bytes: u64) -> io::Result<()> {
        Ok(fallocate(&self.file, FallocateFlags::KEEP_SIZE, from, bytes)?)
    }

    fn free_bytes(&self) -> Option<u64> {
        let disk = fstatvfs(&self.file).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    fn release(&mut self, bytes: u64) -> io::Result<()> {
        let found = self.file.metadata()?.len();
        let left = bytes.min(found);
        self.file.set_len(left)?;
        // A release truncates the file as well: do not take that for the work of another program.
        if found >= self.written {
            self.written = self.written.min(left);
        }
        Ok(())
    }

    fn poll_state(&mut self) -> FileState {
        if self.last_check.is_none_or(|last| last.elapsed() >= POLL_INTERVAL) {
            self.check_state();
        }
        self.state
    }

    fn check_state(&mut self) -> FileState {
        self.last_check = Some(Instant::now());
        // What was truncated does not come back, and later data would follow a hole.
        if self.state != FileState::Truncated {
            self.state = self.detect_state().unwrap_or(self.state);
        }
        self.state
    }

    fn displaced(&self) -> Option<DisplacedFile> {
        if self.state == FileState::InPlace {
            return None;
        }
        let found = self.file.metadata().map_or(0, |found| found.len());
        Some(DisplacedFile {
            state: self.state,
            created_as: self.path.clone(),
            now_at: self.current_path(),
            open_at: format!("/proc/{}/fd/{}", std::process::id(), self.file.as_raw_fd()).into(),
            bytes: (found, self.written),
        })
    }

    fn settle(&mut self) -> SettledFile {
        let state = self.check_state();
        let (displaced, path) = (self.displaced(), self.current_path());
        let mut settled = SettledFile { state, path, displaced, problem: None };
        if state == FileState::Removed {
            match self.save_copy() {
                Ok(path) => settled.path = Some(path),
                Err(error) => settled.problem = Some(format!("{error:#}")),
            }
        }
        settled
    }
}

impl TakeOutput for Vec<u8> {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for io::Sink {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What happened to the file of a take while it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FileState {
    /// The file has its name and the length that was written.
    #[default]
    InPlace,
    /// The file has no name any more; its folder may be gone too.
    Removed,
    /// The file, or a folder above it, was renamed.
    Renamed,
    /// Another program truncated it.
    Truncated,
    /// Its file system was unmounted, or another one was mounted over it.
    Unmounted,
}

impl FileState {
    /// All states, indexed by their codes.
    const ALL: [Self; 5] =
        [Self::InPlace, Self::Removed, Self::Renamed, Self::Truncated, Self::Unmounted];

    /// Whether a take in this file has to end: in the other states writing continues.
    #[must_use]
    pub fn ends_take(self) -> bool {
        matches!(self, Self::Truncated | Self::Unmounted)
    }

    pub(crate) fn code(self) -> u8 {
        self as u8
    }

    pub(crate) fn from_code(code: u8) -> Self {
        Self::ALL.get(usize::from(code)).copied().unwrap_or_default()
    }
}

/// Details of a file that is not where it was created, or not as long as what was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DisplacedFile {
    /// What happened.
    pub state: FileState,
    /// The path at which it was created.
    pub created_as: PathBuf,
    /// Its present path, if known.
    pub now_at: Option<PathBuf>,
    /// Path at which users with permission can open it while this process has it open.
    pub open_at: PathBuf,
    /// Bytes in the file, and bytes written.
    pub bytes: (u64, u64),
}

impl DisplacedFile {
    /// What happened and what to do, for a take that is still being recorded.
    #[must_use]
    pub fn message(&self) -> String {
        let Self { created_as, open_at, bytes: (found, written), .. } = self;
        let (take, open_at) = (created_as.display(), open_at.display());
        match self.state {
            FileState::InPlace => format!("the take {take} is back at its path"),
            FileState::Removed => format!(
                "the take {take} was removed during the recording, which continues in {open_at}; a copy is saved at the end, if its folder still exists. To save one now: cp {open_at} NEW.take"
            ),
            FileState::Renamed => format!(
                "the take {take} was renamed during the recording, which continues in {}, open as {open_at}. To copy it before the end: cp {open_at} NEW.take",
                self.now_at
                    .as_ref()
                    .map_or("a file whose name is unknown".into(), |p| p.to_string_lossy())
            ),
            FileState::Truncated => format!(
                "the take {take} was cut short by another program, from {written} to {found} bytes: it ends here; `mocapd recover {take} -o NEW.take` recovers what is left, if its header is intact"
            ),
            FileState::Unmounted => format!(
                "the file system of the take {take} was unmounted, or another one was mounted over it: the take ends here, and is complete on that file system"
            ),
        }
    }
}

/// The file of a take that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SettledFile {
    /// What happened to it.
    pub state: FileState,
    /// Where it is now, or where its copy is if it was removed. `None` if it has no name.
    pub path: Option<PathBuf>,
    /// Details, if it is not in its place.
    pub displaced: Option<DisplacedFile>,
    /// Why a removed file could not be copied.
    pub problem: Option<String>,
}

impl SettledFile {
    /// What happened; `None` when nothing did.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        let displaced = self.displaced.as_ref()?;
        let take = displaced.created_as.display();
        Some(match (self.state, &self.path, &self.problem) {
            (FileState::Removed, Some(copy), _) => format!(
                "the take {take} was removed during the recording, and was saved as {}",
                copy.display()
            ),
            (FileState::Removed, None, problem) => format!(
                "the take {take} was removed during the recording, and could not be saved: {}",
                problem.as_deref().unwrap_or("unknown reason")
            ),
            (FileState::Renamed, Some(path), _) => format!(
                "the take {take} was renamed during the recording: it is now {}",
                path.display()
            ),
            (FileState::Renamed, None, _) => {
                format!("the take {take} was renamed during the recording: its new name is unknown")
            }
            _ => displaced.message(),
        })
    }
}

/// Whether the file's mount is in the mount table. Counts as mounted when the kernel does not say.
fn is_mounted(file: &File) -> bool {
    let info = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", file.as_raw_fd()));
    let mounts = std::fs::read_to_string("/proc/self/mountinfo");
    let (Ok(info), Ok(mounts)) = (info, mounts) else { return true };
    mount_of(&info).is_none_or(|id| is_listed(id, &mounts))
}

/// The id of the mount through which the file was opened.
fn mount_of(fdinfo: &str) -> Option<&str> {
    fdinfo.lines().find_map(|line| line.strip_prefix("mnt_id:")).map(str::trim)
}

/// Whether the mount id begins a line of the mount table.
fn is_listed(id: &str, mountinfo: &str) -> bool {
    mountinfo.lines().any(|line| line.split(' ').next() == Some(id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::NameTaken;

    #[test]
    fn only_the_same_file_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let take = TakeFile::create(&path).unwrap();
        let taken = TakeFile::create(&path).unwrap_err();
        assert_eq!(taken.downcast_ref(), Some(&NameTaken { path: path.clone() }), "{taken}");
        assert!(taken.to_string().contains(path.to_str().unwrap()), "{taken}");
        let other = dir.path().join("b.take");
        std::fs::rename(&path, &other).unwrap();
        std::fs::write(&path, b"somebody else's").unwrap();
        assert!(take.id().is_at(&other).unwrap() && !take.id().is_at(&path).unwrap());
        take.id().remove(&path).unwrap();
        assert!(path.exists(), "it is another file");
        take.id().remove(&other).unwrap();
        assert!(!other.exists());
        take.id().remove(&other).unwrap();
    }

    #[test]
    fn changes_by_others_are_noticed_and_written_data_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("takes");
        std::fs::create_dir(&folder).unwrap();
        let path = folder.join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"one").unwrap();
        assert_eq!((take.check_state(), take.displaced()), (FileState::InPlace, None));

        // Renamed, alone and with its folder; and back.
        let other = folder.join("b.take");
        std::fs::rename(&path, &other).unwrap();
        assert_eq!(take.check_state(), FileState::Renamed);
        assert_eq!(take.displaced().unwrap().now_at.as_ref(), Some(&other));
        let moved = dir.path().join("moved");
        std::fs::rename(&folder, &moved).unwrap();
        take.write_all(b"two").unwrap();
        let settled = take.settle();
        assert_eq!((settled.state, settled.path), (FileState::Renamed, Some(moved.join("b.take"))));
        std::fs::rename(&moved, &folder).unwrap();
        std::fs::rename(&other, &path).unwrap();
        assert_eq!(take.check_state(), FileState::InPlace);

        // Removed, while another file has its name; then with its folder.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, b"another").unwrap();
        take.write_all(b"three").unwrap();
        assert_eq!(take.check_state(), FileState::Removed);
        let open_at = take.displaced().unwrap().open_at;
        assert_eq!(std::fs::read(open_at).unwrap(), b"onetwothree");
        for name in ["a.saved.take", "a.saved-2.take"] {
            let settled = take.settle();
            assert_eq!(settled.path, Some(folder.join(name)));
            assert_eq!(std::fs::read(folder.join(name)).unwrap(), b"onetwothree");
        }
        assert_eq!(std::fs::read(&path).unwrap(), b"another");
        std::fs::remove_dir_all(&folder).unwrap();
        let settled = take.settle();
        assert_eq!((settled.state, &settled.path), (FileState::Removed, &None));
        assert!(settled.problem.is_some());
    }

    #[test]
    fn a_folder_that_is_reached_through_another_link_is_not_unmounted() {
        let dir = tempfile::tempdir().unwrap();
        let (real, other) = (dir.path().join("real"), dir.path().join("other"));
        std::fs::create_dir(&real).unwrap();
        std::fs::create_dir(&other).unwrap();
        let link = dir.path().join("takes");
        let point_to = |folder: &Path| {
            std::fs::remove_file(&link).ok();
            std::os::unix::fs::symlink(folder, &link).unwrap();
        };
        point_to(&real);
        let mut take = TakeFile::create(&link.join("a.take")).unwrap();
        point_to(&other);
        assert_eq!(take.check_state(), FileState::Renamed);
        assert_eq!(take.displaced().unwrap().now_at, Some(real.join("a.take")));
        assert_eq!(take.settle().path, Some(real.join("a.take")));
        point_to(&real);
        assert_eq!(take.check_state(), FileState::InPlace);
    }

    /// The case of a network file system that does not answer, or a folder that temporarily cannot be searched.
    #[test]
    fn an_unknown_state_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let real = dir.path().join("real");
        std::fs::create_dir(&real).unwrap();
        let link = dir.path().join("takes");
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let path = link.join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        // A link to itself: neither "not found" nor "not a directory".
        std::fs::remove_file(&link).unwrap();
        std::os::unix::fs::symlink(&link, &link).unwrap();
        take.id().is_at(&path).unwrap_err();
        take.id().remove(&path).unwrap_err();
        assert_eq!(take.check_state(), FileState::InPlace);
        let settled = take.settle();
        assert_eq!((settled.state, settled.path), (FileState::InPlace, Some(path)));
    }

    #[test]
    fn undoing_a_partial_write_is_not_a_truncation() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"chunk and ha").unwrap();
        take.release(5).unwrap();
        assert_eq!(take.check_state(), FileState::InPlace);
        std::fs::remove_file(&path).unwrap();
        let saved = take.settle().path.unwrap();
        assert_eq!(std::fs::read(saved).unwrap(), b"chunk");
    }

    #[test]
    fn nothing_is_written_after_a_truncation() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"something").unwrap();
        File::options().write(true).open(&path).unwrap().set_len(4).unwrap();
        take.write_all(b"more").unwrap_err();
        take.release(9).unwrap();
        assert_eq!(take.check_state(), FileState::Truncated);
        assert_eq!(take.displaced().unwrap().bytes, (4, 9));
        assert_eq!(std::fs::read(&path).unwrap(), b"some");
        // Truncation is final, even if the file grows again.
        File::options().write(true).open(&path).unwrap().set_len(40).unwrap();
        assert_eq!(take.check_state(), FileState::Truncated);
    }

    #[test]
    fn an_open_file_is_mounted() {
        assert!(is_mounted(&tempfile::tempfile().unwrap()));
        assert_eq!(mount_of("pos:\t0\nflags:\t0100001\nmnt_id:\t29\nino:\t5\n"), Some("29"));
        assert_eq!(mount_of("pos:\t0\n"), None);
        let mounts = "21 1 8:1 / / rw\n29 21 0:25 / /run rw\n";
        assert!(is_listed("29", mounts) && !is_listed("2", mounts) && !is_listed("30", mounts));
    }
}
