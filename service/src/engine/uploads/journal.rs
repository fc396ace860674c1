//! The file that lists what was uploaded.

use std::{
    collections::{BTreeMap, HashSet},
    io::Write,
    path::Path,
};

use anyhow::Context;
use mocapd_acquire::files;
use mocapd_store::ObjectUrl;
use serde::{Deserialize, Serialize};

use super::TAKES_MAX;
use crate::status::TakeSummary;

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
    pub(super) uploaded_unix_ms: i64,
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
    pub(super) fn note_removed(&mut self, take: &TakeSummary, takes: &[TakeSummary]) {
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
