//! A hidden folder in which the files of a recording get their names before they are linked into a data set.
//!
//! A program that is killed while it links leaves the folder, and with it the means to undo the links: a file of the
//! data set that is the same file as one in the folder was added by that program. A lock on a file in the folder shows
//! whether the program still runs; the system releases it with the process.

use std::{
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions},
    io::{self, ErrorKind, Read, Seek, SeekFrom, Write},
    os::unix::{ffi::OsStrExt, fs::MetadataExt},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use rustix::{
    fs::{AtFlags, CWD, FlockOperation, RenameFlags, flock, linkat, renameat_with},
    io::Errno,
};

/// The table of subjects.
pub(super) const PARTICIPANTS: &str = "participants.tsv";

/// Endings of the folder while links are made, and when all are there.
const PART: &str = ".part";
const DONE: &str = ".done";

// The content of the folder.
const LOCK: &str = "lock";
const CONTENT: &str = "content";
/// The folders that were created in the data set, one a line.
const FOLDERS: &str = "folders";
/// The length of the table of subjects, a line end, and the row appended to it.
const ROW: &str = "row";

/// Most attempts to create a folder. One fails only if another program looks for leftovers within microseconds.
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
    root: PathBuf,
    dataset: PathBuf,
    is_committed: bool,
    /// Held as long as the program runs.
    lock: Option<File>,
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
        fs::create_dir(&root)?;
        let lock = OpenOptions::new().write(true).create_new(true).open(root.join(LOCK))?;
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Err(Errno::WOULDBLOCK) => return Err(ErrorKind::WouldBlock.into()),
            // Without locks, nobody removes the folder of another program.
            Ok(()) | Err(_) => {}
        }
        let (dataset, lock) = (dataset.to_owned(), Some(lock));
        let created = Self { root, dataset, is_committed: false, lock };
        fs::create_dir(created.content())?;
        Ok(created)
    }

    /// The folder of the files.
    pub(super) fn content(&self) -> PathBuf {
        self.root.join(CONTENT)
    }

    /// Creates the missing ones of a folder of the data set and the folders it is in.
    pub(super) fn create_folders(&self, folder: &Path) -> io::Result<()> {
        let missing: Vec<&Path> =
            folder.ancestors().take_while(|folder| folder.symlink_metadata().is_err()).collect();
        for folder in missing.into_iter().rev() {
            let relative = folder.strip_prefix(&self.dataset).map_err(io::Error::other)?;
            let journal = self.root.join(FOLDERS);
            let mut journal = OpenOptions::new().append(true).create(true).open(journal)?;
            journal.write_all(&[relative.as_os_str().as_bytes(), b"\n"].concat())?;
            match fs::create_dir(folder) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    /// Gives a file its name in the data set. What is there already is not replaced.
    pub(super) fn publish(&self, path: &str, to: &Path) -> io::Result<()> {
        let staged = self.content().join(path);
        match linkat(CWD, &staged, CWD, to, AtFlags::empty()) {
            // File systems without hard links.
            Err(Errno::PERM | Errno::NOSYS | Errno::OPNOTSUPP | Errno::MLINK) => {
                Ok(renameat_with(CWD, &staged, CWD, to, RenameFlags::NOREPLACE)?)
            }
            other => Ok(other?),
        }
    }

    /// Appends a row to the table of subjects.
    pub(super) fn append(&self, participants: &Path, row: &[u8]) -> io::Result<()> {
        let before = participants.metadata()?.len();
        let journal = [before.to_string().as_bytes(), b"\n", row].concat();
        fs::write(self.root.join(ROW), journal)?;
        append(participants, row)
    }

    /// States that everything is there, and removes the folder.
    pub(super) fn commit(&mut self) {
        self.is_committed = true;
        let done = self.root.with_extension(DONE.trim_start_matches('.'));
        // From this rename on, nobody undoes the links.
        if fs::rename(&self.root, &done).is_ok() {
            self.root = done;
        }
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.is_committed {
            undo(&self.root, &self.dataset);
        }
        fs::remove_dir_all(&self.root).ok();
        self.lock = None;
    }
}

/// Removes the folders that killed programs left in `folder`, and what they had added to the data set.
pub(super) fn remove_leftovers(folder: &Path, prefix: &OsStr, dataset: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.as_bytes();
        let is_part = name.ends_with(PART.as_bytes());
        if !name.starts_with(prefix.as_bytes()) || !is_part && !name.ends_with(DONE.as_bytes()) {
            continue;
        }
        let root = entry.path();
        let lock = OpenOptions::new().write(true).open(root.join(LOCK));
        match lock.map(|lock| flock(&lock, FlockOperation::NonBlockingLockExclusive).map(|()| lock))
        {
            Ok(Ok(_lock)) => {
                if is_part {
                    undo(&root, dataset);
                }
                fs::remove_dir_all(&root).ok();
            }
            // The program still runs, or there are no locks.
            Ok(Err(_)) => {}
            // Killed before it had the lock: the folder is empty. Otherwise this does nothing.
            Err(_) => drop(fs::remove_dir(&root)),
        }
    }
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
        // Fails if something is in it.
        fs::remove_dir(dataset.join(OsStr::from_bytes(folder))).ok();
    }
}

/// Cuts the row off the table of subjects, if it is the last one.
fn undo_row(root: &Path, participants: &Path) -> io::Result<()> {
    let journal = read_journal(&root.join(ROW))?;
    let mut parts = journal.splitn(2, |&b| b == b'\n');
    let before = parts.next().and_then(|number| std::str::from_utf8(number).ok()?.parse().ok());
    let (Some(before), Some(row)) = (before, parts.next()) else { return Ok(()) };
    let mut file = OpenOptions::new().read(true).write(true).open(participants)?;
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
    File::open(path)?.take(JOURNAL_BYTES_MAX).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The files in a folder and its folders. A recording has three levels of folders at most.
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

    /// A data set with one subject, to which a program adds another one; the folder of that program.
    fn begun(dir: &Path) -> (PathBuf, Staging) {
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

    fn publish(dataset: &Path, staging: &Staging, path: &str) {
        let to = dataset.join(path);
        staging.create_folders(to.parent().unwrap()).unwrap();
        staging.publish(path, &to).unwrap();
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
    fn what_a_killed_program_added_is_undone() {
        for n_steps in 0..=4 {
            let dir = tempfile::tempdir().unwrap();
            let (dataset, staging) = begun(dir.path());
            let before: Vec<_> = content(&dataset)
                .into_iter()
                .filter(|(path, _)| !path.starts_with(&staging.root))
                .collect();
            let mut killed = ManuallyDrop::new(staging);
            if n_steps > 0 {
                publish(&dataset, &killed, "sub-01/motion/b.tsv");
            }
            if n_steps > 1 {
                publish(&dataset, &killed, "sub-02/motion/c.tsv");
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
            killed.lock = None;
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

    #[test]
    fn later_rows_and_files_of_others_stay() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, staging) = begun(dir.path());
        let mut killed = ManuallyDrop::new(staging);
        publish(&dataset, &killed, "sub-02/motion/c.tsv");
        let participants = dataset.join(PARTICIPANTS);
        killed.append(&participants, b"sub-02\n").unwrap();
        append(&participants, b"sub-03\n").unwrap();
        fs::write(dataset.join("sub-02/motion/mine.tsv"), "3").unwrap();
        killed.lock = None;
        remove_leftovers(&dataset, &prefix(None), &dataset);
        assert!(!dataset.join("sub-02/motion/c.tsv").exists());
        assert_eq!(fs::read(dataset.join("sub-02/motion/mine.tsv")).unwrap(), b"3");
        let table = fs::read_to_string(participants).unwrap();
        assert_eq!(table, "participant_id\nsub-01\nsub-02\nsub-03\n");
    }

    #[test]
    fn a_file_that_exists_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, staging) = begun(dir.path());
        let to = dataset.join("sub-01/motion/a.tsv");
        let error = staging.publish("sub-01/motion/b.tsv", &to).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        drop(staging);
        assert_eq!(fs::read(to).unwrap(), b"1");
        assert_eq!(fs::read_dir(&dataset).unwrap().count(), 2);
    }
}
