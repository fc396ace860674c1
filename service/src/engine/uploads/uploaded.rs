//! Takes that were uploaded: the file that lists them, and the removal of their local copies, once their objects were read
//! back and are the same.

use std::{
    collections::{BTreeMap, HashSet},
    fs::{self, File, Metadata},
    io::{self, Write},
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::Context;
use mocapd_acquire::files::{self, FileId, folder_of, rename_new};
use mocapd_store::{ObjectUrl, Store, StoreError};
use serde::{Deserialize, Serialize};

use super::{Pace, RETRY_MAX, Retry, TAKES_MAX, Uploader, is_of_take};
use crate::{
    config::ArchiveConfig,
    engine::{Inner, session::unix_ms},
    status::{ServiceEventKind, TakeSummary, UploadState},
    take_files::notes,
};

/// The end of the hidden name that a take has while it is removed.
const SET_ASIDE: &str = ".removing";

/// Names that are tried for such a take: each is taken only if a take of the name was recorded while it was removed.
const RESTORED_NAMES_MAX: usize = 100;

impl Uploader {
    /// Removes the local copy of a take that was uploaded long enough ago, once its object was read back and compared.
    /// Returns whether there may be more to do.
    pub(super) fn remove_local(
        &mut self,
        inner: &Inner,
        takes: &[TakeSummary],
        url: &ObjectUrl,
        config: &ArchiveConfig,
    ) -> bool {
        let Some(after) = config.remove_local_after else { return false };
        let after_ms = i64::try_from(after.as_millis()).unwrap_or(i64::MAX);
        let now = unix_ms();
        let due = takes.iter().rev().find_map(|take| {
            let object = url.join(&format!("{}.take", take.name));
            // A take that was renamed keeps its object.
            let object = self.journal.object(take, &object)?;
            let entry = self.journal.entry(take, &object)?;
            let waits = self.take_retries.get(&take.name).is_some_and(|r| r.at > Instant::now());
            let is_due = entry.uploaded_unix_ms.saturating_add(after_ms) <= now;
            (is_due && !waits && !take.is_open).then_some((take, object))
        });
        let Some((take, object)) = due else { return false };
        let name = &take.name;
        let Some(directory) = self.of.as_ref().map(|(directory, _)| directory.clone()) else {
            return false;
        };
        let Some(_claim) = inner.claims.claim(name, "removed, as the archive has it") else {
            return false;
        };
        match remove_verified(inner, name, (&directory, &object), config) {
            Ok(true) => {
                self.succeeded(inner, name);
                self.journal.note_removed(take, takes);
                self.save_journal(inner);
                let message = format!(
                    "the local copy of {name} was removed: {object} was read back and is the same"
                );
                inner.publish(ServiceEventKind::State, &message, Some(name));
                true
            }
            Ok(false) => {
                let error = StoreError::Exists(object.to_string());
                let message = format!(
                    "{object} differs from the take {name}, whose local copy is kept: compare them with mocapd diff"
                );
                inner.publish(ServiceEventKind::Failure, &message, Some(name));
                self.journal.remove(name);
                self.save_journal(inner);
                self.failed(inner, name, &object, &error)
            }
            Err(StoreError::Stopped(_)) => false,
            Err(StoreError::NotFound(_)) => self.upload_again(inner, name, &object),
            Err(error) if is_of_take(&error) => self.keep_local(inner, name, &error),
            Err(error) => self.failed(inner, name, &object, &error),
        }
    }

    /// Has a take uploaded again whose object disappeared: at once the first time, and then rarely.
    fn upload_again(&mut self, inner: &Inner, name: &str, object: &ObjectUrl) -> bool {
        self.journal.remove(name);
        self.save_journal(inner);
        let message = format!("{object} is not in the archive any more");
        if self.gone.insert(name.to_owned()) {
            let message = format!("{message}, and the take {name} is uploaded again");
            inner.publish(ServiceEventKind::Warning, &message, Some(name));
        } else {
            let retry = Retry { at: Instant::now() + RETRY_MAX, delay: RETRY_MAX };
            self.take_retries.insert(name.to_owned(), retry);
        }
        inner.uploads.set(name, UploadState::Waiting, object, message);
        true
    }

    /// Notes that one take was not removed, for a reason that concerns it alone.
    fn keep_local(&mut self, inner: &Inner, name: &str, error: &StoreError) -> bool {
        let retry = Retry::after(self.take_retries.get(name).copied());
        if self.take_retries.insert(name.to_owned(), retry).is_none() {
            let message = format!("the local copy of {name} is kept: {error}; retrying");
            inner.publish(ServiceEventKind::Warning, &message, Some(name));
        }
        true
    }
}

/// Refuses an object that is the take's own file, or in its folder: it is no second copy.
pub(super) fn check_apart(take: &Path, object: &ObjectUrl) -> Result<(), StoreError> {
    let Some(archived) = object.local_path() else { return Ok(()) };
    // Links and mounts are followed, because what they lead to decides.
    let id = |path: &Path| fs::metadata(path).ok().map(|found| FileId::of(&found));
    let is_same = |a: &Path, b: &Path| id(a).is_some_and(|a| id(b) == Some(a));
    if !is_same(folder_of(take), folder_of(&archived)) && !is_same(take, &archived) {
        return Ok(());
    }
    let reason =
        "this is the take's own file, and no second copy: set archive.url to a folder elsewhere";
    Err(StoreError::Unsupported { url: object.to_string(), reason: reason.to_owned() })
}

/// Removes the file of a take if its object has the same content; `false` if it has not.
fn remove_verified(
    inner: &Inner,
    name: &str,
    (directory, object): (&Path, &ObjectUrl),
    config: &ArchiveConfig,
) -> Result<bool, StoreError> {
    let failed = |error: io::Error| StoreError::Source(error.to_string());
    let path = directory.join(format!("{name}.take"));
    check_apart(&path, object)?;
    let mut file = File::open(&path).map_err(failed)?;
    let before = file.metadata().map_err(failed)?;
    let store = Store::of(object)?;
    let mut pace = Pace::new(inner, (directory, object), config);
    if !store.has_content(object, &mut file, &mut |n| pace.wait(n, false))? {
        return Ok(false);
    }
    // With their take, the notes leave the folder as well.
    let notes = upload_notes(&path, object, &store)?;
    let stamp = |file: &Metadata| (FileId::of(file), file.len(), file.modified().ok());
    let now = fs::symlink_metadata(&path).map_err(failed)?;
    if stamp(&now) != stamp(&before) {
        return Err(StoreError::Source("it changed while its object was compared".to_owned()));
    }
    check_apart(&path, object)?;
    remove_if_kept(&path, || Ok(store.len_bytes(object)? == before.len()))?;
    // Those that somebody has changed meanwhile stay, and are reported when the service starts.
    let notes_path = notes::notes_path(&path);
    if notes.is_some_and(|archived| fs::read(&notes_path).is_ok_and(|now| now == archived)) {
        fs::remove_file(&notes_path).map_err(failed)?;
    }
    Ok(true)
}

/// Uploads the notes of a take beside its object, as `NAME.notes.json`, and returns them; `None` if it has none.
fn upload_notes(
    take: &Path,
    object: &ObjectUrl,
    store: &Store,
) -> Result<Option<Vec<u8>>, StoreError> {
    let path = notes::notes_path(take);
    if path.symlink_metadata().is_err() {
        return Ok(None);
    }
    let unreadable = |error: anyhow::Error| StoreError::Source(format!("its notes: {error:#}"));
    let archived = notes::read_file(&path).map_err(unreadable)?;
    let key = object.key();
    let stem = key.strip_suffix(".take").unwrap_or(key);
    let beside = object.with_key(format!("{stem}{}", notes::NOTES_SUFFIX));
    store.upload(&beside, &mut io::Cursor::new(&archived), &mut |_| Ok(()))?;
    Ok(Some(archived))
}

/// Removes a file if its object `is_kept` also once the file has lost its name: a server may store its objects in the
/// takes' folder, under another device number.
fn remove_if_kept(
    path: &Path,
    is_kept: impl FnOnce() -> Result<bool, StoreError>,
) -> Result<(), StoreError> {
    let failed = |error: io::Error| StoreError::Source(error.to_string());
    let aside = set_aside_name(path);
    rename_new(path, &aside).map_err(failed)?;
    let reason = match is_kept() {
        Ok(true) => return fs::remove_file(&aside).map_err(failed),
        Ok(false) | Err(StoreError::NotFound(_)) => StoreError::Source(
            "its object disappeared with the file, so the archive is no second copy: set archive.url to a folder elsewhere".to_owned(),
        ),
        Err(error) => error,
    };
    rename_new(&aside, path).map_err(|error| {
        let message =
            format!("its file is {} now, and cannot be renamed: {error}", aside.display());
        StoreError::Source(message)
    })?;
    Err(reason)
}

fn set_aside_name(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{stem}{SET_ASIDE}"))
}

/// Gives takes their names back whose removal was interrupted; another name if there is a take of theirs by now.
pub(in crate::engine) fn restore_set_aside(inner: &Inner, directory: &Path) {
    let Ok(entries) = fs::read_dir(directory) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let Some(name) = name.to_str() else { continue };
        let stem = name.strip_prefix('.').and_then(|name| name.strip_suffix(SET_ASIDE));
        let Some(stem) = stem.filter(|stem| !stem.is_empty()) else { continue };
        let names = (1..RESTORED_NAMES_MAX).map(|n| match n {
            1 => format!("{stem}.take"),
            _ => format!("{stem}-{n}.take"),
        });
        let mut renamed = Ok(());
        for name in names {
            renamed = rename_new(&entry.path(), &directory.join(name));
            if !renamed.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AlreadyExists) {
                break;
            }
        }
        if let Err(error) = renamed {
            let message =
                format!("{} cannot be renamed to {stem}.take: {error}", entry.path().display());
            inner.publish(ServiceEventKind::Warning, &message, Some(stem));
        }
    }
}

/// Its name, in the takes' folder.
pub(super) const JOURNAL: &str = ".mocapd-archive.json";

/// Most entries: those of the takes in the list, and as many of others that may still be in the folder.
const ENTRIES_MAX: usize = 2 * TAKES_MAX;

/// Longest journal that is read: [`ENTRIES_MAX`] entries of at most 2 KiB each, because the names of takes and objects
/// have at most 255 and 1024 bytes.
const JOURNAL_BYTES_MAX: usize = 16 << 20;

/// What was uploaded, by name of the take.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Journal(BTreeMap<String, JournalEntry>);

/// A take that was uploaded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct JournalEntry {
    url: String,
    bytes: u64,
    modified_unix_ms: i64,
    uploaded_unix_ms: i64,
    #[serde(default)]
    take_id: String,
    /// Whether its local copy was removed.
    #[serde(default)]
    removed: bool,
    /// Whether the take was renamed after its upload: the object keeps the name that it had.
    #[serde(default)]
    renamed: bool,
}

impl JournalEntry {
    pub(super) fn of(take: &TakeSummary, url: &ObjectUrl, uploaded_unix_ms: i64) -> Self {
        Self {
            url: url.to_string(),
            bytes: take.bytes,
            modified_unix_ms: take.modified_unix_ms,
            uploaded_unix_ms,
            take_id: take.take_id.clone(),
            removed: false,
            renamed: false,
        }
    }
}

impl Journal {
    /// Reads the journal. Without a readable one the takes are compared with the archive again.
    pub(super) fn read(directory: &Path) -> Self {
        let read = files::read_bounded(&directory.join(JOURNAL), JOURNAL_BYTES_MAX);
        read.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
    }

    pub(super) fn write(&self, directory: &Path) -> anyhow::Result<()> {
        let path = directory.join(JOURNAL);
        let writing = || format!("cannot write {}", path.display());
        let mut file = tempfile::NamedTempFile::new_in(directory).with_context(writing)?;
        serde_json::to_writer(&mut file, self).with_context(writing)?;
        file.flush().with_context(writing)?;
        file.as_file().sync_all().with_context(writing)?;
        file.persist(&path).with_context(writing)?;
        Ok(())
    }

    /// The entry of a take in the folder, if it has not changed since its upload to `url`.
    pub(super) fn entry(&self, take: &TakeSummary, url: &ObjectUrl) -> Option<&JournalEntry> {
        self.0.get(&take.name).filter(|entry| {
            (entry.bytes, entry.modified_unix_ms) == (take.bytes, take.modified_unix_ms)
                && !entry.removed
                && entry.url == url.to_string()
        })
    }

    /// The object of a take in the folder, if it has not changed since its upload: `url`, or another one in the same
    /// folder if the take was renamed.
    pub(super) fn object(&self, take: &TakeSummary, url: &ObjectUrl) -> Option<ObjectUrl> {
        if self.entry(take, url).is_some() {
            return Some(url.clone());
        }
        let entry = self.0.get(&take.name).filter(|entry| entry.renamed)?;
        let uploaded = ObjectUrl::parse(&entry.url).ok()?;
        let folder = |key: &str| key.rsplit_once('/').map(|(folder, _)| folder.to_owned());
        let is_there = uploaded.root() == url.root() && folder(uploaded.key()) == folder(url.key());
        (is_there && self.entry(take, &uploaded).is_some()).then_some(uploaded)
    }

    /// A take was renamed: its object keeps its name. Returns its URL, if it was uploaded.
    pub(super) fn rename(&mut self, from: &str, to: &str) -> Option<String> {
        let entry = self.0.remove(from)?;
        let url = entry.url.clone();
        self.0.insert(to.to_owned(), JournalEntry { renamed: true, ..entry });
        Some(url)
    }

    pub(super) fn insert(&mut self, name: &str, entry: JournalEntry) {
        self.0.insert(name.to_owned(), entry);
    }

    pub(super) fn remove(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// Notes that the local copy of `take` was removed. A take that was recovered from another stays listed while that
    /// one is in the folder, or a restart would recover it again.
    fn note_removed(&mut self, take: &TakeSummary, takes: &[TakeSummary]) {
        let is_original = |other: &TakeSummary| {
            !take.take_id.is_empty() && other.take_id == take.take_id && other.name != take.name
        };
        if !takes.iter().any(is_original) {
            self.0.remove(&take.name);
        } else if let Some(entry) = self.0.get_mut(&take.name) {
            entry.removed = true;
        }
    }

    /// The ids of takes that were uploaded and removed here.
    pub(super) fn removed_ids(self) -> HashSet<String> {
        let removed = self.0.into_values().filter(|entry| entry.removed);
        removed.map(|entry| entry.take_id).filter(|id| !id.is_empty()).collect()
    }

    /// Forgets takes that are no longer in the folder. If `takes` are not all that it has, the others may still be
    /// there: then the oldest uploads beyond the limit are forgotten.
    pub(super) fn forget_missing(&mut self, takes: &[TakeSummary], are_all: bool) {
        let names: HashSet<&str> = takes.iter().map(|take| take.name.as_str()).collect();
        let ids: HashSet<&str> = takes.iter().map(|take| take.take_id.as_str()).collect();
        let is_needed = |name: &str, entry: &JournalEntry| {
            names.contains(name) || entry.removed && ids.contains(entry.take_id.as_str())
        };
        if are_all {
            self.0.retain(|name, entry| is_needed(name, entry));
            return;
        }
        let surplus = self.0.len().saturating_sub(ENTRIES_MAX);
        if surplus == 0 {
            return;
        }
        let others = self.0.iter().filter(|(name, entry)| !is_needed(name, entry));
        let mut others: Vec<(i64, String)> =
            others.map(|(name, entry)| (entry.uploaded_unix_ms, name.clone())).collect();
        others.sort_unstable();
        for (_, name) in others.into_iter().take(surplus) {
            self.0.remove(&name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_its_own_archive_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.take");
        let names = || -> Vec<_> {
            fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect()
        };
        // As a server that stores its objects in the takes' folder answers.
        let of_server = || match path.metadata() {
            Ok(found) => Ok(found.len() == 4),
            Err(_) => Err(StoreError::NotFound("a".to_owned())),
        };
        fs::write(&path, b"take").unwrap();
        let error = remove_if_kept(&path, of_server).unwrap_err();
        assert!(matches!(error, StoreError::Source(_)), "{error}");
        assert_eq!(names(), ["a.take"]);
        let unknown = StoreError::TimedOut("a".to_owned());
        assert_eq!(remove_if_kept(&path, || Err(unknown.clone())), Err(unknown));
        assert_eq!(names(), ["a.take"]);
        // A take of this name that began meanwhile is not replaced.
        let begun = || {
            fs::write(&path, b"new").unwrap();
            Ok(false)
        };
        remove_if_kept(&path, begun).unwrap_err();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read(folder.path().join(".a.removing")).unwrap(), b"take");
        fs::remove_file(folder.path().join(".a.removing")).unwrap();
        assert_eq!(remove_if_kept(&path, || Ok(true)), Ok(()));
        assert!(names().is_empty());
    }

    fn take(name: &str, id: &str) -> TakeSummary {
        TakeSummary { name: name.to_owned(), take_id: id.to_owned(), ..TakeSummary::default() }
    }

    #[test]
    fn the_journal_of_many_takes_stays_readable() {
        let folder = tempfile::tempdir().unwrap();
        // The longest names that there are.
        let long = |i: usize| format!("{i:05}{}", "n".repeat(245));
        let url = ObjectUrl::parse(&format!("s3://{}/", "b".repeat(63))).unwrap();
        let url = url.join(&"k".repeat(1000));
        let mut journal = Journal::default();
        for i in 0..3 * TAKES_MAX {
            let take = take(&long(i), "0123456789abcdef0123456789abcdef");
            journal.insert(&take.name, JournalEntry::of(&take, &url, i as i64));
        }
        // The list has the oldest uploads.
        let listed: Vec<_> = (0..TAKES_MAX).map(|i| take(&long(i), "")).collect();
        journal.forget_missing(&listed, false);
        let names: Vec<_> = journal.0.keys().cloned().collect();
        let kept = (0..TAKES_MAX).chain(2 * TAKES_MAX..3 * TAKES_MAX).map(long);
        assert!(names.iter().cloned().eq(kept), "{}", names.len());
        journal.write(folder.path()).unwrap();
        assert_eq!(Journal::read(folder.path()).0, journal.0);
        journal.forget_missing(&listed[..10], true);
        assert_eq!(journal.0.len(), 10);
    }

    #[test]
    fn a_removed_take_is_known_while_its_original_is_there() {
        let url = ObjectUrl::parse("s3://b/x").unwrap();
        let (original, recovered) = (take("cut", "1"), take("cut.recovered", "1"));
        let mut journal = Journal::default();
        journal.insert(&recovered.name, JournalEntry::of(&recovered, &url, 0));
        journal.note_removed(&recovered, &[original.clone(), recovered.clone()]);
        journal.forget_missing(&[original], true);
        assert_eq!(journal.entry(&recovered, &url), None);
        assert_eq!(journal.0.len(), 1);
        journal.forget_missing(&[], true);
        assert_eq!(journal.0.len(), 0);
        journal.insert(&recovered.name, JournalEntry::of(&recovered, &url, 0));
        journal.note_removed(&recovered, std::slice::from_ref(&recovered));
        assert_eq!(journal.0.len(), 0);
    }
}
