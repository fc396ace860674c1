//! The file of a live take: it has its final name from the first byte, and is known by what it is, not by that name.

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

use super::{Displaced, FileState, NewFile, Settled, file_state::is_mounted, own_link};

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
    ///
    /// # Errors
    /// Why that cannot be known: only a name that does not exist is known to lead nowhere.
    pub fn is_at(self, path: &Path) -> io::Result<bool> {
        match path.symlink_metadata() {
            Ok(found) => Ok(Self::of(&found) == self),
            Err(error) => match error.kind() {
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Ok(false),
                _ => Err(error),
            },
        }
    }

    /// Takes the name away from it; a file of somebody else that has the name by now keeps it.
    ///
    /// # Errors
    /// The disk's.
    pub fn remove(self, path: &Path) -> io::Result<()> {
        if self.is_at(path)? { std::fs::remove_file(path) } else { Ok(()) }
    }
}

/// Whether a recorder writes it: its lock lasts as long as it does.
#[must_use]
pub fn is_being_written(file: &File) -> bool {
    flock(file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK)
}

/// What a take is written to.
pub trait TakeOutput: Any + Write + Send {
    /// Makes everything written so far survive a power cut.
    ///
    /// # Errors
    /// The device's.
    fn sync(&mut self) -> io::Result<()>;

    /// Makes sure that so many bytes can be written from an offset on, whatever others write to the disk meanwhile.
    ///
    /// # Errors
    /// `StorageFull`, `QuotaExceeded` when there is no such room; `Unsupported` where none can be held back.
    fn hold_back(&mut self, _from: u64, _bytes: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Gives back what was held and is not needed: the output has so many bytes.
    ///
    /// # Errors
    /// The device's.
    fn release(&mut self, _bytes: u64) -> io::Result<()> {
        Ok(())
    }

    /// Free bytes on the disk, without those reserved for root; `None` where the system does not say.
    fn free_bytes(&self) -> Option<u64> {
        None
    }

    /// What others have done to it; at most a moment old.
    fn look(&mut self) -> FileState {
        FileState::InPlace
    }

    /// The same, as of now.
    fn look_now(&mut self) -> FileState {
        FileState::InPlace
    }

    /// More about that, where something was done.
    fn displaced(&self) -> Option<Displaced> {
        None
    }

    /// Where it is, now that the take has ended.
    fn settle(&mut self) -> Settled {
        Settled::default()
    }
}

impl fmt::Debug for dyn TakeOutput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TakeOutput")
    }
}

/// Between two looks at what others did to the file: often enough to notice it within a second.
const LOOK_EVERY: Duration = Duration::from_millis(400);

/// Names that are tried for the copy of a take that was removed.
const COPIES_MAX: u32 = 100;

/// A new take's file.
#[derive(Debug)]
pub struct TakeFile {
    file: File,
    path: PathBuf,
    id: FileId,
    /// How the kernel showed it when it was created.
    link: Option<PathBuf>,
    written: u64,
    looked: Option<Instant>,
    state: FileState,
}

impl TakeFile {
    /// Creates it under a name that must be free, and makes the name survive a power cut.
    ///
    /// # Errors
    /// That the name is taken, or why it cannot be created.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let file = super::create_new(path)?;
        let id = FileId::of(&file.metadata()?);
        // Not every file system has locks; without one other services take it for cut off.
        flock(&file, FlockOperation::NonBlockingLockExclusive).ok();
        super::sync_name(path);
        let (path, link) = (path.to_owned(), own_link(&file).read_link().ok());
        Ok(Self { file, path, id, link, written: 0, looked: None, state: FileState::InPlace })
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

    /// `None` where that cannot be known.
    fn found(&self) -> Option<FileState> {
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
        let link = own_link(&self.file).read_link().ok();
        // Without a symbolic link: one that leads elsewhere by now is not the file's.
        if let Some(link) = &link
            && self.id.is_at(link).ok()?
        {
            return Some(FileState::Renamed);
        }
        // Its own name is as it was, and leads elsewhere: something is mounted over it.
        let is_covered = link.is_some() && link == self.link;
        if is_covered || !is_mounted(&self.file) {
            return Some(FileState::Unmounted);
        }
        Some(FileState::Renamed)
    }

    /// Its name, where one leads to it.
    fn name_now(&self) -> Option<PathBuf> {
        // Where that cannot be known now, it is where it was at the last look.
        let was_there = self.state == FileState::InPlace;
        if self.id.is_at(&self.path).unwrap_or(was_there) {
            return Some(self.path.clone());
        }
        let link = own_link(&self.file).read_link().ok();
        link.filter(|path| self.id.is_at(path).unwrap_or(false))
    }

    /// Beside the name that it had, under a free one. The kernel gives no name back to a file that has lost its last.
    fn save_copy(&self) -> anyhow::Result<PathBuf> {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = |count: u32| match count {
            1 => format!("{stem}.saved.take"),
            _ => format!("{stem}.saved-{count}.take"),
        };
        let mut names = (1..COPIES_MAX).map(|count| self.path.with_file_name(name(count)));
        let free = names.find(|path| path.symlink_metadata().is_err());
        let path = free.context("every name for a copy is taken")?;
        let mut input = File::open(own_link(&self.file)).context("cannot be opened again")?;
        let mut copy = NewFile::create(&path)?;
        io::copy(&mut input, &mut copy)
            .with_context(|| format!("cannot write {}", path.display()))?;
        copy.keep()?;
        Ok(path)
    }
}

impl Write for TakeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // Behind a cut there would be a hole, and the file as long as ever.
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

    fn hold_back(&mut self, from: u64, bytes: u64) -> io::Result<()> {
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
        // Nobody else did that.
        if found >= self.written {
            self.written = self.written.min(left);
        }
        Ok(())
    }

    fn look(&mut self) -> FileState {
        if self.looked.is_none_or(|last| last.elapsed() >= LOOK_EVERY) {
            self.look_now();
        }
        self.state
    }

    fn look_now(&mut self) -> FileState {
        self.looked = Some(Instant::now());
        // What was cut off does not come back, and what follows would lie behind a hole.
        if self.state != FileState::Truncated {
            self.state = self.found().unwrap_or(self.state);
        }
        self.state
    }

    fn displaced(&self) -> Option<Displaced> {
        if self.state == FileState::InPlace {
            return None;
        }
        let found = self.file.metadata().map_or(0, |found| found.len());
        Some(Displaced {
            state: self.state,
            created_as: self.path.clone(),
            now_at: self.name_now(),
            open_at: format!("/proc/{}/fd/{}", std::process::id(), self.file.as_raw_fd()).into(),
            bytes: (found, self.written),
        })
    }

    fn settle(&mut self) -> Settled {
        let state = self.look_now();
        let displaced = self.displaced();
        let mut settled = Settled { state, path: self.name_now(), displaced, problem: None };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::NameTaken;

    #[test]
    fn only_the_file_itself_loses_its_name() {
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
    fn what_others_do_is_noticed_and_what_was_written_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("takes");
        std::fs::create_dir(&folder).unwrap();
        let path = folder.join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"one").unwrap();
        assert_eq!((take.look_now(), take.displaced()), (FileState::InPlace, None));

        // Renamed, alone and with its folder; and back.
        let other = folder.join("b.take");
        std::fs::rename(&path, &other).unwrap();
        assert_eq!(take.look_now(), FileState::Renamed);
        assert_eq!(take.displaced().unwrap().now_at.as_ref(), Some(&other));
        let moved = dir.path().join("moved");
        std::fs::rename(&folder, &moved).unwrap();
        take.write_all(b"two").unwrap();
        let settled = take.settle();
        assert_eq!((settled.state, settled.path), (FileState::Renamed, Some(moved.join("b.take"))));
        std::fs::rename(&moved, &folder).unwrap();
        std::fs::rename(&other, &path).unwrap();
        assert_eq!(take.look_now(), FileState::InPlace);

        // Removed: by its name, though another file has that; then with its folder.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, b"another").unwrap();
        take.write_all(b"three").unwrap();
        assert_eq!(take.look_now(), FileState::Removed);
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
        assert_eq!(take.look_now(), FileState::Renamed);
        assert_eq!(take.displaced().unwrap().now_at, Some(real.join("a.take")));
        assert_eq!(take.settle().path, Some(real.join("a.take")));
        point_to(&real);
        assert_eq!(take.look_now(), FileState::InPlace);
    }

    /// As of a network file system that does not answer, or a folder that may not be searched for a while.
    #[test]
    fn what_cannot_be_known_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let real = dir.path().join("real");
        std::fs::create_dir(&real).unwrap();
        let link = dir.path().join("takes");
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let path = link.join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        // A link to itself: neither "not found" nor "no folder".
        std::fs::remove_file(&link).unwrap();
        std::os::unix::fs::symlink(&link, &link).unwrap();
        take.id().is_at(&path).unwrap_err();
        take.id().remove(&path).unwrap_err();
        assert_eq!(take.look_now(), FileState::InPlace);
        let settled = take.settle();
        assert_eq!((settled.state, settled.path), (FileState::InPlace, Some(path)));
    }

    #[test]
    fn half_a_write_is_taken_back_without_a_cut() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"chunk and ha").unwrap();
        take.release(5).unwrap();
        assert_eq!(take.look_now(), FileState::InPlace);
        std::fs::remove_file(&path).unwrap();
        let saved = take.settle().path.unwrap();
        assert_eq!(std::fs::read(saved).unwrap(), b"chunk");
    }

    #[test]
    fn nothing_is_written_behind_a_cut() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut take = TakeFile::create(&path).unwrap();
        take.write_all(b"something").unwrap();
        File::options().write(true).open(&path).unwrap().set_len(4).unwrap();
        take.write_all(b"more").unwrap_err();
        take.release(9).unwrap();
        assert_eq!(take.look_now(), FileState::Truncated);
        assert_eq!(take.displaced().unwrap().bytes, (4, 9));
        assert_eq!(std::fs::read(&path).unwrap(), b"some");
        // It stays so, though the file may become as long again.
        File::options().write(true).open(&path).unwrap().set_len(40).unwrap();
        assert_eq!(take.look_now(), FileState::Truncated);
    }
}
