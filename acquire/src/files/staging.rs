//! A hidden folder in which the files of a recording get their names before they are linked into a data set.
//!
//! A program that is killed while it links leaves the folder, and with it the means to undo the links: a file of the
//! data set that is the same file as one in the folder was added by that program. A lock on a file in the folder shows
//! whether the program still runs; the system releases it with the process.

use std::{
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions},
    io::{self, ErrorKind, Read, Seek, SeekFrom, Write},
    os::unix::{
        ffi::OsStrExt,
        fs::{MetadataExt, OpenOptionsExt},
    },
    path::{Component, Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use rustix::{
    fs::{AtFlags, CWD, FlockOperation, OFlags, RenameFlags, flock, linkat, renameat_with},
    io::Errno,
    process::geteuid,
};

use super::{folder_of, new_file::HiddenPath};

/// The table of subjects.
pub(super) const PARTICIPANTS: &str = "participants.tsv";

/// Extensions of the folder's name while links are made, and when all are there.
const PART: &str = ".part";
const DONE: &str = ".done";
/// Extension while the folder is removed.
const DISCARDED: &str = "discarded.part";

// The content of the folder.
const LOCK: &str = "lock";
const CONTENT: &str = "content";
/// Folders that are moved into the data set, with links to the files in [`CONTENT`].
const PUBLISHED: &str = "published";
/// The folders that were created in the data set, one per line, the outermost first.
const FOLDERS: &str = "folders";
/// The length of the table of subjects, a line end, and the row appended to it.
const ROW: &str = "row";

/// Maximum number of attempts to create a folder. One fails only if another program looks for leftovers within
/// microseconds.
const TRIES_MAX: u32 = 100;

/// Longest [`FOLDERS`] and [`ROW`]: a few paths, or a row of the table.
const JOURNAL_BYTES_MAX: u64 = 1 << 20;

/// The beginning of the names of such folders: beside a data set of a name, or within it.
pub(super) fn prefix(beside: Option<&OsStr>) -> OsString {
    let mut prefix = OsString::from(".");
    if let Some(name) = beside {
        prefix.push(name);
        prefix.push(".");
    }
    prefix.push("mocapd-");
    prefix
}

/// A staging folder. Dropping it undoes what was added to the data set, unless it was [committed](Self::commit).
#[derive(Debug)]
pub(super) struct Staging {
    root: HiddenPath,
    dataset: PathBuf,
    /// Held as long as the program runs.
    _lock: Option<File>,
}

impl Staging {
    /// Creates a folder in `folder`, which is the data set or the folder that it is in.
    pub(super) fn create(folder: &Path, dataset: &Path) -> io::Result<Self> {
        let mut tries = 0;
        loop {
            match Self::try_create(folder, dataset) {
                // Another program took the new folder, not yet locked, for one of a killed program.
                Err(error)
                    if folder.is_dir()
                        && tries < TRIES_MAX
                        && matches!(error.kind(), ErrorKind::NotFound | ErrorKind::WouldBlock) =>
                {
                    tries += 1;
                }
                other => return other,
            }
        }
    }

    fn try_create(folder: &Path, dataset: &Path) -> io::Result<Self> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let is_within = folder == dataset;
        let mut name = prefix(if is_within { None } else { dataset.file_name() });
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        name.push(format!("{}-{number}{PART}", std::process::id()));
        let root = folder.join(name);
        let root = HiddenPath::staging(root, dataset.to_owned(), discard)?;
        let lock = root.path().join(LOCK);
        let lock = OpenOptions::new().write(true).create_new(true).open(lock)?;
        // On a file system without locks, no program removes another's folder.
        if flock(&lock, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
            return Err(ErrorKind::WouldBlock.into());
        }
        let (dataset, _lock) = (dataset.to_owned(), Some(lock));
        let created = Self { root, dataset, _lock };
        fs::create_dir(created.content())?;
        Ok(created)
    }

    /// The folder of the files.
    pub(super) fn content(&self) -> PathBuf {
        self.root.path().join(CONTENT)
    }

    /// Gives files their names in the data set, within microseconds: folders that are missing appear with all their
    /// files. Existing files are not replaced.
    ///
    /// # Errors
    /// The path that could not be created, and why.
    pub(super) fn publish(&self, paths: &[String]) -> Result<(), (PathBuf, io::Error)> {
        let mut folders: Vec<PathBuf> = Vec::new();
        let mut files: Vec<&String> = Vec::new();
        for path in paths {
            let Some(folder) = self.missing_folder(path) else {
                files.push(path);
                continue;
            };
            self.prepare(path, &folder).map_err(|error| (self.dataset.join(path), error))?;
            if !folders.contains(&folder) {
                folders.push(folder);
            }
        }
        for folder in folders {
            let (from, to) =
                (self.root.path().join(PUBLISHED).join(&folder), self.dataset.join(folder));
            rename_new(&from, &to).map_err(|error| (to, error))?;
        }
        for path in files {
            let (from, to) = (self.content().join(path), self.dataset.join(path));
            link_or_move(&from, &to).map_err(|error| (to, error))?;
        }
        Ok(())
    }

    /// The outermost folder of a file that the data set lacks.
    fn missing_folder(&self, path: &str) -> Option<PathBuf> {
        let folders: Vec<&Path> = Path::new(path).ancestors().skip(1).collect();
        let is_missing = |folder: &Path| self.dataset.join(folder).symlink_metadata().is_err();
        folders.into_iter().rev().find(|folder| is_missing(folder)).map(Path::to_owned)
    }

    /// Puts a file into a copy of the missing folder, which is then moved as a whole.
    fn prepare(&self, path: &str, missing: &Path) -> io::Result<()> {
        let copy = self.root.path().join(PUBLISHED).join(path);
        let folder = folder_of(Path::new(path));
        if !self.root.path().join(PUBLISHED).join(folder).is_dir() {
            create_folders(self.root.path(), &Path::new(PUBLISHED).join(folder))?;
            let mut created: Vec<&Path> =
                folder.ancestors().take_while(|folder| folder.starts_with(missing)).collect();
            created.reverse();
            let journal = self.root.path().join(FOLDERS);
            let mut journal = OpenOptions::new().append(true).create(true).open(journal)?;
            for folder in created {
                journal.write_all(&[folder.as_os_str().as_bytes(), b"\n"].concat())?;
            }
        }
        link_or_move(&self.content().join(path), &copy)
    }

    /// Appends a row to the table of subjects.
    pub(super) fn append(&self, participants: &Path, row: &[u8]) -> io::Result<()> {
        let before = participants.metadata()?.len();
        let journal = [before.to_string().as_bytes(), b"\n", row].concat();
        fs::write(self.root.path().join(ROW), journal)?;
        append(participants, row)
    }

    /// States that everything is there: from now on no program undoes the links.
    pub(super) fn commit(&mut self) {
        let done = self.root.path().with_extension(DONE.trim_start_matches('.'));
        self.root.commit(done, |root, _| remove(root));
    }

    /// Creates the folder of a file of the content.
    ///
    /// # Errors
    /// Those of the file system; `NotFound` if the staging folder is gone, which is not created again.
    pub(super) fn create_folder_of(&self, path: &Path) -> io::Result<()> {
        create_folders(self.root.path(), &Path::new(CONTENT).join(folder_of(path)))
    }
}

/// Creates the folders of `below` that are missing in `root`, but not `root`.
fn create_folders(root: &Path, below: &Path) -> io::Result<()> {
    let mut folder = root.to_owned();
    for name in below {
        folder.push(name);
        match fs::create_dir(&folder) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Links a file to a name that must not exist; moves it on file systems without hard links.
fn link_or_move(from: &Path, to: &Path) -> io::Result<()> {
    match linkat(CWD, from, CWD, to, AtFlags::empty()) {
        Err(Errno::PERM | Errno::NOSYS | Errno::OPNOTSUPP | Errno::MLINK) => rename_new(from, to),
        other => Ok(other?),
    }
}

/// Renames a file or folder to a name that must not exist.
///
/// # Errors
/// `AlreadyExists` if it does, and those of the file system.
pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Some network file systems do not support this rename; a link refuses to overwrite as well.
        Err(Errno::INVAL | Errno::NOSYS) if from.symlink_metadata()?.is_file() => {
            match linkat(CWD, from, CWD, to, AtFlags::empty()) {
                Ok(()) => fs::remove_file(from),
                Err(error) => Err(error.into()),
            }
        }
        // The plain rename refuses folders that are not empty.
        Err(Errno::INVAL | Errno::NOSYS) if to.symlink_metadata().is_err() => fs::rename(from, to),
        Err(Errno::INVAL | Errno::NOSYS) => Err(ErrorKind::AlreadyExists.into()),
        other => Ok(other?),
    }
}

/// Removes the folders that killed programs left in `folder`, and what they had added to the data set.
pub(super) fn remove_leftovers(folder: &Path, prefix: &OsStr, dataset: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.as_bytes();
        let is_part = name.ends_with(PART.as_bytes());
        // A data set may come from elsewhere: links and folders of other users are not ours.
        let is_ours =
            entry.metadata().is_ok_and(|found| found.is_dir() && found.uid() == geteuid().as_raw());
        if !is_ours
            || !name.starts_with(prefix.as_bytes())
            || !is_part && !name.ends_with(DONE.as_bytes())
        {
            continue;
        }
        let root = entry.path();
        let mut lock = open_file(&root.join(LOCK));
        if lock.as_ref().is_err_and(|error| error.kind() == ErrorKind::NotFound) {
            if fs::remove_dir(&root).is_ok() {
                continue;
            }
            // It is not empty: a program that creates its folder now has created the lock first of all.
            lock = open_file(&root.join(LOCK));
        }
        match lock {
            Ok(lock) => {
                // Otherwise the program still runs, or there are no locks.
                if flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok() {
                    if is_part {
                        undo(&root, dataset);
                    }
                    remove(&root);
                }
            }
            // Killed before it had the lock, or after it was removed as the last file.
            Err(_) => remove(&root),
        }
    }
}

/// Opens a file for reading and writing. Refuses links, and pipes, which would wait for their other end.
fn open_file(path: &Path) -> io::Result<File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    let file = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(ErrorKind::InvalidInput.into()) }
}

/// Removes a staging folder, and what was added from it to the data set.
fn discard(root: &Path, dataset: &Path) {
    // Threads that still write no longer find the folder, so that nothing appears in it while it is removed.
    let discarded = root.with_extension(DISCARDED);
    let root = if fs::rename(root, &discarded).is_ok() { &discarded } else { root };
    undo(root, dataset);
    remove(root);
}

/// Removes a staging folder, its lock last: as long as there is one, the next program continues where a killed one
/// stopped. Files of others in it stay, and with them the folder.
fn remove(root: &Path) {
    for folder in [CONTENT, PUBLISHED] {
        fs::remove_dir_all(root.join(folder)).ok();
    }
    for file in [FOLDERS, ROW, LOCK] {
        fs::remove_file(root.join(file)).ok();
    }
    fs::remove_dir(root).ok();
}

/// Removes from the data set what was added from a staging folder.
fn undo(root: &Path, dataset: &Path) {
    let content = root.join(CONTENT);
    for staged in files_in(&content) {
        let Ok(relative) = staged.strip_prefix(&content) else { continue };
        let added = dataset.join(relative);
        let id = |path: &Path| path.symlink_metadata().map(|found| (found.dev(), found.ino())).ok();
        if id(&staged).is_some_and(|staged| id(&added) == Some(staged)) {
            fs::remove_file(added).ok();
        }
    }
    undo_row(root, &dataset.join(PARTICIPANTS)).ok();
    let folders = read_journal(&root.join(FOLDERS)).unwrap_or_default();
    for folder in folders.split(|&b| b == b'\n').rev().filter(|folder| !folder.is_empty()) {
        let folder = Path::new(OsStr::from_bytes(folder));
        // Of the data set only; fails if something is in it.
        if folder.components().all(|part| matches!(part, Component::Normal(_))) {
            fs::remove_dir(dataset.join(folder)).ok();
        }
    }
}

/// Cuts the row off the table of subjects, if it is the last one.
fn undo_row(root: &Path, participants: &Path) -> io::Result<()> {
    let journal = read_journal(&root.join(ROW))?;
    let mut parts = journal.splitn(2, |&b| b == b'\n');
    let before = parts.next().and_then(|number| std::str::from_utf8(number).ok()?.parse().ok());
    let (Some(before), Some(row)) = (before, parts.next()) else { return Ok(()) };
    let mut file = open_file(participants)?;
    let mut appended = Vec::new();
    file.seek(SeekFrom::Start(before))?;
    (&mut file).take(row.len() as u64 + 1).read_to_end(&mut appended)?;
    if appended == row || !appended.is_empty() && row.starts_with(&appended) {
        file.set_len(before)?;
    }
    Ok(())
}

/// Appends to a file; what was appended in part is removed again.
fn append(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new().append(true).open(path)?;
    let len = file.seek(SeekFrom::End(0))?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    if written.is_err() {
        file.set_len(len).ok();
    }
    written
}

fn read_journal(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_file(path)?.take(JOURNAL_BYTES_MAX).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The files in a folder and its subfolders. A recording has three levels of folders at most.
fn files_in(folder: &Path) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            if is_folder { folders.push(entry.path()) } else { files.push(entry.path()) }
        }
    }
    files
}

#[cfg(test)]
mod tests {
    use std::mem::ManuallyDrop;

    use super::*;

    /// A data set with one subject, and the staging folder of an export that adds another.
    fn staged_addition(dir: &Path) -> (PathBuf, Staging) {
        let dataset = dir.join("set");
        fs::create_dir_all(dataset.join("sub-01/motion")).unwrap();
        fs::write(dataset.join("sub-01/motion/a.tsv"), "1").unwrap();
        fs::write(dataset.join(PARTICIPANTS), "participant_id\nsub-01\n").unwrap();
        let staging = Staging::create(&dataset, &dataset).unwrap();
        for path in ["sub-01/motion/b.tsv", "sub-02/motion/c.tsv"] {
            let staged = staging.content().join(path);
            fs::create_dir_all(staged.parent().unwrap()).unwrap();
            fs::write(staged, "2").unwrap();
        }
        (dataset, staging)
    }

    fn publish(staging: &Staging, path: &str) {
        staging.publish(&[path.to_owned()]).unwrap();
    }

    /// All files and folders, and what the files hold.
    fn content(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
        let mut all = Vec::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let found = fs::read(&path).ok();
            if found.is_none() {
                all.extend(content(&path));
            }
            all.push((path, found));
        }
        all.sort();
        all
    }

    #[test]
    fn additions_of_a_killed_program_are_undone() {
        for n_steps in 0..=4 {
            let dir = tempfile::tempdir().unwrap();
            let (dataset, staging) = staged_addition(dir.path());
            let before: Vec<_> = content(&dataset)
                .into_iter()
                .filter(|(path, _)| !path.starts_with(staging.root.path()))
                .collect();
            let mut killed = ManuallyDrop::new(staging);
            if n_steps > 0 {
                publish(&killed, "sub-01/motion/b.tsv");
            }
            if n_steps > 1 {
                publish(&killed, "sub-02/motion/c.tsv");
            }
            if n_steps > 2 {
                killed.append(&dataset.join(PARTICIPANTS), b"sub-02\n").unwrap();
            }
            let remove = || remove_leftovers(&dataset, &prefix(None), &dataset);
            // As long as it runs nothing happens.
            let running = content(&dataset);
            remove();
            assert_eq!(content(&dataset), running);
            if n_steps > 3 {
                killed.commit();
            }
            killed._lock = None;
            remove();
            let left = content(&dataset);
            if n_steps > 3 {
                assert_eq!(left.len(), before.len() + 4, "two files, two folders: {left:?}");
                let table = fs::read_to_string(dataset.join(PARTICIPANTS)).unwrap();
                assert_eq!(table, "participant_id\nsub-01\nsub-02\n");
            } else {
                assert_eq!(left, before, "{n_steps}");
            }
        }
    }

    /// A data set may come from elsewhere, with names like those of leftovers.
    #[test]
    fn nothing_outside_the_data_set_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, staging) = staged_addition(dir.path());
        drop(staging);
        let victim = dir.path().join("victim");
        fs::create_dir_all(victim.join("content")).unwrap();
        fs::write(victim.join("lock"), "").unwrap();
        std::os::unix::fs::symlink("../victim", dataset.join(".mocapd-1-0.part")).unwrap();
        let empty = dir.path().join("empty");
        fs::create_dir(&empty).unwrap();
        let leftover = dataset.join(".mocapd-2-0.part");
        fs::create_dir(&leftover).unwrap();
        fs::write(leftover.join("lock"), "").unwrap();
        let folders = format!("{}\n../empty\n", empty.display());
        fs::write(leftover.join(FOLDERS), folders).unwrap();
        let lockless = dataset.join(".mocapd-3-0.part/content/sub-03");
        fs::create_dir_all(&lockless).unwrap();
        // A pipe would wait for its other end.
        let pipe = dataset.join(".mocapd-4-0.part");
        fs::create_dir(&pipe).unwrap();
        rustix::fs::mkfifoat(CWD, pipe.join("lock"), rustix::fs::Mode::RUSR).unwrap();
        remove_leftovers(&dataset, &prefix(None), &dataset);
        assert!(victim.join("content").is_dir() && empty.is_dir());
        assert!(!leftover.exists() && !lockless.exists() && !pipe.exists());
    }

    #[test]
    fn later_rows_and_files_of_others_stay() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, staging) = staged_addition(dir.path());
        let mut killed = ManuallyDrop::new(staging);
        publish(&killed, "sub-02/motion/c.tsv");
        let participants = dataset.join(PARTICIPANTS);
        killed.append(&participants, b"sub-02\n").unwrap();
        append(&participants, b"sub-03\n").unwrap();
        fs::write(dataset.join("sub-02/motion/mine.tsv"), "3").unwrap();
        killed._lock = None;
        remove_leftovers(&dataset, &prefix(None), &dataset);
        assert!(!dataset.join("sub-02/motion/c.tsv").exists());
        assert_eq!(fs::read(dataset.join("sub-02/motion/mine.tsv")).unwrap(), b"3");
        let table = fs::read_to_string(participants).unwrap();
        assert_eq!(table, "participant_id\nsub-01\nsub-02\nsub-03\n");
    }

    #[test]
    fn a_file_that_exists_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, staging) = staged_addition(dir.path());
        // Both appear while it is written.
        let file = dataset.join("sub-01/motion/b.tsv");
        fs::write(&file, "mine").unwrap();
        let refused = |paths: &[&str]| {
            let paths: Vec<String> = paths.iter().map(|path| (*path).to_owned()).collect();
            let (path, error) = staging.publish(&paths).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::AlreadyExists);
            path
        };
        assert_eq!(refused(&["sub-02/motion/c.tsv", "sub-01/motion/b.tsv"]), file);
        assert!(dataset.join("sub-02/motion/c.tsv").exists());
        drop(staging);
        assert_eq!(fs::read(file).unwrap(), b"mine");
        assert_eq!(fs::read_dir(&dataset).unwrap().count(), 2, "what was added is undone");
    }
}
